"""`skyrelay up --validators --kubo`: agents over four validators and a Kubo node, some of which are killed."""

import json
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "pilot"))
from town_of_processes import Up, decided, skyrelay

pytestmark = [pytest.mark.nodes, pytest.mark.xdist_group("up")]

TINY = ["mobility.penetration=0.03", "fleet.uavs=8", "coordination.steps=12", "coordination.period_steps=6"]


def answered(row):
    return tuple(row[key] for key in ("period", "round", "vehicle", "uav", "accepted"))


@contextmanager
def devnet(folder):
    """The chain that a run has left, at the same addresses."""
    network = skyrelay("chain", "devnet", "--dir", folder, "--json", stdout=subprocess.PIPE)
    try:
        yield json.loads(network.stdout.readline())
    finally:
        network.terminate()
        network.wait(60)


def test_a_validator_and_kubo_are_killed_and_back_and_nothing_is_lost_or_doubled(tmp_path):
    up = Up(tmp_path / "up", *TINY, options=("--validators", 4, "--kubo"))
    try:
        up.wait_for(lambda: up.pid("uavs"))
        for name in ("validator-1", "kubo"):
            up.kill(name)
        up.wait_for(lambda: sum("ended; started again" in line for line in list(up.lines)) == 2)
        up.end()
    finally:
        up.stop()
    one = tmp_path / "one"
    overrides = [part for override in TINY for part in ("--set", override)]
    assert skyrelay("run", "--out", one, *overrides, stdout=subprocess.DEVNULL).wait(300) == 0
    many, alone = decided(tmp_path / "up"), decided(one)
    # The order within a block is the network's; who proposed to whom, and who was taken, is not.
    assert sorted(map(answered, many["proposals"])) == sorted(map(answered, alone["proposals"]))
    summary = json.loads((tmp_path / "up" / "summary.json").read_text())
    with devnet(tmp_path / "up-devnet") as network:
        command = ("audit", "--chain", network["endpoints"][2], "--contract", summary["contract"], "--json")
        audit = skyrelay(*command, stdout=subprocess.PIPE)
        told, _ = audit.communicate(timeout=300)
    assert audit.returncode == 0, told
    assert json.loads(told)["agrees"]
