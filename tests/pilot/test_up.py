"""`skyrelay up`: real processes, a chain behind HTTP, a real bus; what comes out is what one process gives."""

import json
import re
import subprocess
import sys

import pyarrow.parquet as pq
import pytest

SMALL = ["mobility.penetration=0.08", "fleet.uavs=18", "coordination.steps=24", "coordination.period_steps=8"]
LAUNCH = "from skyrelay.cli.main import main; main()"


def _sets(*overrides):
    return [part for override in (*SMALL, *overrides) for part in ("--set", override)]


def _skyrelay(*arguments, **options):
    return subprocess.Popen([sys.executable, "-c", LAUNCH, *map(str, arguments)], text=True, **options)


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("one") / "run"
    process = _skyrelay("run", "--out", folder, *_sets(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    assert process.wait() == 0
    return folder


def _rows(folder, table, columns):
    return pq.read_table(folder / f"{table}.parquet", columns=columns).to_pylist()


def _decided(folder):
    """Who proposed to whom, who serves whom, how everyone moved: all that agents decide."""
    names = {row["address"]: row["name"] for row in _rows(folder, "accounts", ["address", "name"])}
    proposals = ["period", "round", "zone", "vehicle", "uav", "qou", "qov", "score", "demand_kbps", "accepted", "order"]
    moves = ["step", "uav", "x", "y", "zone", "selected", "battery", "action"]
    events = _rows(folder, "events", ["name", "args"])
    allocated = [json.loads(row["args"]) for row in events if row["name"] == "UAVAllocated"]
    selections = [(names[args["uav"]], [names[vehicle] for vehicle in args["selected"]]) for args in allocated]
    return {
        "proposals": _rows(folder, "proposals", proposals),
        "candidates": _rows(folder, "candidates", ["period", "vehicle", "uav", "qou"]),
        "selections": selections,
        "moves": _rows(folder, "uavs", moves),
        "vehicles": _rows(folder, "vehicles", ["step", "vehicle", "uav", "covered"]),
    }


def test_processes_in_lock_step_decide_what_one_process_decides(run_folder, tmp_path):
    process = _skyrelay("up", "--out", tmp_path / "up", *_sets(), stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    told, lines = process.communicate(timeout=300)
    assert process.returncode == 0, lines
    one, many = _decided(run_folder), _decided(tmp_path / "up")
    for table in one:
        assert many[table] == one[table], table
    assert len(re.findall(r"^\w+ +process \d+", lines, re.MULTILINE)) == 4
    assert "3 periods" in told
    assert not list((tmp_path / "up-hosts").glob("*.keystore"))


def test_the_audit_finds_nothing_in_what_processes_left(tmp_path, run_folder):
    del run_folder  # one network at a time
    process = _skyrelay("up", "--out", tmp_path / "up", *_sets("coordination.steps=8"), stderr=subprocess.DEVNULL)
    assert process.wait(300) == 0
    audit = _skyrelay("audit", tmp_path / "up", stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert audit.wait(120) == 0, audit.stdout.read()
