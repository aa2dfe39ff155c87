"""The onlooker's picture: what it tells of a step, and each alert, said once."""

import math

import pytest

from skyrelay.airspace.law import Law
from skyrelay.chain.abi import Event
from skyrelay.core.resolved import resolve
from skyrelay.core.scenario import validate
from skyrelay.core.zones import ZoneGrid
from skyrelay.pilot.picture import KEPT_PERIODS, NO_BLOCK, Picture
from skyrelay.protocol.messages import Beacon
from skyrelay.runfolder.feed import Uav, Vehicle

GRID = ZoneGrid(0.0, 0.0, 1000.0, 2, 1)
SCENARIO = resolve(
    validate(
        {
            "fleet": {"range": 300.0},
            "coordination": {"steps": 40, "period_steps": 10, "step_seconds": 2.0, "patience": 5.0},
            "energy": {"reserve": 10.0},
        }
    ),
    GRID,
)
A, B, C, V, W = (f"0x{number:040x}" for number in range(1, 6))
NAMES = {A: "u1", B: "u2", C: "u3", V: "v1", W: "v2"}


def event(name, block=1, **arguments):
    return Event(name, arguments, block, 0, 0)


def uav(picture, address, x, y=500.0, battery=50.0, *, step=None, zone=1):
    step = picture.step + 1 if step is None else step
    picture.take(Beacon(address, zone, None, (x, y), 2.0 * step, battery=battery), 2.0 * step)


def vehicle(picture, address, to, x, y=500.0, *, step=None):
    step = picture.step if step is None else step
    position = None if x is None else (x, y)
    picture.take(Beacon(address, 1, to, position, 2.0 * step), 2.0 * step)


@pytest.fixture
def picture():
    """Two UAVs at work and one idle; two vehicles, of which the first is served."""
    picture = Picture(Law.of(SCENARIO, GRID), SCENARIO.coordination, NAMES)
    for number, address in enumerate((A, B, C)):
        where = {"x": 1000 * number, "y": 5000, "altitude": 100, "battery": 4000}
        picture.hear(event("UAVRegistered", uav=address, index=number, reputation=0, bandwidth=0, **where))
        picture.hear(event("UAVZoneUpdated", uav=address, **{"from": 0, "to": 1}))
    for address, x in ((V, 1000), (W, 9000)):
        picture.hear(event("VehicleRegistered", vehicle=address, x=x, y=5000, payment=1, reputation=0, zone=1))
    picture.mined()
    picture.hear(event("UAVAllocated", uav=A, zone=1, selected=[V]))
    picture.hear(event("UAVAllocated", uav=B, zone=1, selected=[W]))
    return picture


def fly(picture, steps, **batteries):
    """Both UAVs at work tell where they are, step by step; what was told of each."""
    records = []
    for _ in range(steps):
        for address in (A, B):
            uav(picture, address, 100.0, battery=batteries.get(NAMES[address], 50.0))
        assert picture.behind
        picture.advance()
        records.append(picture.record())
    return records


def alerts(records):
    return [(alert.kind, alert.about) for record in records for alert in record.alerts]


def test_a_step_is_told_as_it_was_heard(picture):
    first = picture.record()
    assert [told.name for told in first.events][-1] == "UAVAllocated"
    assert first.events[-1].arguments == ["uav", "u2", "zone", "1", "selected", "v2"]
    uav(picture, A, 390.0, battery=44.0)
    assert not picture.behind  # one alone may be ahead
    uav(picture, B, 950.0)
    assert picture.behind
    picture.advance()
    vehicle(picture, V, A, 101.5)
    record = picture.record()
    assert record.step == 0
    assert record.vehicles == [Vehicle("v1", 101.5, 500.0, "u1", True), Vehicle("v2", 900.0, 500.0, "u2", True)]
    assert record.uavs == [
        Uav("u1", 390.0, 500.0, 1, 44.0, True, 0.0),
        Uav("u2", 950.0, 500.0, 1, 50.0, True, 0.0),
        Uav("u3", 200.0, 500.0, 1, 40.0, False, None),
    ]
    vehicle(picture, V, A, 89.0)
    assert picture.record().vehicles[0].covered is False  # 301 m
    vehicle(picture, V, A, None)
    assert [told.id for told in picture.record().vehicles] == ["v2"]  # it has left the area


