"""Charging places: whose turn it is, and that nobody stays away too long."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrelay.airspace.charging import FULL, NOWHERE, Pads, Places, straight, to_point
from skyrelay.airspace.flight import STAY, move
from skyrelay.airspace.law import Law
from skyrelay.core.resolved import resolve
from skyrelay.core.scenario import load_scenario
from skyrelay.core.zones import ZoneGrid

GRID = ZoneGrid(0.0, 0.0, 1000.0, 2, 1)
POINT = np.array([[500.0, 500.0]])


def law(*overrides, grid=GRID):
    told = ("energy.model=rotary-wing", "energy.places=2", "coordination.step_seconds=4", *overrides)
    return Law.of(resolve(load_scenario("bologna", told), grid), grid)


def pads(places=1, gain=10.0, uavs=3):
    return Pads(Places(("p",), POINT, np.array([places]), np.array([gain])), uavs)


def stand(pads, uavs, battery):
    """A step of UAVs that are at the point and stay there."""
    actions = np.zeros(pads.uavs, dtype=np.int8)
    actions[list(uavs)] = to_point(0)
    pads.land(actions, np.full(pads.uavs, 500.0), np.full(pads.uavs, 500.0), np.zeros(pads.uavs, dtype=int))
    gain = pads.charge(battery)
    return np.minimum(battery + gain, FULL)


def test_each_zone_has_a_point_where_none_is_listed_and_power_becomes_charge():
    places = law("energy.battery=100", "energy.charging_power=300", "energy.charging_point=[0.5, 0.25]").places
    assert places.points.tolist() == [[500.0, 250.0], [1500.0, 250.0]]
    assert places.places.tolist() == [2, 2]
    # 300 W for 4 s are a third of a watt-hour, of a hundred.
    assert places.gain == pytest.approx([1 / 3, 1 / 3])
    assert not law("energy.places=0").places


def test_what_is_listed_stands_for_the_zones_points():
    listed = law("energy.places=9", 'charging=[{name = "roof", x = 10, y = 20, places = 3, power = 70}]').places
    assert (listed.names, listed.places.tolist()) == (("roof",), [3])
    assert listed.gain == pytest.approx([100 * 70 * 4 / 3600 / 70])


def test_the_first_to_come_is_charged_first_and_makes_room_when_it_is_full():
    here, battery = pads(), np.array([50.0, 75.0, 10.0])
    battery = stand(here, [1], battery)
    assert (here.at.tolist(), battery.tolist()) == ([NOWHERE, 0, NOWHERE], [50.0, 85.0, 10.0])
    battery = stand(here, [0, 1], battery)
    assert (battery.tolist(), here.states(battery)[:2]) == ([50.0, 95.0, 10.0], ["waiting", "charging"])
    battery = stand(here, [0, 1, 2], battery)
    assert battery.tolist() == [50.0, 100.0, 10.0]
    battery = stand(here, [0, 1, 2], battery)
    assert (battery.tolist(), here.states(battery)) == ([60.0, 100.0, 10.0], ["charging", "full", "waiting"])


def test_who_takes_off_loses_its_turn_and_who_is_told_nothing_stays():
    here, battery = pads(), np.array([50.0, 50.0, 50.0])
    stand(here, [0], battery)
    stand(here, [1], battery)  # nobody tells the first: it has landed and stays
    assert here.at.tolist() == [0, 0, NOWHERE]
    here.land(np.array([1, STAY, STAY]), *np.full((2, 3), 500.0), np.zeros(3, dtype=int))
    assert here.at.tolist() == [NOWHERE, 0, NOWHERE]
    assert here.charge(battery).tolist() == [0.0, 10.0, 0.0]
    here.land(np.full(3, STAY), *np.full((2, 3), 500.0), np.array([0, 1, 0]))
    assert not here.landed.any()


@settings(max_examples=40, deadline=None)
@given(
    uavs=st.integers(1, 6),
    places=st.integers(1, 4),
    comes=st.lists(st.lists(st.booleans(), min_size=6, max_size=6), min_size=1, max_size=25),
)
def test_places_are_never_exceeded_nor_left_empty_while_someone_waits(uavs, places, comes):
    here, battery = pads(places, 7.0, uavs), np.linspace(20.0, 90.0, uavs)
    for step in comes:
        before, battery = battery, stand(here, [row for row in range(uavs) if step[row]], battery)
        hungry = here.landed & (before < FULL)
        assert here.charging.sum() == min(places, hungry.sum())
        assert (here.charging <= hungry).all()


def test_the_way_is_straight_and_ends_at_the_point():
    here = np.array([[0.0, 0.0], [500.0, 499.0], [500.0, 500.0]])
    there = straight(here, np.repeat(POINT, 3, axis=0), 100.0)
    np.testing.assert_allclose(there, [[100 / 2**0.5] * 2, [500.0, 500.0], [500.0, 500.0]])


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    speed=st.sampled_from([3.0, 10.0, 15.0, 30.0]),
    reserve=st.sampled_from([0.0, 3.0, 20.0]),
    battery=st.sampled_from([4.0, 10.0]),
    late=st.booleans(),
)
def test_whatever_a_uav_does_it_comes_to_a_charging_point_above_its_reserve(seed, speed, reserve, battery, late):
    """The hard law: any moves at all, and once it has to go even a step late."""
    rules = law(f"fleet.speed={speed}", f"energy.reserve={reserve}", f"energy.battery={battery}")
    random = np.random.default_rng(seed)
    place, charge = np.array([500.0, 500.0]), FULL
    outward = int(random.integers(1, 9))
    for _ in range(100_000):
        if rules.must_charge(charge, (place[0], place[1])):
            break
        action = outward if random.random() < 0.5 else int(random.integers(0, 9))
        place = move(place[None], np.array([action]), np.array(rules.stride), 0.0, np.array([2000.0, 1000.0]))[0]
        charge -= rules.cost.hover if action == STAY else rules.cost.move
    if late:
        charge -= rules.cost.hover
    (which,), (steps,) = rules.way_home(place[None])
    while (place != rules.places.points[which]).any():
        assert rules.places.nearest(place[None])[0][0] == which
        place = straight(place[None], rules.places.points[[which]], rules.stride)[0]
        charge -= rules.cost.move
        steps -= 1
    assert steps == 0
    assert charge >= reserve - 1e-9


def test_nobody_is_called_home_while_there_is_charge_for_more():
    rules = law()
    place = (500.0, 600.0)
    # Where it may be in a step the way takes two; a step late is allowed for.
    need = rules.energy.reserve + rules.worst + 3 * rules.cost.move
    assert rules.stride == 120.0
    assert not rules.must_charge(need + 1e-6, place)
    assert rules.must_charge(need - 1e-6, place)
    assert rules.must_charge(need + 1e-6, place, spare=1.0)
