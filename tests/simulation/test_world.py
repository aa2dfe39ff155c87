from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrelay.airspace.law import Law
from skyrelay.core.errors import ScenarioError
from skyrelay.core.resolved import resolve
from skyrelay.core.scenario import Demand, load_scenario
from skyrelay.core.zones import ZoneGrid
from skyrelay.mobility import Tracks, load_tracks
from skyrelay.simulation.world import World, _apportion, deploy_fleet, draw_members


@pytest.fixture(scope="module")
def tracks():
    return load_tracks(load_scenario())


@given(st.lists(st.integers(0, 500), min_size=1, max_size=30), st.integers(1, 200))
def test_every_uav_gets_a_zone_and_every_zone_one_where_there_are_enough(counts, uavs):
    shares = _apportion(np.array(counts), uavs)
    assert shares.sum() == uavs
    assert (shares >= (1 if uavs >= len(counts) else 0)).all()


@given(st.lists(st.integers(1, 500), min_size=2, max_size=30, unique=True))
def test_more_traffic_never_means_fewer_uavs(counts):
    shares = _apportion(np.array(counts), 50)
    assert (np.diff(shares[np.argsort(counts)]) >= 0).all()


def test_a_fleet_is_drawn_by_its_seed_within_the_paper_s_bounds(tracks):
    first, again, other = (_fleet(load_scenario(seed=seed), tracks) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.battery, again.battery)
    np.testing.assert_array_equal(first.x, again.x)
    assert (first.battery != other.battery).any()
    assert first.bandwidth.min() >= 0
    assert first.bandwidth.max() <= 20_000
    assert first.battery.min() >= 1
    assert first.battery.max() <= 100


def test_uavs_are_deployed_inside_their_zone_and_nearer_to_the_traffic_than_chance(tracks):
    scenario = load_scenario()
    grid = _grid(tracks)
    fleet = _fleet(scenario, tracks)
    assert (grid.zone_of(fleet.x, fleet.y) == fleet.zone).mean() > 0.95  # a centre may lie on a border
    there = np.isfinite(tracks.x[0])
    points = np.column_stack([tracks.x[0][there], tracks.y[0][there]])

    def nearest(positions):
        return np.hypot(*(points[:, None] - positions[None]).T).min(axis=0).mean()

    random = np.random.default_rng(0)
    x0, y0 = grid.corner(1)
    chance = [nearest(np.array([x0, y0]) + random.uniform(0, grid.side * 3, (len(fleet.ids), 2))) for _ in range(20)]
    assert nearest(np.column_stack([fleet.x, fleet.y])) < min(chance)


def test_an_area_without_traffic_still_gets_its_fleet():
    empty = Tracks(("a",), np.array([[np.nan], [5.0]]), np.array([[np.nan], [5.0]]), (0.0, 0.0, 900.0, 900.0))
    fleet = _fleet(load_scenario(), empty)
    assert np.isfinite(fleet.x).all()
    assert sorted(np.unique(fleet.zone)) == list(range(1, 10))


def test_members_are_whole_numbers_in_the_contract_s_units():
    members = draw_members(Demand(bandwidth=(0.002, 0.003)), 1, 1000)
    assert set(members.demand) == {2, 3}
    assert np.issubdtype(members.payment.dtype, np.integer)
    assert members.payment.max() <= 700


def test_draining_never_goes_below_zero_and_spares_the_landed(tracks):
    scenario = load_scenario()
    law = replace(Law.of(resolve(scenario, _grid(tracks)), _grid(tracks)), seconds=60.0)
    fleet = _fleet(scenario, tracks)
    fleet.zone[0] = 0
    before = fleet.battery.copy()
    moved = np.zeros(len(fleet.ids), dtype=bool)
    moved[1] = True
    fleet.drain(law, moved)
    spent = before - fleet.battery
    assert spent[0] == 0
    assert spent[1] == pytest.approx(min(5.0, before[1]))
    np.testing.assert_allclose(spent[2:], np.minimum(4.0, before[2:]))
    fleet.drain(replace(law, seconds=1e6), moved)
    assert fleet.battery[1:].max() == 0


def _grid(tracks):
    west, south, east, north = tracks.box
    return ZoneGrid.over(west, south, east, north, 3, 3)


def _fleet(scenario, tracks):
    return deploy_fleet(scenario.fleet, scenario.seed, tracks, _grid(tracks))


HOUSE = "{polygon = [[%g, %g], [%g, %g], [%g, %g]], height = 20}"


def with_houses(*houses):
    listed = ", ".join(HOUSE % house for house in houses)
    return load_scenario("bologna", ["mobility.source=manhattan", f"obstacles.buildings=[{listed}]"])


@pytest.mark.parametrize("house", [(11.34, 44.49, 11.341, 44.49, 11.341, 44.491), (6010, 0, 6100, 0, 6100, 60)])
def test_buildings_that_stand_nowhere_are_refused_with_the_area(house):
    with pytest.raises(ScenarioError, match=r"obstacles\.buildings.*x 0 to 6000 m and y 0 to 6000 m") as fault:
        World.of(with_houses(house))
    assert len(str(fault.value).splitlines()) == 1


def test_some_buildings_may_stand_beyond_the_area():
    world = World.of(with_houses((10, 10, 90, 10, 90, 60), (9000, 0, 9090, 0, 9090, 60)))
    assert len(world.scenario.obstacles.buildings) == 2