def test_a_beacon_of_a_step_that_has_not_begun_waits(picture):
    fly(picture, 1)
    vehicle(picture, V, A, 700.0, step=1)
    assert picture.record().vehicles[0].x == 100.0
    uav(picture, A, 100.0)
    uav(picture, B, 100.0)
    picture.advance()
    assert picture.record().vehicles[0].x == 700.0
    vehicle(picture, V, A, 5.0, step=0)  # older news comes late
    assert picture.record().vehicles[0].x == 700.0


def test_a_clock_that_is_ahead_moves_nobody_on_while_others_are_heard(picture):
    fly(picture, 1)
    uav(picture, A, 100.0, step=2)
    assert not picture.behind
    uav(picture, B, 100.0, step=1)
    picture.advance()
    assert picture.step == 1
    for step in range(2, 6):
        uav(picture, A, 100.0, step=step)
        assert not picture.behind
    uav(picture, A, 100.0, step=6)  # 8 s, and nobody else
    assert picture.behind


FUTURE = [40, 10**8]


@pytest.mark.parametrize("step", FUTURE)
def test_a_false_clock_blinds_nobody(picture, step):
    """A member's beacons from the run's end, or from beyond it, before all others': it goes on as without."""
    records = []
    for _ in range(25):
        uav(picture, C, 700.0, step=step)
        vehicle(picture, V, A, 101.0, step=step)
        for address in (A, B):
            uav(picture, address, 100.0 + picture.step)
        picture.advance()
        records.append(picture.record())
    assert [record.step for record in records] == list(range(25))
    assert all({told.id for told in record.uavs if told.age == 0.0} == {"u1", "u2"} for record in records)
    assert alerts(records) == []
    uav(picture, C, 300.0, step=24)  # its clock is set right
    assert {told.id: told.age for told in picture.record().uavs}["u3"] == 0.0


def test_one_that_is_ahead_while_all_wait_for_the_chain_moves_nobody_far_and_not_for_good(picture):
    fly(picture, 10)
    for second in range(0, 30, 2):  # between two periods only the false clock is heard, and the chain is in the second
        picture.hear(event("ZoneListsReset", zone=1, period=2, round=1))
        picture.take(Beacon(C, 1, None, (0.0, 0.0), 79.0), 20.0 + second)
    assert picture.behind
    picture.advance()
    assert picture.step == 20  # the second period's end
    for step in (10, 11):
        for address in (A, B):
            uav(picture, address, 600.0 + step, step=step)
    assert picture.clock == 22.0
    assert [told.x for told in picture.record().uavs[:2]] == [611.0, 611.0]


def test_events_belong_to_the_step_after_the_newest(picture):
    picture.record()
    fly(picture, 3)
    picture.hear(event("ZoneListsReset", zone=1, period=2, round=1))
    assert picture.record().events == []
    ahead = picture.record(ahead=True)
    assert (ahead.step, [told.name for told in ahead.events]) == (3, ["ZoneListsReset"])
    assert not any(told.selected for told in ahead.uavs)
    assert [told.uav for told in ahead.vehicles] == ["", ""]
    assert picture.record().step == 3  # never back


def test_a_vehicle_that_nobody_serves_goes_after_its_time(picture):
    picture.hear(event("ZoneListsReset", zone=1, period=2, round=1))
    steps = KEPT_PERIODS * 10
    assert [told.id for told in fly(picture, steps + 1)[-1].vehicles] == ["v1", "v2"]
    picture.hear(event("VehicleUpdated", vehicle=W, x=7000, y=5000, payment=1, zone=1))
    assert [(told.id, told.x) for told in fly(picture, 1)[-1].vehicles] == [("v2", 700.0)]


