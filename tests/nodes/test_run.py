"""`skyrelay run --chain`: a whole scenario on four validators, and what any of them says of it."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skyrelay.chain.accounts import PASSWORD, PASSWORD_FILE
from skyrelay.chain.devnet import Devnet
from skyrelay.cli.main import app

pytestmark = [pytest.mark.nodes, pytest.mark.xdist_group("run")]

SMALL = ["mobility.penetration=0.03", "fleet.uavs=8", "coordination.steps=12", "coordination.period_steps=6"]


def skyrelay(*arguments: str) -> tuple[int, dict]:
    """Exit status and JSON of a command."""
    done = CliRunner().invoke(app, [*arguments, "--json"], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.return_value or 0, json.loads(done.stdout)


def play(folder: Path, *more: str) -> dict:
    overrides = [part for setting in SMALL for part in ("--set", setting)]
    return skyrelay("run", "bologna", "--out", str(folder), *overrides, *more)[1]


def test_a_run_on_four_validators_is_that_of_the_embedded_chain_and_any_of_them_can_be_audited(tmp_path, monkeypatch):
    with Devnet.create(tmp_path / "net") as network:
        keystore, password = network.operator
        monkeypatch.setenv(PASSWORD_FILE, str(password))
        monkeypatch.delenv(PASSWORD, raising=False)
        told = play(tmp_path / "run", "--chain", network.endpoints[0], "--set", f"chain.keystore={keystore}")
        status, audit = skyrelay("audit", "--chain", network.endpoints[2], "--contract", told["contract"])
        sealed = audit["given"]["blocks sealed by"]
    assert status == 0
    assert audit["agrees"], audit["differences"]
    assert audit["checked"]["vehicles selected"] >= told["served"] > 0
    assert audit["checked"]["model assignments"] > 0
    assert all(node.address.lower() in sealed for node in network.validators)
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {"report.html", "events.parquet", "summary.json"}

    embedded = play(tmp_path / "embedded")
    same = ("vehicles", "uavs", "zones", "periods", "served", "mean_qou", "mean_qov", "coverage", "connectivity")
    assert [told[key] for key in same] == pytest.approx([embedded[key] for key in same])
