"""What a UAV's agent does about its battery, where there are charging places."""

from dataclasses import replace

import numpy as np
import pytest

from skyrelay.airspace.charging import Places
from skyrelay.airspace.law import Law
from skyrelay.chain.abi import Event
from skyrelay.core.scenario import Energy
from skyrelay.core.zones import ZoneGrid
from skyrelay.protocol.messages import (
    ChangeZone,
    Fix,
    Mined,
    Move,
    Phase,
    ReadStation,
    StationRead,
    Tick,
    UpdateUav,
)
from skyrelay.protocol.rule import Rule
from skyrelay.protocol.sequence import UavState
from skyrelay.protocol.uav import UavAgent

POINTS = np.array([[3000.0, 500.0], [500.0, 500.0]])
PLACES = Places(("far", "near"), POINTS, np.array([1, 1]), np.array([1.0, 1.0]))
ENERGY = Energy(hover_per_minute=30.0, move_per_minute=60.0, reserve=5.0)  # a move of 2 s takes 2 %
LAW = Law(ZoneGrid(0.0, 0.0, 2000.0, 2, 1), 900.0, 30.0, 2.0, ENERGY, None, 10.0, places=PLACES, rotates=True)


def no_policy(_):
    raise AssertionError("nothing is loaded")


def agent(law=LAW, rule=None):
    uav = UavAgent("u1", "0xu1", 1, 100.0, 4000, law, no_policy)
    told(uav, "UAVRegistered", uav="0xu1")
    told(uav, "UAVZoneUpdated", uav="0xu1", **{"from": 0, "to": 1})
    uav.policy = rule
    return uav


def told(member, name, **args):
    return member.receive(Event(name, args, 0, 0, 0))


def away(law=LAW, rule=None, battery=40.0):
    """One that has left."""
    uav = agent(law, rule)
    told(uav, "UAVZoneUpdated", uav="0xu1", **{"from": 1, "to": 0})
    uav.receive(Fix((500.0, 500.0), battery))
    assert uav.state is UavState.CHARGING
    return uav


def test_it_leaves_in_time_and_flies_straight_to_the_nearest_point_however_slow_the_chain_is():
    uav = agent()
    # 300 m away: in a step the way takes 6 more, and it may begin one late: (1 + 7) moves and the reserve.
    uav.receive(Fix((800.0, 500.0), 21.1))
    assert uav.receive(Tick(Phase.LAND)) == ()
    uav.receive(Fix((800.0, 500.0), 20.9))
    assert uav.receive(Tick(Phase.LAND)) == (ChangeZone(0),)
    assert uav.state is UavState.AVAILABLE
    assert uav.receive(Tick(Phase.DECIDE)) == (Move(10),)
    told(uav, "UAVZoneUpdated", uav="0xu1", **{"from": 1, "to": 0})
    assert uav.state is UavState.CHARGING
    uav.receive(Fix((2000.0, 500.0), 15.0))
    assert uav.receive(Tick(Phase.DECIDE)) == (Move(9),)
    assert uav.receive(Tick(Phase.LAND)) == ()
    assert uav.receive(Tick(Phase.BEACON)) == ()


def test_it_stays_on_the_books_and_comes_back_by_the_plan_of_all():
    uav = away()
    (report,) = uav.receive(Tick(Phase.REPORT))
    assert isinstance(report, UpdateUav)
    assert report.record.battery == 40.0
    told(uav, "UAVUpdated", uav="0xu1")
    assert uav.receive(Tick(Phase.DISPATCH)) == (ReadStation(LAW),)
    assert uav.receive(StationRead(2)) == (ChangeZone(2),)
    uav.receive(Mined(ChangeZone(2)))
    told(uav, "UAVZoneUpdated", uav="0xu1", **{"from": 0, "to": 2})
    assert (uav.state, uav.tuned_in) == (UavState.AVAILABLE, 2)
    assert uav.receive(StationRead(0)) == (ChangeZone(0),)


@pytest.mark.parametrize(("rule", "enough"), [(None, 100.0), (Rule("recharge", lambda _: 0), 50.0)])
def test_alone_it_comes_back_to_its_zone_once_it_has_enough(rule, enough):
    uav = away(replace(LAW, rotates=False), rule)
    uav.receive(Fix((500.0, 500.0), enough - 0.1))
    assert uav.receive(Tick(Phase.DISPATCH)) == ()
    uav.receive(Fix((500.0, 500.0), enough))
    assert uav.receive(Tick(Phase.DISPATCH)) == (ChangeZone(1),)


def test_the_rule_recharge_has_its_own_say():
    rule = Rule("recharge", lambda _: 0)
    assert away(rule=rule).receive(Tick(Phase.DISPATCH)) == ()
    flies = agent(replace(LAW, dispatch=True), rule)
    flies.receive(Fix((800.0, 500.0), 30.9))
    assert flies.receive(Tick(Phase.LAND)) == (ChangeZone(0),)  # five moves of 2 % sooner
    assert flies.receive(Tick(Phase.DISPATCH)) == (ReadStation(flies._law),)
    assert flies.receive(StationRead(0)) == ()


def test_without_a_position_it_is_not_called_home():
    uav = agent()
    uav.receive(Fix(None, 6.0))
    assert uav.receive(Tick(Phase.LAND)) == ()
    assert uav.receive(Tick(Phase.DECIDE)) == ()