def test_a_low_battery_is_said_once_and_again_after_a_charge(picture):
    assert alerts(fly(picture, 2, u1=12.5)) == []
    assert alerts(fly(picture, 3, u1=12.0)) == [("low-battery", "u1")]
    assert alerts(fly(picture, 1, u1=60.0)) == []
    assert alerts(fly(picture, 1, u1=11.0)) == [("low-battery", "u1")]


def test_a_uav_that_lands_is_said(picture):
    fly(picture, 1)
    picture.hear(event("UAVZoneUpdated", uav=A, **{"from": 1, "to": 0}))
    assert picture.record().uavs[0].zone == 1  # in the step that has begun it flies
    record = picture.record(ahead=True)
    assert record.alerts[0].kind == "low-battery"
    assert "u1 has landed" in record.alerts[0].text
    assert (record.uavs[0].zone, record.uavs[0].selected) == (0, False)


def test_a_silent_uav_is_said_after_its_patience_and_an_idle_one_is_not(picture):
    fly(picture, 1)
    records = []
    for _ in range(5):  # a third UAV's clock goes on with the second's
        for address in (B, C):
            uav(picture, address, 100.0)
        picture.advance()
        records.append(picture.record())
    assert alerts(records) == [("silent-uav", "u1")]
    assert records[1].alerts == []  # 4 s
    assert records[2].alerts != []  # 6 s
    assert records[2].uavs[0].age == 6.0
    assert alerts(fly(picture, 1)) == []
    for _ in range(3):
        for address in (B, C):
            uav(picture, address, 100.0)
        picture.advance()
    assert alerts([picture.record()]) == [("silent-uav", "u1")]


def test_all_of_them_silent_is_said_once_but_not_while_they_wait_for_the_chain(picture):
    fly(picture, 3)
    picture.judge(0.0, 4.9)
    picture.judge(0.0, 5.1)
    picture.judge(0.0, 6.0)
    assert alerts([picture.record()]) == [("silent-uav", "")]
    fly(picture, 7)
    picture.judge(0.0, 6.0)
    assert alerts([picture.record()]) == []


def test_an_allocation_is_late_well_after_its_period_began(picture):
    for steps, late in ((0, False), (1, False), (3, True), (5, False), (1, False)):
        fly(picture, steps)  # up to step 0, 0, 3, 8, 9
        picture.hear(event("ZoneAllocated", zone=2, period=1, round=1, selectedUAVs=0, selectedVehicles=0))
        assert alerts([picture.record()]) == ([("late-allocation", "2")] if late else []), picture.step


def test_a_chain_without_blocks_may_have_no_quorum(picture):
    fly(picture, 10)
    picture.judge(NO_BLOCK - 1, NO_BLOCK + 5)  # the next period's selection goes on
    assert alerts([picture.record()]) == []
    picture.judge(NO_BLOCK + 1, NO_BLOCK + 1)
    picture.judge(NO_BLOCK + 2, NO_BLOCK + 2)
    assert alerts([picture.record()]) == [("no-quorum", "")]
    picture.mined()
    picture.judge(0.0, NO_BLOCK + 2)
    assert alerts([picture.record()]) == []


def test_a_fleet_that_flies_on_for_a_period_without_a_block_says_so_too(picture):
    fly(picture, 1)
    picture.mined()
    records = fly(picture, 12)
    picture.judge(26.0, 0.0)
    assert alerts([*records, picture.record()]) == []  # 24 s of 20 s and 5 s
    fly(picture, 1)
    picture.judge(28.0, 0.0)
    assert alerts([picture.record()]) == [("no-quorum", "")]


def test_at_the_end_of_the_run_nobody_is_missed(picture):
    fly(picture, 40)
    picture.judge(math.inf, math.inf)
    assert alerts([picture.record()]) == []
