"""The bound: what no fleet can exceed, held against a second solver, brute force, and runs."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import maximum_flow

from skyrelay.core.errors import UsageError
from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.report.bound import LEVELS, bound, certified
from skyrelay.runfolder.reader import read_run
from skyrelay.simulation import play


def drawn(seed, uavs, vehicles):
    random = np.random.default_rng(seed)
    reach = random.random((uavs, vehicles)) < random.random()
    return reach, random.integers(0, 4000, vehicles).astype(float), random.integers(0, 9000, uavs).astype(float)


def flow(reach, demand, capacity):
    """The same by Dinic's algorithm, in whole kbit/s."""
    uavs, vehicles = reach.shape
    uav, vehicle = np.nonzero(reach)
    source, sink = uavs + vehicles, uavs + vehicles + 1
    rows = np.concatenate([np.full(uavs, source), uav, uavs + np.arange(vehicles)])
    columns = np.concatenate([np.arange(uavs), uavs + vehicle, np.full(vehicles, sink)])
    room = np.concatenate([capacity, np.full(len(uav), 10**6), demand]).astype(np.int32)
    return maximum_flow(coo_array((room, (rows, columns)), shape=(sink + 1, sink + 1)).tocsr(), source, sink).flow_value


@given(seed=st.integers(0, 2**32 - 1), uavs=st.integers(1, 6), vehicles=st.integers(1, 12))
def test_a_second_solver_finds_the_same(seed, uavs, vehicles):
    reach, demand, capacity = drawn(seed, uavs, vehicles)
    assert certified(reach, demand, capacity).sum() == pytest.approx(flow(reach, demand, capacity), abs=1e-3)


@given(seed=st.integers(0, 2**32 - 1))
def test_no_selection_of_whole_vehicles_has_more(seed):
    reach, demand, capacity = drawn(seed, 2, 4)
    best = 0.0
    for owners in product((-1, 0, 1), repeat=4):
        load = np.array([demand[[owner == uav for owner in owners]].sum() for uav in (0, 1)])
        allowed = all(owner < 0 or reach[owner, vehicle] for vehicle, owner in enumerate(owners))
        if allowed and (load <= capacity).all():
            best = max(best, load.sum())
    assert certified(reach, demand, capacity).sum() >= best - 1e-6


@pytest.fixture(scope="module", params=[False, True])
def folder(request, tmp_path_factory):
    made = tmp_path_factory.mktemp("bound")
    keys = [
        "mobility.source=manhattan",
        "mobility.area=2000",
        "mobility.vehicles=30",
        "zones.columns=2",
        "zones.rows=2",
        "fleet.uavs=6",
        "coordination.steps=12",
        "coordination.period_steps=4",
        "coordination.policy=serve",
        f"coordination.dispatch={str(request.param).lower()}",
    ]
    play(load_scenario("bologna", keys, 3), made, Silent())
    return made


def test_a_run_is_below_its_bounds_and_each_bound_below_the_one_before(folder):
    levels = bound(folder)
    assert [level.level for level in levels] == list(LEVELS)
    assert all(0.0 < (level.share or 0.0) <= 1.0 for level in levels)
    free, periods, zones = levels
    assert free.mbps >= periods.mbps - 1e-9 >= zones.mbps - 2e-9
    assert free.mbps <= min(free.capacity, free.demand) + 1e-9
    assert sum(zones.by_zone.values()) == pytest.approx(zones.mbps)


def test_a_step_that_is_none_is_refused(folder):
    with pytest.raises(UsageError, match="from 1 on"):
        bound(folder, 0)


def test_a_radio_that_is_no_disc_carries_beyond_the_range_and_the_bound_holds_there(tmp_path):
    keys = [
        "mobility.source=manhattan",
        "mobility.area=800",
        "mobility.vehicles=30",
        "zones.columns=1",
        "zones.rows=1",
        "fleet.uavs=3",
        "fleet.range=10",
        "fleet.battery=[90, 100]",
        "fleet.speed=1",
        "selection.candidates=zone",
        "coordination.steps=4",
        "coordination.policy=hovering",
        "radio.model=air-to-ground",
    ]
    play(load_scenario("bologna", keys, 3), tmp_path, Silent())
    run = read_run(tmp_path)
    assert run.vehicles["carried_kbps"][~run.vehicles["covered"]].any()
    assert all(0.0 < (level.share or 0.0) <= 1.0 for level in bound(tmp_path))
