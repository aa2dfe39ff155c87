"""Near-feasible stable matching: what it promises, by checkers that share nothing with it, and the plain loops."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from selection_tables import drawn, settings_drawn, tables, uavs_at, vehicles_at

from skyrelay.core.errors import SelectionError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection import (
    count_blocking_pairs,
    evaluate,
    is_valid,
    near_feasible,
    near_feasible_matching,
    qou,
    reference,
    select,
)

DEFAULT = Settings()


@st.composite
def markets(draw, vehicles=7, uavs=4, amounts=(1, 2, 3, 5)):
    """Pairs in any order, of few distinct likings and scores, so that equals are common."""
    v, u = draw(st.integers(0, vehicles)), draw(st.integers(0, uavs))
    everyone = [(one, other) for one in range(v) for other in range(u)]
    pairs = draw(st.permutations(everyone)) if everyone else []
    pairs = pairs[: draw(st.integers(0, len(pairs)))]

    def values(count, of):
        return draw(st.lists(st.sampled_from(of), min_size=count, max_size=count))

    return {
        "vehicle": np.array([one for one, _ in pairs], dtype=np.int64),
        "uav": np.array([other for _, other in pairs], dtype=np.int64),
        "liking": values(len(pairs), (1, 2, 3)),
        "score": values(len(pairs), (-1, 0, 2.5)),
        "demand": values(v, amounts),
        "capacity": values(u, (0, 1, 3, 4, 8)),
    }


def blocking(market, assignment):
    """Pairs that would rather have each other with each capacity raised to its load, pair by pair."""
    liking = {(v, u): x for v, u, x in zip(market["vehicle"], market["uav"], market["liking"], strict=True)}
    score = {(v, u): x for v, u, x in zip(market["vehicle"], market["uav"], market["score"], strict=True)}
    load = [
        sum(d for d, a in zip(market["demand"], assignment, strict=True) if a == u)
        for u in range(len(market["capacity"]))
    ]
    found = []
    for v, u in liking:
        if market["demand"][v] > market["capacity"][u]:
            continue
        if assignment[v] >= 0 and liking[v, u] <= liking[v, assignment[v]]:
            continue
        stay = sum(market["demand"][w] for w, a in enumerate(assignment) if a == u and score[w, u] >= score[v, u])
        if market["demand"][v] <= max(market["capacity"][u], load[u]) - stay:
            found.append((v, u))
    return found


def excess_of(market, assignment):
    load = np.zeros(len(market["capacity"]))
    for v, u in enumerate(assignment):
        if u >= 0:
            load[u] += market["demand"][v]
    return np.maximum(load - np.array(market["capacity"], dtype=float), 0.0)


@given(markets())
@hypothesis_settings(max_examples=200)
def test_no_pair_blocks_and_the_excess_is_below_one_demand(market):
    found = near_feasible_matching(**market)
    pairs = set(zip(market["vehicle"].tolist(), market["uav"].tolist(), strict=True))
    assert all((v, u) in pairs for v, u in enumerate(found.assignment.tolist()) if u >= 0)
    assert blocking(market, found.assignment) == []
    np.testing.assert_array_equal(found.excess, excess_of(market, found.assignment))
    for u in np.flatnonzero(found.excess).tolist():
        assert found.excess[u] < max(market["demand"][v] for v in np.flatnonzero(found.assignment == u))
        assert found.excess[u] < market["capacity"][u]


@given(markets(vehicles=4, uavs=3))
def test_no_such_matching_serves_any_vehicle_better(market):
    """Against all assignments in which UAVs hold what they choose, and choose nobody who likes them better."""
    count = len(market["vehicle"])
    market |= {name: np.asarray(market[name]) + np.linspace(0, 0.4, count) for name in ("liking", "score")}
    liking = {(v, u): x for v, u, x in zip(market["vehicle"], market["uav"], market["liking"], strict=True)}
    score = {(v, u): x for v, u, x in zip(market["vehicle"], market["uav"], market["score"], strict=True)}
    demand, capacity = market["demand"], market["capacity"]
    ours = near_feasible_matching(**market).assignment

    def would_hold(u, v, other):
        before = sum(demand[w] for w, a in enumerate(other) if a == u and score[w, u] > score[v, u])
        return demand[v] <= capacity[u] and before < capacity[u]

    def is_stable(other):
        return all(
            would_hold(u, v, other) if other[v] == u else not would_hold(u, v, other)
            for v, u in liking
            if other[v] < 0 or liking[v, u] >= liking[v, other[v]]
        )

    for other in product(range(-1, len(capacity)), repeat=len(demand)):
        if any(u >= 0 and (v, u) not in liking for v, u in enumerate(other)):
            continue
        if not is_stable(other):
            continue
        assert blocking(market, other) == []
        for v, u in enumerate(other):
            assert u < 0 or (ours[v] >= 0 and liking[v, ours[v]] >= liking[v, u])


@given(tables(max_vehicles=9, max_uavs=5), settings_drawn)
def test_tables_equal_the_plain_loops(both, rule):
    vehicles, uavs = both
    chosen = select(vehicles, uavs, "near-feasible", settings=rule)
    assert chosen.assignment.tolist() == reference.near_feasible(vehicles, uavs, rule)
    metrics = evaluate(vehicles, uavs, chosen, rule)
    assert metrics.blocking_pairs == 0
    assert metrics.max_excess < vehicles.demand.max(initial=1.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("candidates", ["range", "zone"])
def test_lists_that_go_on_and_samples_change_nothing(seed, candidates, monkeypatch):
    monkeypatch.setattr(near_feasible, "_LISTED", 2)
    monkeypatch.setattr(near_feasible, "_WORTH_SAMPLING", 50)
    vehicles, uavs = drawn(seed, vehicles=150, uavs=25, zones=2, whole=False)
    rule = Settings(candidates=candidates)
    chosen = select(vehicles, uavs, "near-feasible", settings=rule)
    assert chosen.assignment.tolist() == reference.near_feasible(vehicles, uavs, rule)


@pytest.mark.parametrize("bandwidths", [(0, 20_000), (100_000, 200_000)])
def test_a_city_has_no_blocking_pair(bandwidths):
    vehicles, uavs = drawn(7, vehicles=4000, uavs=150, side=12000.0, zones=2)
    generator = np.random.default_rng(7)
    uavs = uavs_at(
        uavs.x, uavs.y, uavs.zone, generator.uniform(bandwidths[0], bandwidths[1], 150), uavs.battery, uavs.reputation
    )
    rule = Settings(max_uav_bandwidth=200.0)
    chosen = select(vehicles, uavs, "near-feasible", settings=rule)
    metrics = evaluate(vehicles, uavs, chosen, rule)
    assert metrics.blocking_pairs == 0
    assert 0 < metrics.max_excess < vehicles.demand.max()
    assert metrics.uavs_exceeded > 30
    assert metrics.excess_bandwidth <= metrics.uavs_exceeded * metrics.max_excess
    assert not is_valid(vehicles, uavs, chosen.assignment, rule)


@given(tables(), settings_drawn)
def test_within_the_bandwidths_the_contract_would_take_it(both, rule):
    vehicles, uavs = both
    chosen = select(vehicles, uavs, "near-feasible", settings=rule, within=True)
    assert is_valid(vehicles, uavs, chosen.assignment, rule)


def test_the_vehicle_that_crosses_the_bandwidth_is_the_one_that_asks_on():
    # Near-feasibly u0 holds v0 and v1, 1 Mbit/s above what it has; within its bandwidth v1 goes to u1.
    vehicles = vehicles_at([0.0, 0.0, 0.0], demand=[3000, 3000, 3000], reputation=[90, 50, 10])
    uavs = uavs_at([0.0, 500.0], bandwidth=[5000, 3000])
    free, held = (select(vehicles, uavs, "near-feasible", within=within) for within in (False, True))
    assert free.assignment.tolist() == [0, 0, 1]
    assert evaluate(vehicles, uavs, free).max_excess == 1000
    assert held.assignment.tolist() == [0, 1, -1]


def test_the_example_without_a_stable_assignment_has_a_near_feasible_one():
    vehicles = vehicles_at(
        [5700, 2300, 2700],
        [5300, 800, 1000],
        demand=[4000, 3000, 1200],
        payment=[500, 600, 0],
        reputation=[90, 70, 90],
    )
    uavs = uavs_at([4400, 3000], [2600, 2200], bandwidth=[4200, 3000], battery=[66.2, 33.8], reputation=[50, 50])
    chosen = select(vehicles, uavs, "near-feasible")
    assert count_blocking_pairs(vehicles, uavs, chosen.assignment, DEFAULT) == 0
    assert (qou(vehicles, uavs, DEFAULT)[chosen.assignment >= 0].max(axis=1) > 0).all()


@pytest.mark.parametrize(
    ("changed", "place"),
    [
        ({"vehicle": [0, 2]}, "vehicle[1]"),
        ({"uav": [-1, 0]}, "uav[0]"),
        ({"uav": [0.0, 0.0]}, "uav"),
        ({"uav": [0]}, "len(uav)"),
        ({"liking": [1.0, np.nan]}, "liking[1]"),
        ({"score": [[1.0], [2.0]]}, "score.shape"),
        ({"demand": [1.0, 0.0]}, "demand[1]"),
        ({"capacity": [-1.0]}, "capacity[0]"),
        ({"vehicle": [1, 1]}, "vehicle, uav"),
    ],
)
def test_arrays_that_do_not_fit_are_named(changed, place):
    fitting: dict[str, Any] = {
        "vehicle": [0, 1],
        "uav": [0, 0],
        "liking": [1.0, 1.0],
        "score": [1.0, 2.0],
        "demand": [1.0, 1.0],
        "capacity": [1.0],
    }
    assert near_feasible_matching(**fitting).assignment.tolist() == [-1, 0]
    with pytest.raises(SelectionError) as fault:
        near_feasible_matching(**(fitting | changed))
    assert fault.value.place == place
