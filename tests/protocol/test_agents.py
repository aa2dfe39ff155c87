"""Agents by themselves: what they want done about what they are told, and that they know nothing else."""

import numpy as np
import pytest

from skyrelay.airspace.maps import map_names
from skyrelay.airspace.observation import Observer, Scene
from skyrelay.chain.abi import ContractError, Event
from skyrelay.chain.client import ProposalStatus
from skyrelay.core.errors import ProtocolError
from skyrelay.protocol.authority import ReputationAuthority
from skyrelay.protocol.coordinator import ZoneCoordinator
from skyrelay.protocol.messages import (
    Beacon,
    ChangeZone,
    Decide,
    Decided,
    DetermineModel,
    Fix,
    Mined,
    Move,
    Phase,
    ReadZone,
    Refused,
    RegisterVehicle,
    SetReputations,
    Tick,
)
from skyrelay.protocol.sequence import UavState, VehicleState, ZoneState
from skyrelay.protocol.sight import decide


def test_a_period_is_played_by_the_agents_alone(town):
    town.select()
    served = [name for name in ("v1", "v2", "v3", "v4", "v5") if town[name].state is VehicleState.SERVED]
    on_chain = town.client.vehicle_selections([town[name].address for name in served])
    assert served
    assert [(status, uav) for status, uav, _ in on_chain] == [
        (ProposalStatus.SELECTED, town[name].uav) for name in served
    ]
    flying = {agent.address for agent in town.agents if agent.state is UavState.FLYING}
    assert flying == {uav for _, uav, _ in on_chain}
    assert set(town.fly(0)) == flying
    town.tick(Phase.CLOSE)
    assert {agent.state for agent in town.agents} <= {VehicleState.IDLE, UavState.AVAILABLE, ZoneState.COLLECTING}


def test_one_that_is_started_again_stands_where_the_chain_says(town):
    town.select()
    again = town.fresh_agents()
    for agent in again:
        for event in town.client.events():
            if event.name in agent.HEARS or agent.address in event.args.values():
                agent.receive(event)
    # What only a look at the zone or a loaded policy tells is done anew.
    for lived, began in zip(town.agents, again, strict=True):
        if lived.state is UavState.FLYING:
            assert began.state is UavState.SELECTED
            (wish,) = began.receive(Tick(Phase.BEACON))  # no beacon yet: it has no fix
            assert wish.model == town.client.model_of_zone(lived.tuned_in).model_id
        elif lived.state is VehicleState.UNSERVED:
            assert began.state in {VehicleState.IDLE, VehicleState.UNSERVED}
        else:
            assert began.state is lived.state
        assert getattr(began, "uav", None) == getattr(lived, "uav", None)


def without_coordinators(town, *phases, step=0):
    """Ticks at which they are away."""
    agents = town.host.agents
    town.host.agents = [agent for agent in agents if not isinstance(agent, ZoneCoordinator)]
    town.tick(*phases, step=step)
    town.host.agents = agents


@pytest.mark.parametrize("away", [(Phase.ALLOCATE,), (Phase.ALLOCATE, Phase.DETERMINE), (Phase.DETERMINE,)])
def test_a_coordinator_that_was_away_does_what_is_left_when_it_is_back(town, away):
    town.tick(Phase.CLOSE, Phase.LAND, Phase.REPORT, Phase.PROPOSE)
    for phase in (Phase.ALLOCATE, Phase.DETERMINE):
        (without_coordinators if phase in away else type(town).tick)(town, phase)
    for step in range(3):
        moves = town.fly(step)
    flying = {agent.address for agent in town.agents if agent.state is UavState.FLYING}
    assert set(moves) == flying
    assert len(flying) > 1
    names = [event.name for event in town.events]
    assert names.count("ZoneAllocated") == names.count("ModelAssigned") == 2  # of two zones, once each


def test_a_coordinator_that_was_away_closes_the_period_before_a_new_one_opens(town):
    town.select()
    town.fly(0)
    without_coordinators(town, Phase.CLOSE, Phase.LAND, step=1)
    town.tick(Phase.REPORT, step=1)
    town.tick(Phase.RATE, Phase.PROPOSE, Phase.ALLOCATE, Phase.DETERMINE, step=1)
    names = [event.name for event in town.events]
    assert names.count("ZoneListsReset") == 2
    assert names.count("ModelAssigned") == 4
    assert town.fly(1)


