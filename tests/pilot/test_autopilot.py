"""A UAV flown by MAVLink: real messages over UDP, a multirotor's dynamics at the other end."""

import math

import numpy as np
import pytest
from autopilot_end import HOLD, LAND, OFFBOARD, RETURN, TAKEOFF, AutopilotEnd
from processes import free_port, until
from pymavlink.dialects.v20 import common as mavlink

from skyrelay.airspace.law import Law
from skyrelay.core.errors import AutopilotError, UsageError
from skyrelay.core.scenario import Energy
from skyrelay.core.zones import ZoneGrid
from skyrelay.pilot.autopilot import FENCE_MARGIN, Autopilot
from skyrelay.pilot.failsafe import Guardian, Lifeline
from skyrelay.pilot.geodesy import Frame

FRAME = Frame(44.4949, 11.3426)
GRID = ZoneGrid(-100.0, -100.0, 200.0, 2, 1)
LAW = Law(GRID, reach=900.0, speed=10.0, seconds=3.0, energy=Energy(), walls=None, patience=10.0)
"""Zone 1 reaches from -100 to 100 m both ways; home is its middle."""


@pytest.fixture
def fly():
    """Connects an autopilot's two ends; both are let go after the test."""
    ends = []

    def begin(up=True, **options):
        port = free_port()
        ends.append(end := AutopilotEnd(port, **options).__enter__())
        ends.append(pilot := Autopilot(f"udp://127.0.0.1:{port}", FRAME, patience=20.0))
        if up:
            pilot.fence(LAW, 1)
            pilot.take_off(30.0, LAW.speed)
        return end, pilot

    yield begin
    for end in reversed(ends):
        end.__exit__(None, None, None)


def apart(end, x, y):
    return math.dist(end.airframe.position[:2], (x, y))


def test_it_takes_off_flies_the_policys_moves_and_comes_home(fly):
    end, pilot = fly()
    assert end.modes == [TAKEOFF, OFFBOARD]
    assert 29.0 <= end.airframe.position[2] <= 31.0
    assert pilot.fix().position == pytest.approx((0.0, 0.0), abs=1.0)
    assert 0 < pilot.fix().battery <= 90
    pilot.fly(8, LAW)  # east
    until(lambda: apart(end, 30.0, 0.0) < 1.0)
    assert not pilot.landed
    pilot.fly(2, LAW)  # north
    until(lambda: apart(end, 30.0, 30.0) < 1.5)
    pilot.fly(0, LAW)  # stay
    assert pilot.wait_until(lambda: pilot.fix().speed < 0.5, 20.0)
    pilot.come_home()
    assert pilot.wait_until(lambda: pilot.landed, 60.0)
    until(lambda: end.modes == [TAKEOFF, OFFBOARD, RETURN, LAND, HOLD])
    assert not end.armed
    assert apart(end, 0.0, 0.0) < 2.0


def test_a_real_airframe_needs_time_and_keeps_its_limits(fly):
    end, pilot = fly()
    start = len(end.path)
    pilot.fly(8, LAW)
    until(lambda: apart(end, 30.0, 0.0) < 1.0)
    track = np.array(end.path[start:])
    speeds = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1) / 0.02
    assert 5.0 < speeds.max() <= 1.1 * LAW.speed
    assert np.abs(np.diff(speeds)).max() / 0.02 < 9.81


def test_the_zone_is_fenced_and_no_set_point_leaves_it(fly):
    end, pilot = fly()
    corners = [FRAME.to_plane(*corner) for corner in end.fence]
    border = 100.0 + FENCE_MARGIN
    expected = [(-border, -border), (border, -border), (border, border), (-border, border)]
    assert [tuple(round(c, 1) for c in corner) for corner in corners] == expected
    for _ in range(5):  # 150 m to the east, of which 100 are in the zone
        at = end.airframe.position[0]
        pilot.fly(8, LAW)
        until(lambda at=at: end.airframe.position[0] > min(at + 28.0, 98.5))
    assert np.array(end.path)[:, 0].max() < border


def test_bus_chain_or_policy_away_for_too_long_brings_it_home(fly):
    end, pilot = fly()
    pilot.fly(8, LAW)
    reasons = []

    def come_home(lost):
        reasons.extend(lost)
        pilot.come_home()

    with Guardian({"bus": 60.0, "chain": 60.0, "policy": 0.5}, come_home) as guardian:
        guardian.beat("bus")
        assert pilot.wait_until(lambda: pilot.landed, 60.0)
    assert reasons == ["policy"]
    until(lambda: end.modes[2:] == [RETURN, LAND, HOLD])
    setpoints = end.setpoint_at
    pilot.fly(8, LAW)  # an agent that wakes up again does not fly it any more
    assert end.setpoint_at == setpoints
    assert end.mode == HOLD


def test_what_is_lost_is_a_matter_of_time_alone():
    line = Lifeline({"bus": 5.0, "chain": 30.0}, now=100.0)
    assert line.lost(105.0) == []
    assert line.lost(105.1) == ["bus"]
    line.beat("bus", 105.1)
    assert line.lost(110.0) == []
    assert line.lost(131.0) == ["bus", "chain"]


def test_an_autopilot_that_denies_a_return_lands_where_it_is(fly):
    end, pilot = fly()
    end.refuse.add(mavlink.MAV_CMD_DO_SET_MODE)
    pilot.come_home()
    assert pilot.wait_until(lambda: pilot.landed, 60.0)
    until(lambda: end.modes[2:] == [LAND, HOLD])


def test_an_autopilot_left_alone_comes_home_by_itself(fly):
    end, pilot = fly()
    pilot.close()  # as by the death of the agent's process: set-points stop
    until(lambda: end.modes[2:] == [RETURN, LAND, HOLD])


def test_an_autopilot_that_falls_silent_has_no_position(fly):
    end, pilot = fly()
    end.mute.set()
    until(lambda: pilot.fix().position is None)
    with pytest.raises(AutopilotError, match="a fresh position before a move"):
        pilot.fly(1, LAW)
    end.mute.clear()
    until(lambda: pilot.fix().position is not None)
    pilot.fly(1, LAW)


def test_one_that_will_not_arm_is_one_line(fly):
    _, pilot = fly(up=False, refuse={mavlink.MAV_CMD_COMPONENT_ARM_DISARM})
    with pytest.raises(AutopilotError, match="is 'command denied'; expected to arm and take off") as caught:
        pilot.take_off(30.0, 10.0)
    assert "\n" not in str(caught.value)


def test_no_autopilot_and_no_address_are_one_line():
    port = free_port()
    with pytest.raises(AutopilotError, match=r"a heartbeat within 0\.5 s"):
        Autopilot(f"udp://127.0.0.1:{port}", FRAME, patience=0.5)
    with pytest.raises(UsageError, match="--autopilot: is 'nonsense'"):
        Autopilot("nonsense", FRAME)
    with pytest.raises(UsageError, match="an address that is free"):
        Autopilot("udp://192.0.2.77:14540", FRAME)  # not this machine's
