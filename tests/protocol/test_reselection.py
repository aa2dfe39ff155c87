"""A selection again within a period: who comes, who goes, and whose UAV leaves."""

import pytest

from skyrelay.protocol.messages import RESELECTION, Fix, Phase, Tick, UpdateVehicle
from skyrelay.protocol.sequence import UavState, VehicleState, ZoneState

AWAY = (-5000.0, 0.0)


@pytest.fixture
def full(town_with):
    """A town whose one UAV in reach, u1, has room for two vehicles; v4 is not there yet."""
    town = town_with(rounds=1)
    town.places |= {"u2": AWAY, "u3": AWAY}
    town.tell_positions()
    town["v4"].receive(Fix(None))
    town.select()
    town.fly(0)
    return town


def served(town):
    return {agent.name for agent in town.agents if agent.state is VehicleState.SERVED}


def reselect(town, step=5):
    before = len(town.events)
    town.tick(*RESELECTION, step=step)
    return [event for event in town.events[before:] if event.name != "ReputationSet"]


def test_the_place_of_who_leaves_goes_to_who_comes(full):
    first = served(full)
    gone = min(first - {"v5"})
    full[gone].receive(Fix(None))
    full["v4"].receive(Fix((950.0, 1000.0)))
    events = reselect(full)
    assert full[gone].state is VehicleState.GONE
    assert [event.args["vehicle"] for event in events if event.name == "VehSelectionWithdrawn"] == [full[gone].address]
    assert [event.args["vehicle"] for event in events if event.name == "VehSelectionSubmitted"] == [full["v4"].address]
    assert served(full) == first - {gone} | {"v4"}
    zone = next(agent for agent in full.agents if agent.name == "coordinator of zone 1")
    assert zone.state is ZoneState.COORDINATING
    assert full["u1"].state is UavState.FLYING


def test_who_finds_no_room_writes_nothing(full):
    full["v3"].receive(Fix((1200.0, 700.0)))
    assert full["v3"].state is VehicleState.UNSERVED
    assert reselect(full) == []


def test_whose_uav_lands_is_without_one_when_it_is_time_to_ask(full):
    full["u4"].receive(Fix((3000.0, 1000.0), 1.0))
    full.tick(Phase.LAND, step=4)
    assert full["u4"].state is UavState.RETIRED
    assert full["v5"].state is VehicleState.SERVED
    reselect(full)
    assert full["v5"].state is VehicleState.UNSERVED


def test_a_uav_without_vehicles_left_is_free_and_tells_where_it_is_if_somebody_seeks(full):
    full["v5"].receive(Fix(None))
    events = reselect(full)
    assert full["u4"].state is UavState.AVAILABLE
    assert [event.name for event in events] == ["VehSelectionWithdrawn", "VehicleUpdated"]
    full["v3"].receive(Fix((2500.0, 900.0)))
    reselect(full, 6)  # it has crossed into zone 2, and asks there
    assert full["v3"].uav == full["u4"].address
    assert full["v3"].state is VehicleState.SERVED
    full.fly(7)
    assert full["u4"].state is UavState.FLYING


def test_who_leaves_writes_no_zone_of_its_own(full):
    full["v5"].receive(Fix(None))
    (call,) = full["v5"].receive(Tick(Phase.LEAVE))
    assert isinstance(call, UpdateVehicle)
    assert (call.record.x, call.record.y, call.record.zone) == (3100.0, 900.0, 0)
