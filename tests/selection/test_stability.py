"""Blocking pairs under bandwidth quotas: where the theory promises none, and where it cannot."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from selection_tables import drawn, settings_drawn, tables, uavs_at, vehicles_at

from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection import METHODS, blocking_pairs, count_blocking_pairs, is_valid, qou, qov, select, stability

DEFAULT = Settings()


def blocking_by_definition(vehicles, uavs, assignment, rule):
    """The definition in the documentation, pair by pair."""
    quality, value = qou(vehicles, uavs, rule), qov(vehicles, uavs, rule)
    score = value / np.sqrt(vehicles.demand / 1000)[:, None]
    found = []
    for v, u in np.ndindex(quality.shape):
        if not quality[v, u] > 0:
            continue
        home = assignment[v]
        if home >= 0 and not quality[v, u] > quality[v, home]:
            continue
        stay = [w for w in range(len(vehicles)) if assignment[w] == u and score[w, u] >= score[v, u]]
        if vehicles.demand[v] <= uavs.bandwidth[u] - sum(vehicles.demand[w] for w in stay):
            found.append((v, u))
    return found


@given(tables(max_vehicles=7, max_uavs=4), settings_drawn, st.sampled_from(METHODS), st.sampled_from((1, 2, "full")))
def test_counted_as_defined(both, rule, method, rounds):
    vehicles, uavs = both
    assignment = select(vehicles, uavs, method, settings=rule, rounds=rounds).assignment
    expected = blocking_by_definition(vehicles, uavs, assignment, rule)
    assert blocking_pairs(vehicles, uavs, assignment, rule) == expected
    assert count_blocking_pairs(vehicles, uavs, assignment, rule) == len(expected)


@given(tables(demands=(2000,)), settings_drawn)
def test_deferred_acceptance_is_stable_for_equal_demands(both, rule):
    vehicles, uavs = both
    assignment = select(vehicles, uavs, settings=rule, rounds="full").assignment
    assert count_blocking_pairs(vehicles, uavs, assignment, rule) == 0


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("candidates", ["range", "zone"])
def test_deferred_acceptance_is_stable_for_equal_demands_of_drawn_cities(seed, candidates):
    vehicles, uavs = drawn(seed, vehicles=300, uavs=40, side=8000.0, zones=2, equal_demand=2500)
    rule = Settings(candidates=candidates)
    one = select(vehicles, uavs, settings=rule, rounds=1).assignment
    full = select(vehicles, uavs, settings=rule, rounds="full").assignment
    assert count_blocking_pairs(vehicles, uavs, one, rule) > 0, "the instance has nothing to show"
    assert count_blocking_pairs(vehicles, uavs, full, rule) == 0


@given(tables(demands=(2000,), max_vehicles=5, max_uavs=3), settings_drawn)
@hypothesis_settings(max_examples=40)
def test_no_stable_matching_serves_a_vehicle_better_for_equal_demands_and_no_ties(both, rule):
    vehicles, uavs = both
    quality, value = qou(vehicles, uavs, rule), qov(vehicles, uavs, rule)
    for line in [*quality, *value.T]:
        finite = line[np.isfinite(line)]
        if len(np.unique(finite)) < len(finite):
            return  # with ties there may be several vehicle-optimal matchings
    ours = select(vehicles, uavs, settings=rule, rounds="full").assignment
    gained = np.where(ours >= 0, quality[np.arange(len(vehicles)), ours], 0.0) if len(uavs) else np.zeros(len(vehicles))
    for other in product(range(-1, len(uavs)), repeat=len(vehicles)):
        assignment = np.array(other, dtype=np.int64)
        if is_valid(vehicles, uavs, assignment, rule) and not blocking_by_definition(vehicles, uavs, assignment, rule):
            theirs = np.array([quality[v, u] if u >= 0 else 0.0 for v, u in enumerate(other)])
            assert (theirs <= gained).all()


def test_unequal_demands_can_leave_a_blocking_pair():
    """The first counter-example of docs/explanation/stability.md: stable assignments exist, the rounds miss them."""
    vehicles = vehicles_at([600, 1000, 100], demand=[2000, 3000, 4000], payment=[300, 700, 200], reputation=[0, 10, 30])
    uavs = uavs_at([1000, 200], bandwidth=[2000, 5000], battery=[20, 70], reputation=[80, 20])
    chosen = select(vehicles, uavs, rounds="full")
    asked = [(r.vehicle.tolist(), r.uav.tolist(), r.accepted.tolist()) for r in chosen.rounds]
    assert asked == [
        ([0, 1, 2], [1, 0, 1], [False, False, True]),  # u1 takes v2, all but 1 Mbit/s; v0 does not fit
        ([0, 1], [0, 1], [True, True]),  # v1 displaces v2 at u1, which has 2 Mbit/s free now: v0 would fit
        ([2], [0], [False]),
    ]
    assert blocking_pairs(vehicles, uavs, chosen.assignment, DEFAULT) == [(0, 1)]
    assert count_blocking_pairs(vehicles, uavs, np.array([1, 1, -1]), DEFAULT) == 0


def test_unequal_demands_can_leave_no_stable_assignment_at_all():
    """The second counter-example of docs/explanation/stability.md."""
    # v0 reaches u0 alone. u0 ranks v1, v0, v2 and has room for v1 and v2 but for nobody beside v0; u1 ranks v2, v1 and
    # has room for one. v1 would rather have u1, v2 rather u0: each assignment gives somebody a reason to change.
    vehicles = vehicles_at(
        [5700, 2300, 2700],
        [5300, 800, 1000],
        demand=[4000, 3000, 1200],
        payment=[500, 600, 0],
        reputation=[90, 70, 90],
    )
    uavs = uavs_at([4400, 3000], [2600, 2200], bandwidth=[4200, 3000], battery=[66.2, 33.8], reputation=[50, 50])
    valid = [
        assignment
        for assignment in (np.array(choice, dtype=np.int64) for choice in product((-1, 0, 1), repeat=3))
        if is_valid(vehicles, uavs, assignment, DEFAULT)
    ]
    assert len(valid) > 5
    assert all(blocking_by_definition(vehicles, uavs, assignment, DEFAULT) for assignment in valid)


def test_validity_names_each_broken_rule():
    vehicles, uavs = vehicles_at([0.0, 100.0, 9000.0]), uavs_at([0.0, 50.0], zone=[1, 2], bandwidth=[3000, 9000])
    assert is_valid(vehicles, uavs, np.array([0, -1, -1]), DEFAULT)
    assert not is_valid(vehicles, uavs, np.array([0, 0, -1]), DEFAULT), "more than the bandwidth"
    assert not is_valid(vehicles, uavs, np.array([1, -1, -1]), DEFAULT), "another zone"
    assert not is_valid(vehicles, uavs, np.array([-1, -1, 0]), DEFAULT), "out of range"


def test_counting_in_chunks_changes_nothing(monkeypatch):
    vehicles, uavs = drawn(5, vehicles=90, uavs=20, zones=2)
    assignment = select(vehicles, uavs, "random", seed=3).assignment
    whole = count_blocking_pairs(vehicles, uavs, assignment, DEFAULT)
    monkeypatch.setattr(stability, "_CHUNK_PAIRS", 50)
    assert count_blocking_pairs(vehicles, uavs, assignment, DEFAULT) == whole > 0
