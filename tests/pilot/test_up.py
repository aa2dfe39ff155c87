"""`skyrelay up`: real processes, a chain behind HTTP, a real bus; what comes out is what one process gives."""

import re
import shutil
import subprocess
import time
import tomllib
from pathlib import Path

import pytest
import tomli_w
from town_of_processes import WAIT, Up, decided, sets, skyrelay
from typer.testing import CliRunner

from skyrelay.chain.accounts import Keyring
from skyrelay.cli.main import app
from skyrelay.core.errors import SkyRelayError, UsageError
from skyrelay.pilot.up import new_hosts_folder


def test_processes_in_lock_step_decide_what_one_process_decides(run_folder, tmp_path):
    process = skyrelay("up", "--out", tmp_path / "up", *sets(), stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    told, lines = process.communicate(timeout=300)
    assert process.returncode == 0, lines
    one, many = decided(run_folder), decided(tmp_path / "up")
    for table in one:
        assert many[table] == one[table], table
    assert len(re.findall(r"^\w+ +process \d+", lines, re.MULTILINE)) == 6
    assert "3 periods" in told
    assert not list((tmp_path / "up-hosts").glob("*.keystore"))
    assert not any("@" in file.read_text() for file in (tmp_path / "up-hosts").glob("*.toml"))
    audit = skyrelay("audit", tmp_path / "up", stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert audit.wait(120) == 0, audit.stdout.read()


@pytest.mark.parametrize(
    ("option", "wanted"), [(["--kubo"], "Kubo's ipfs on PATH"), (["--validators", "4"], "GoQuorum on PATH")]
)
def test_a_node_program_that_is_not_there_is_told_with_what_to_do(tmp_path, monkeypatch, option, wanted):
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    told = CliRunner().invoke(app, ["up", "--out", str(tmp_path / "up"), *option], standalone_mode=False)
    assert isinstance(told.exception, SkyRelayError)
    assert wanted in str(told.exception)
    assert "make nodes" in str(told.exception)


def test_what_is_left_of_a_hosts_folder_has_no_credentials(tmp_path):
    url = "https://me:hunter2@node.example/v3/t0ken?key=s3cret"
    with new_hosts_folder(tmp_path / "hosts") as folder:
        Keyring.create(folder / "uavs.keystore", "a password")
        tree = {"name": "uavs", "chain": {"urls": [url, "http://127.0.0.1:1"], "chain_id": 7}, "store": {"url": url}}
        (folder / "uavs.toml").write_text(tomli_w.dumps(tree))
        (folder / "torn.toml").write_text(f'urls = ["{url}')
        (folder / "uavs.log").write_text("ready")
    assert {file.name for file in folder.iterdir()} == {"uavs.toml", "uavs.log"}
    left = tomllib.loads((folder / "uavs.toml").read_text())
    assert left["chain"] == {"urls": ["https://node.example/...", "http://127.0.0.1:1"], "chain_id": 7}
    assert left["store"] == {"url": "https://node.example/..."}
    assert (folder / "uavs.toml").stat().st_mode & 0o777 == 0o600


def test_a_node_beside_another_is_refused(tmp_path):
    store = ["--set", "store.url=http://127.0.0.1:5001"]
    told = CliRunner().invoke(app, ["up", "--out", str(tmp_path / "up"), "--kubo", *store], standalone_mode=False)
    assert isinstance(told.exception, UsageError)


@pytest.mark.survival
def test_vehicles_that_sign_are_served_as_those_that_send(run_folder, tmp_path):
    process = skyrelay(
        "up",
        "--out",
        tmp_path / "up",
        *sets("chain.submission=batch"),
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    _, lines = process.communicate(timeout=300)
    assert process.returncode == 0, lines
    one, many = decided(run_folder), decided(tmp_path / "up")
    for table in ("candidates", "moves", "vehicles"):
        assert many[table] == one[table], table
    audit = skyrelay("audit", tmp_path / "up", stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert audit.wait(120) == 0, audit.stdout.read()


def test_nothing_is_left_of_one_that_is_killed(tmp_path):
    up = Up(tmp_path / "up", "coordination.steps=290")
    up.wait_for_block(3)
    names = ("chain", "world", "vehicles", "uavs", "coordinator", "live")
    children = up.wait_for(lambda: pids if all(pids := [up.pid(name) for name in names]) else [])
    # Whoever is started elsewhere needs a token and a key of these files.
    held = [file for file in up.hosts.iterdir() if re.search("://[^/]*@|ciphertext", file.read_text())]
    assert {file.suffix for file in held} == {".toml", ".keystore"}
    assert all(file.stat().st_mode & 0o777 == 0o600 for file in held)
    up.process.kill()
    up.process.wait(60)
    up._reader.join()

    def runs(pid):
        try:
            return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
        except FileNotFoundError:
            return False

    until = time.monotonic() + WAIT
    while left := [pid for pid in children if runs(pid)]:
        assert time.monotonic() < until, left
        time.sleep(0.02)
