"""A UAV's agent as a process that flies an autopilot by MAVLink, in a world with everybody else's agents."""

import json
import math
import threading

import numpy as np
import pyarrow.parquet as pq
import pytest
import requests
from autopilot_end import HOLD, LAND, OFFBOARD, RETURN, TAKEOFF, AutopilotEnd
from gpsd_server import GpsdServer
from processes import free_port, until

from skyrelay.core.scenario import load_scenario
from skyrelay.pilot.geodesy import Frame
from skyrelay.simulation.world import World

SKYRELAY = ("-c", "from skyrelay.cli.main import main; main()")
FRAME = Frame(44.4949, 11.3426)
SETS = ["mobility.penetration=0.05", "fleet.uavs=1", "zones.columns=1", "zones.rows=1"]
SETS += ["coordination.steps=8", "coordination.period_steps=8", "coordination.step_seconds=4"]


@pytest.mark.survival
def test_an_agent_flies_a_real_airframe_and_brings_it_home(start, tmp_path):
    world = World.of(load_scenario("bologna", SETS))
    station = (float(world.fleet.x[0]), float(world.fleet.y[0]))
    hosts, options = tmp_path / "hosts", [part for item in SETS for part in ("--set", item)]
    password = {"SKYRELAY_KEYSTORE_PASSWORD": "only for this test"}
    world_process = start(
        *SKYRELAY, "up", "--out", tmp_path / "run", "--hosts", hosts, "--elsewhere", "uav", "--speed", "4", *options,
        env=password,
    )  # fmt: skip
    until(lambda: (hosts / "uavs.toml").exists() or world_process.poll() is not None, limit=120.0)
    port, watched = free_port(), free_port()
    with AutopilotEnd(port, home=FRAME.to_globe(*station), pace=4.0) as end:
        agent = start(
            *SKYRELAY, "agent", "uav", "--config", hosts / "uavs.toml", "--autopilot", f"udp://127.0.0.1:{port}",
            "--origin", "44.4949,11.3426", "--metrics", f"127.0.0.1:{watched}", "--log-json", env=password, stderr=-1,
        )  # fmt: skip
        assert world_process.wait(240) == 0
        figures = requests.get(f"http://127.0.0.1:{watched}/metrics", timeout=10).text
        agent.terminate()
        _, said = agent.communicate(timeout=60)
        until(lambda: end.modes == [TAKEOFF, OFFBOARD, RETURN, LAND, HOLD])
    assert end.fence
    farthest = max(math.hypot(*place[:2]) for place in end.path)
    assert farthest > 0.5 * world.law.stride
    rows = pq.read_table(tmp_path / "run" / "uavs.parquet", columns=["step", "x", "y"]).to_pylist()
    path = np.array(end.path)[:, :2] + station
    for row in rows:  # a step after where the airframe was, by the law of flight
        nearest = np.linalg.norm(path - (row["x"], row["y"]), axis=1).min()
        assert nearest <= 1.05 * world.law.stride
    admitted = next(line for line in figures.splitlines() if line.startswith("skyrelay_beacons_admitted_total"))
    assert float(admitted.split()[-1]) > 0
    lines = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    assert any(line["message"].startswith("ready: 1 of kind uav") for line in lines)
    assert "only for this test" not in said


@pytest.mark.survival
def test_a_vehicle_is_where_its_own_receiver_says(start, tmp_path):
    sets = ["mobility.source=random-waypoint", "mobility.vehicles=1", "mobility.area=2000", *SETS[1:]]
    hosts, options = tmp_path / "hosts", [part for item in sets for part in ("--set", item)]
    password = {"SKYRELAY_KEYSTORE_PASSWORD": "only for this test"}
    world_process = start(
        *SKYRELAY, "up", "--out", tmp_path / "run", "--hosts", hosts, "--elsewhere", "vehicle", *options, env=password
    )
    until(lambda: (hosts / "vehicles.toml").exists() or world_process.poll() is not None, limit=120.0)
    server = GpsdServer()
    latitude, longitude = FRAME.to_globe(1234.0, 567.0)
    vehicle = start(
        *SKYRELAY, "agent", "vehicle", "--config", hosts / "vehicles.toml",
        "--gpsd", server.address, "--origin", "44.4949,11.3426", env=password,
    )  # fmt: skip
    done = threading.Event()

    def report():
        while not done.wait(0.2):
            server.report(lat=latitude, lon=longitude, speed=8.0)

    reporting = threading.Thread(target=report)
    reporting.start()
    try:
        assert world_process.wait(240) == 0
    finally:
        done.set()
        reporting.join()
        vehicle.terminate()
        server.stop()
    events = pq.read_table(tmp_path / "run" / "events.parquet", columns=["name", "args"]).to_pylist()
    (record,) = [json.loads(event["args"]) for event in events if event["name"] == "VehicleRegistered"]
    assert (record["x"] / 10, record["y"] / 10) == pytest.approx((1234.0, 567.0), abs=1.0)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--autopilot", "udp://127.0.0.1:14540"], "--origin: expected with --autopilot or --gpsd"),
        (["--autopilot", "udp://127.0.0.1:14540", "--origin", "north"], "LATITUDE,LONGITUDE"),
        (["--autopilot", "udp://127.0.0.1:14540", "--origin", "91,0"], "a latitude of -85 to 85"),
    ],
)
def test_an_airframe_that_is_not_placed_is_one_line(start, options, expected):
    agent = start(*SKYRELAY, "agent", "uav", "--config", "none.toml", *options, stderr=-1)
    _, said = agent.communicate(timeout=60)
    assert agent.returncode == 2
    assert expected in said
    assert said.count("\n") == 1