def test_a_coordinator_does_not_ask_again_and_again_for_what_is_refused(town):
    town.tick(Phase.CLOSE, Phase.LAND, Phase.REPORT, Phase.PROPOSE, Phase.ALLOCATE)
    coordinator = next(agent for agent in town.agents if isinstance(agent, ZoneCoordinator))
    (call,) = coordinator.receive(Tick(Phase.DETERMINE))
    assert isinstance(call, DetermineModel)
    coordinator.receive(Refused(call, ContractError("determineMDRLModel", "NoModel", {})))
    for step in range(3):
        assert coordinator.receive(Tick(Phase.BEACON, step=step)) == ()


def test_a_call_that_is_under_way_is_not_made_twice(town):
    vehicle = town.fresh_agents()[0]
    vehicle.receive(Fix((450.0, 600.0)))
    (call,) = vehicle.receive(Tick(Phase.REPORT))
    assert isinstance(call, RegisterVehicle)
    assert vehicle.receive(Tick(Phase.REPORT)) == ()
    vehicle.receive(Refused(call, ContractError("registerVehicle", "Full", {})))
    assert vehicle.receive(Tick(Phase.REPORT)) == (call,)
    record = {"x": 4500, "y": 6000, "payment": 300, "zone": 1}
    vehicle.receive(Event("VehicleRegistered", {"vehicle": vehicle.address} | record, 1, 0, 0))
    vehicle.receive(Mined(call))
    assert vehicle.receive(Tick(Phase.PROPOSE)) == (ReadZone(1),)


def test_an_event_that_the_table_does_not_allow_raises(town):
    vehicle = town["v1"]
    with pytest.raises(ProtocolError, match="vehicle v1"):
        vehicle.receive(Event("VehSelectionSubmitted", {"vehicle": vehicle.address, "uav": "0x"}, 1, 0, 0))


def test_a_uav_whose_battery_is_spent_leaves_and_its_mates_forget_it(town):
    town.select()
    sights = _sights(town, 0)
    assert len(sights["u1"].team) == 2
    town["u2"].receive(Fix((900.0, 900.0), 2.0))
    assert town["u2"].receive(Tick(Phase.LAND)) == (ChangeZone(0),)
    town["u2"].receive(Mined(ChangeZone(0)))
    town.tick(Phase.LAND)
    assert town["u2"].state is UavState.RETIRED
    assert len(_sights(town, 1)["u1"].team) == 1


def test_a_decision_is_a_uav_s_own_whoever_shares_its_process(town):
    town.select()
    together = town.fly(0)
    for name, sight in _sights(town, 0).items():
        assert decide(town.policy, [sight]) == [together[town[name].address]]


def test_an_old_beacon_narrows_what_is_safe_and_a_very_old_one_does_not_count(town):
    """u1 hears u2 no more; what it knows of u2 ages while it decides on."""
    town.select()
    silent = town["u2"].address
    town.fly(0)
    margins, mates = [], []
    for step in range(1, 8):
        town.tick(Phase.BEACON, step=step)
        town.host.hear(beacon for beacon in town.host.take_beacons() if beacon.sender != silent)
        (wish,) = town["u1"].receive(Tick(Phase.DECIDE, step=step, time=step * 2.0))
        assert isinstance(wish, Decide)
        mates.append((900.0, 900.0) in wish.sight.team)
        margins.append(max(wish.sight.margins))
    assert margins[:5] == [60.0, 120.0, 180.0, 240.0, 300.0]
    assert mates == [True] * 5 + [False] * 2


def test_a_margin_leaves_fewer_safe_moves():
    names = map_names(obstacles=False, energy=False, outlook=True)

    def safe(margin):
        held = np.full((2, 2), 900.0 - margin)
        uavs, vehicle = np.array([[500.0, 500.0], [1200.0, 500.0]]), np.array([[500.0, 500.0]])
        scene = Scene.in_metres(uavs, vehicle, np.array([0]), (0.0, 0.0), 2000.0, 900.0, step=60.0, held=held)
        maps = Observer(names, 11, 3).look(scene, seers=1)[0]
        return int(maps[names.index("safe_moves")].sum())

    fresh, old, older = safe(0.0), safe(100.0), safe(200.0)
    assert fresh == 9
    assert fresh > old > older >= 1


def test_a_beacon_that_comes_late_does_not_hide_a_later_one(town):
    town.select()
    town.fly(0)
    u1, mate = town["u1"], town["u2"].address
    u1.receive(Tick(Phase.BEACON, step=2, time=4.0))
    u1.receive(Beacon(mate, 1, None, (800.0, 800.0), 4.0))
    u1.receive(Beacon(mate, 1, None, (100.0, 100.0), 2.0))
    (wish,) = u1.receive(Tick(Phase.DECIDE, step=2, time=4.0))
    assert (800.0, 800.0) in wish.sight.team
    assert (100.0, 100.0) not in wish.sight.team


