"""`skyrelay chain devnet` and `skyrelay run --chain`: a scenario on four validators, as any of them tells it."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrelay.chain.accounts import PASSWORD, PASSWORD_FILE, Keyring
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.node.devnet import find_binary
from skyrelay.cli.main import app
from skyrelay.core.errors import ChainError
from skyrelay.policy import Policy

pytestmark = [pytest.mark.nodes, pytest.mark.xdist_group("run")]

SMALL = ["mobility.penetration=0.03", "fleet.uavs=8", "coordination.steps=12", "coordination.period_steps=6"]


def skyrelay(*arguments: str) -> tuple[int, dict[str, Any]]:
    """Exit status and JSON of a command."""
    done = CliRunner().invoke(app, [*arguments, "--json"], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.return_value or 0, json.loads(done.stdout)


def play(folder: Path, *more: str) -> dict[str, Any]:
    overrides = [part for setting in SMALL for part in ("--set", setting)]
    return skyrelay("run", "bologna", "--out", str(folder), *overrides, *more)[1]


@contextmanager
def devnet(folder: Path) -> Iterator[dict[str, Any]]:
    """The command in a process of its own: what it tells when blocks are made. Ending it ends the validators."""
    ports = ["--rpc-port", str(free_ports(12))]
    command = [str(Path(sys.executable).parent / "skyrelay"), "chain", "devnet", "--dir", str(folder), "--json", *ports]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield json.loads(process.stdout.readline())
        finally:
            process.terminate()
    assert process.returncode == 0


def free_ports(count: int) -> int:
    """The first of so many ports in a row that nobody listens on."""
    for first in range(21_000, 31_000, count):
        with ExitStack() as stack:
            try:
                for port in range(first, first + count):
                    stack.enter_context(socket.create_server(("127.0.0.1", port)))
            except OSError:
                continue
            return first
    raise AssertionError("no ports are free")


def test_a_run_on_four_validators_is_that_of_the_embedded_chain_and_any_of_them_can_be_audited(tmp_path, monkeypatch):
    policy = tmp_path / "policy.onnx"
    policy.write_bytes(Policy.builtin("generalist").content)
    flown = ["--set", f"coordination.policy={policy}"]
    with devnet(tmp_path / "net") as network:
        monkeypatch.setenv(PASSWORD_FILE, network["operator_password_file"])
        monkeypatch.delenv(PASSWORD, raising=False)
        keystore = f"chain.keystore={network['operator_keystore']}"
        told = play(tmp_path / "run", "--chain", network["endpoints"][0], "--set", keystore, *flown)
        status, audit = skyrelay("audit", "--chain", network["endpoints"][2], "--contract", told["contract"])
        folder_status, of_folder = skyrelay("audit", str(tmp_path / "run"))  # where: the folder names its node
        sealed = audit["given"]["blocks sealed by"]
    assert status == 0
    assert audit["agrees"], audit["differences"]
    assert of_folder["agrees"], of_folder["differences"]
    assert folder_status == 0
    assert of_folder["checked"]["files of the manifest"] > 10
    assert not any("unsigned" in what for what in of_folder["unchecked"])
    assert audit["checked"]["vehicles selected"] >= told["served"] > 0
    assert audit["checked"]["model assignments"] > 0
    validators = json.loads((tmp_path / "net" / "devnet.json").read_text())["validators"]
    assert len(validators) == 4
    assert all(node["address"].lower() in sealed for node in validators)
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {"report.html", "events.parquet", "summary.json"}

    embedded = play(tmp_path / "embedded", *flown)
    same = ("vehicles", "uavs", "zones", "periods", "served", "mean_qou", "mean_qov", "coverage", "connectivity")
    assert [told[key] for key in same] == pytest.approx([embedded[key] for key in same])


@contextmanager
def validators(network: Path, names: list[str]) -> Iterator[None]:
    """Each host's start.sh, as on its own host."""
    environment = {**os.environ, "GOQUORUM": find_binary("qbft")}
    started: list[subprocess.Popen[bytes]] = []
    try:
        for name in names:
            home = network / "hosts" / name
            with (home / "node.log").open("wb") as log:
                started.append(subprocess.Popen([home / "start.sh"], env=environment, stdout=log, stderr=log))
        yield
    finally:
        for process in started:
            process.send_signal(signal.SIGINT)
        for process in started:
            process.wait(30)


def test_validators_of_several_hosts_take_a_contract_and_a_run_audits_from_its_folder(tmp_path, monkeypatch):
    names = ["alpha", "beta", "gamma", "delta"]
    first = free_ports(8)
    ports = {name: (first + 2 * place, first + 2 * place + 1) for place, name in enumerate(names)}
    hosts = tmp_path / "hosts.toml"
    hosts.write_text(
        "chain_id = 4242\n"
        + "".join(
            f'[[host]]\nname = "{name}"\naddress = "127.0.0.{place}"\np2p_port = {p2p}\nrpc_port = {rpc}\n'
            for place, (name, (rpc, p2p)) in enumerate(ports.items(), 11)
        )
    )
    _, founded = skyrelay("chain", "devnet", "--hosts", str(hosts), "--dir", str(tmp_path / "net"))
    monkeypatch.setenv(PASSWORD_FILE, str(Path(founded["operator_keystore"]).with_suffix(".password")))
    monkeypatch.delenv(PASSWORD, raising=False)
    urls = {name: f"http://127.0.0.1:{rpc}" for name, (rpc, _) in ports.items()}
    pinned = ["--chain-id", "4242", "--validators", ",".join(founded["validators"].values())]
    signing = [*pinned, "--node", urls["alpha"], "--keystore", founded["operator_keystore"]]
    with validators(tmp_path / "net", names):
        wait_for_blocks(urls["alpha"])
        _, made = skyrelay("deploy", *signing)
        skyrelay("grant", "coordinator", "coordinator", "--contract", made["contract"], *signing)
        _, status = skyrelay("status", *pinned, "--node", urls["delta"], "--contract", made["contract"])
        assert len(status["roles"]["coordinator"]) == 1
        assert status["roles"]["admin"] == [made["administrator"]]

        keystore = f"chain.keystore={founded['operator_keystore']}"
        play(tmp_path / "run", "--chain", urls["beta"], "--set", keystore)
        summary = json.loads((tmp_path / "run" / "summary.json").read_text())
        assert (summary["chain_url"], summary["chain_id"]) == (urls["beta"], 4242)
        for there in ([], ["--node", urls["gamma"]]):
            code, audit = skyrelay("audit", str(tmp_path / "run"), *there)
            assert (code, audit["differences"]) == (0, [])
        with pytest.raises(ChainError, match="chain id: is 4242; expected 7: this is another network"):
            skyrelay("audit", str(tmp_path / "run"), "--chain-id", "7")


def wait_for_blocks(url: str) -> None:
    """Until the node has a second block; no answer within a minute is an error of its own."""
    end = time.monotonic() + 60
    while True:
        try:
            if NodeChain(url, Keyring.ephemeral(), patience=1.0).block_number > 1:
                return
        except ChainError:
            assert time.monotonic() < end, "no blocks"
        assert time.monotonic() < end, "no blocks"
        time.sleep(0.2)
