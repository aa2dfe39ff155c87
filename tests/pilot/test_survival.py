"""What happens to agents: they are killed, and told wrong things; the others go on, and so do they."""

import os
import re
import signal
import subprocess
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from town_of_processes import Up, audited, decided, skyrelay

from skyrelay.core.errors import BusError
from skyrelay.pilot.bus import Bus
from skyrelay.pilot.lockstep import serve


@pytest.mark.survival
@pytest.mark.parametrize(
    ("block", "names"),
    [
        (9, ["vehicles", "coordinator"]),
        (12, ["uavs"]),
        (16, ["coordinator"]),
        (13, ["chain", "vehicles", "uavs", "coordinator"]),
    ],
)
def test_whoever_is_killed_is_back_and_no_selection_is_lost_or_doubled(run_folder, tmp_path, block, names):
    """What a beacon lost meanwhile changes is where a UAV flies, so only the first period must be as without kills."""
    up = Up(tmp_path / "up")
    up.wait_for_block(block)
    for name in names:
        up.kill(name)
    up.end()
    assert sum("started again" in line for line in up.lines) == len(names)
    one, many = (decided(folder)["proposals"] for folder in (run_folder, tmp_path / "up"))
    assert [row for row in many if row["period"] == 0] == [row for row in one if row["period"] == 0]
    asked = [(row["period"], row["round"], row["vehicle"]) for row in many]
    assert len(set(asked)) == len(asked)
    assert {row["period"] for row in many if row["accepted"]} == {0, 1, 2}
    uavs = pq.read_table(tmp_path / "up" / "uavs.parquet").to_pandas()
    assert (uavs[uavs.selected & (uavs.step > 16)].action != 0).any()
    audited(tmp_path / "up")


def bad(tmp_path, text, old, new):
    """A host's file with one thing wrong."""
    assert old in text
    file = tmp_path / "bad.toml"
    file.write_text(text.replace(old, new, 1))
    return file


@pytest.mark.survival
def test_what_is_wrong_with_a_host_is_one_clear_line(tmp_path):
    """Each fault in turn, against a chain that runs; the last words are the only ones, and the status is 2."""
    # At six times the clock's pace, so that the run is still there when the last fault is told.
    up = Up(tmp_path / "up", "coordination.steps=290", options=("--speed", "6"))
    up.wait_for_block(12)
    hosts = tmp_path / "up-hosts"
    text = (hosts / "uavs.toml").read_text().replace('"uavs.keystore"', f'"{hosts}/uavs.keystore"')
    text = text.replace('"scenario.toml"', f'"{hosts}/scenario.toml"')
    environment = os.environ | {"SKYRELAY_KEYSTORE_PASSWORD": "wrong"}
    pairs = Path(f"/proc/{up.pid('uavs')}/environ").read_text().split("\0")
    right = dict(pair.split("=", 1) for pair in pairs if "=" in pair)
    faults = [
        (text, environment, "keystore and its password"),
        (bad(tmp_path, text, "bandwidth", "bandwith").read_text(), right, "a known key|a value"),
        (bad(tmp_path, text, "chain_id = 31337", "chain_id = 1").read_text(), right, "another network"),
        (bad(tmp_path, text, 'contract = "0x', 'contract = "0xg').read_text(), right, "contract"),
        (re.sub(r'contract = "0x\w+"', f'contract = "0x{"1" * 40}"', text), right, "a contract's address"),
        (re.sub(r"tcp/127.0.0.1:\d+", "tcp/127.0.0.1:9", text), right, "a peer that answers"),
        (re.sub(r"http://[^\"]+", "http://127.0.0.1:9", text), right, "a node that answers JSON-RPC"),
        (text, right, "a name that no other peer has"),
        (text.replace("side = ", "side = -"), right, "greater than 0"),
    ]
    dispatched = tmp_path / "dispatched.toml"
    dispatched.write_text((hosts / "scenario.toml").read_text().replace("dispatch = false", "dispatch = true"))
    of_these = text.replace(f"{hosts}/scenario.toml", str(dispatched))
    flown = ("--members", "u01", "--autopilot", "udp://127.0.0.1:9", "--origin", "44.5,11.3")
    faults.append((of_these, right, "a scenario without dispatch"))
    for number, (content, variables, wanted) in enumerate(faults):
        file = tmp_path / f"fault{number}.toml"
        file.write_text(content)
        options = flown if content is of_these else ()
        agent = skyrelay("agent", "uav", "--config", file, *options, stderr=subprocess.PIPE, env=variables)
        _, told = agent.communicate(timeout=120)
        assert agent.returncode == 2, told
        assert re.search(wanted, told), told
        assert len(told.strip().splitlines()) == 1, told
    up.process.send_signal(signal.SIGINT)
    assert up.process.wait(60) == 130
    up._reader.join()


def test_a_world_that_stops_ends_its_hosts_with_one_line():
    none: Any = None
    with Bus("lonely") as bus, pytest.raises(BusError, match=r"world: is 'silent for 0.2 s'; expected a world that"):
        serve(none, bus, "0x0", "uavs", none, patience=0.2, receivers=none)
