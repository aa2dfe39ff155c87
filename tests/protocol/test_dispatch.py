"""Who goes to which zone between two periods."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrelay.chain.abi import Event
from skyrelay.core.zones import ZoneGrid
from skyrelay.protocol.dispatch import LEAST_GAIN, Books, plan

GRID = ZoneGrid(0.0, 0.0, 100.0, 3, 1)


def held(asked, zone, bandwidth):
    supply = np.bincount(zone - 1, bandwidth, len(asked))
    return np.minimum(asked, supply).sum()


def test_the_nearest_of_equals_goes_where_it_is_needed():
    place = np.array([[10.0, 50.0], [90.0, 50.0], [150.0, 50.0]])
    asked, zone, bandwidth = np.array([10e3, 30e3, 0.0]), np.array([1, 1, 2]), np.array([10e3, 10e3, 10e3])
    assert plan(asked, zone, bandwidth, place, GRID, 2500.0, 10.0).tolist() == [1, 2, 2]


def test_nobody_flies_further_than_to_a_neighbour():
    asked, zone, bandwidth = np.array([0.0, 0.0, 30e3]), np.array([1, 1]), np.array([10e3, 10e3])
    place = np.array([[50.0, 50.0], [50.0, 60.0]])
    assert plan(asked, zone, bandwidth, place, GRID, 2500.0, 10.0).tolist() == [1, 1]


def test_a_uav_leaves_a_zone_without_vehicles():
    asked = np.array([0.0, 30e3, 0.0])
    assert plan(asked, np.array([1]), np.array([8e3]), np.array([[50.0, 50.0]]), GRID, 2500.0, 10.0).tolist() == [2]


@pytest.mark.parametrize("count", [0, 1, 12])
@given(seed=st.integers(0, 2**32 - 1))
def test_every_move_is_worth_its_gain(count, seed):
    random = np.random.default_rng(seed)
    asked = random.uniform(0.0, 40e3, 3)
    zone, bandwidth = random.integers(1, 4, count), random.uniform(0.0, 20e3, count)
    place = random.uniform(0.0, 100.0, (count, 2)) * [3.0, 1.0]
    stations = plan(asked, zone, bandwidth, place, GRID, 2500.0, 10.0)
    moved = int((stations != zone).sum())
    assert held(asked, stations, bandwidth) - held(asked, zone, bandwidth) >= moved * LEAST_GAIN * 2500.0 - 1e-6
    assert (abs(stations - zone) <= 1).all()


def told(books, name, **args):
    books.hear(Event(name, args, 0, 0, 0))


def test_the_plan_stays_until_all_have_gone():
    books = Books()
    for uav, x in (("a", 10), ("b", 900)):
        told(books, "UAVRegistered", uav=uav, x=x, y=500, bandwidth=10000, battery=9000)
        told(books, "UAVZoneUpdated", uav=uav, **{"from": 0, "to": 1})
    told(books, "VehSelectionSubmitted", vehicle="v", demand=3000)
    told(books, "VehicleUpdated", vehicle="v", zone=2)
    assert books.moves(GRID, 10.0) == {"b": 2}
    told(books, "UAVZoneUpdated", uav="b", **{"from": 1, "to": 2})
    assert books.moves(GRID, 10.0) == {"b": 2}
    told(books, "VehSelectionSubmitted", vehicle="v", demand=3000)
    assert books.moves(GRID, 10.0) == {}


def test_nobody_moves_before_anything_was_asked_for():
    books = Books()
    told(books, "UAVRegistered", uav="a", x=10, y=500, bandwidth=10000, battery=9000)
    told(books, "UAVZoneUpdated", uav="a", **{"from": 0, "to": 1})
    told(books, "VehicleRegistered", vehicle="v", zone=2)
    assert books.moves(GRID, 10.0) == {}