def test_a_beacon_from_the_future_does_not_hide_those_that_are_true(town):
    town.select()
    town.fly(0)
    u1, mate = town["u1"], town["u2"].address
    u1.receive(Tick(Phase.BEACON, step=1, time=2.0))
    u1.receive(Beacon(mate, 1, None, (100.0, 100.0), 1e9))
    u1.receive(Beacon(mate, 1, None, (800.0, 800.0), 2.0))
    (wish,) = u1.receive(Tick(Phase.DECIDE, step=1, time=2.0))
    assert (800.0, 800.0) in wish.sight.team
    assert (100.0, 100.0) not in wish.sight.team


def test_a_vehicle_that_has_left_says_so_and_is_no_longer_followed(town):
    town.select()
    vehicle = next(agent for agent in town.agents if agent.state is VehicleState.SERVED)
    uav = next(agent for agent in town.agents if agent.address == vehicle.uav)
    town.fly(0)
    vehicle.receive(Fix(None))
    before, after = (len(s[uav.name].vehicles) for s in (_sights(town, 0, beacons=False), _sights(town, 1)))
    assert after == before - 1


def test_a_uav_without_a_fix_says_and_does_nothing_that_needs_one(town):
    town.select()
    uav = next(agent for agent in town.agents if agent.state is UavState.FLYING)
    uav.receive(Fix(None, 80.0))
    for phase in (Phase.BEACON, Phase.DECIDE, Phase.REPORT, Phase.LAND):
        assert tuple(uav.receive(Tick(phase))) == ()
    new = next(agent for agent in town.fresh_agents() if agent.name == uav.name)
    for phase in (Phase.JOIN, Phase.REPORT, Phase.LAND):
        assert tuple(new.receive(Tick(phase))) == ()
    new.receive(Fix((10.0, 20.0), 80.0))
    (call,) = new.receive(Tick(Phase.REPORT))
    assert (call.record.x, call.record.y) == (10.0, 20.0)


def test_a_decision_becomes_a_move(town):
    town.select()
    town.tick(Phase.BEACON)
    (wish,) = town["u1"].receive(Tick(Phase.DECIDE))
    (action,) = decide(wish.policy, [wish.sight])
    assert town["u1"].receive(Decided(action)) == (Move(action),)


def test_the_authority_rates_each_newcomer_that_it_knows_once():
    authority = ReputationAuthority("0xa", {"0x1": 40.0, "0x2": 60.0})
    for member in ("0x1", "0x2", "0x3"):
        authority.receive(Event("VehicleRegistered", {"vehicle": member}, 1, 0, 0))
    (call,) = authority.receive(Tick(Phase.RATE))
    assert call == SetReputations({"0x1": 40.0, "0x2": 60.0})
    authority.receive(Event("ReputationSet", {"member": "0x1", "reputation": 4000}, 2, 0, 0))
    assert authority.receive(Tick(Phase.RATE)) == [SetReputations({"0x2": 60.0})]


def _sights(town, step, beacons=True):
    """What each flying UAV would decide on."""
    if beacons:
        town.tick(Phase.BEACON, step=step)
        town.host.hear(town.host.take_beacons())
    tick = Tick(Phase.DECIDE, step=step, time=step * 2.0)
    return {agent.name: agent.receive(tick)[0].sight for agent in town.agents if agent.state is UavState.FLYING}


@pytest.mark.parametrize(
    ("keys", "stays"),
    [
        ({}, 0),
        ({"time_to_trigger": 2}, 2),
        ({"time_to_trigger": 1, "hysteresis": 5.0}, 1),
        ({"time_to_trigger": 1, "hysteresis": 50.0}, 4),
    ],
)
def test_a_vehicle_leaves_its_uav_once_another_has_been_better_for_long_enough(town_with, keys, stays):
    town = town_with(**keys)
    town.select()
    first = town["v1"].uav
    assert first == town["u1"].address
    town.places["v1"] = (890.0, 890.0)  # beside u2
    asked = []
    for _ in range(4):
        town.tell_positions()
        town.select()
        asked.append(town["v1"].choice.uav)
    assert asked == [first] * stays + [town["u2"].address] * (4 - stays)


def test_who_is_better_now_and_then_has_not_been_so_for_long(town_with):
    town = town_with(time_to_trigger=1)
    town.select()
    first = town["v1"].uav
    for place in ((890.0, 890.0), (450.0, 600.0), (890.0, 890.0)):
        town.places["v1"] = place
        town.tell_positions()
        town.select()
        assert town["v1"].choice.uav == first
