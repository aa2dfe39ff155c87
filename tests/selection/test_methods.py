"""Every method through `select`: valid, what it promises, and what bad input gets."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from selection_tables import drawn, settings_drawn, tables, uavs_at, vehicles_at

from skyrelay.core.errors import SelectionError, UsageError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection import METHODS, evaluate, is_valid, qou, qov, select

DEFAULT = Settings()


@given(tables(), settings_drawn, st.sampled_from(METHODS))
def test_every_method_keeps_the_rules(both, rule, method):
    vehicles, uavs = both
    chosen = select(vehicles, uavs, method, settings=rule, within=True)
    assert is_valid(vehicles, uavs, chosen.assignment, rule)
    served = chosen.assignment >= 0
    quality, value = qou(vehicles, uavs, rule), qov(vehicles, uavs, rule)
    rows = np.flatnonzero(served)
    np.testing.assert_array_equal(chosen.qou[served], quality[rows, chosen.assignment[rows]])
    np.testing.assert_array_equal(chosen.qov[served], value[rows, chosen.assignment[rows]])
    assert np.isnan(chosen.qou[~served]).all()
    metrics = evaluate(vehicles, uavs, chosen, rule)
    assert metrics.served == served.sum()
    assert metrics.uavs_selected == len(set(chosen.assignment[served].tolist()))
    assert (metrics.excess_bandwidth, metrics.max_excess, metrics.uavs_exceeded) == (0, 0, 0)


@given(tables(max_vehicles=5, max_uavs=3), settings_drawn, st.sampled_from(("qou", "qov", "served")))
@hypothesis_settings(max_examples=60)
def test_optimal_is_the_best_of_all_assignments(both, rule, objective):
    vehicles, uavs = both
    worth = {
        "qou": qou(vehicles, uavs, rule),
        "qov": qov(vehicles, uavs, rule),
        "served": np.ones((len(vehicles), len(uavs))),
    }[objective]
    best = 0.0
    for choice in product(range(-1, len(uavs)), repeat=len(vehicles)):
        if is_valid(vehicles, uavs, np.array(choice, dtype=np.int64), rule):
            best = max(best, sum(worth[v, u] for v, u in enumerate(choice) if u >= 0))
    chosen = select(vehicles, uavs, "optimal", settings=rule, objective=objective, gap=0.0)
    assert chosen.objective == (objective, pytest.approx(best))
    assert chosen.gap == pytest.approx(0.0, abs=1e-6)


def test_optimal_stopped_by_its_time_limit_reports_the_gap_left():
    vehicles, uavs = drawn(1, vehicles=400, uavs=60, side=3000.0)
    rule = Settings(candidates="zone")
    stopped = select(vehicles, uavs, "optimal", settings=rule, objective="qov", time_limit=0.5, gap=0.0)
    assert is_valid(vehicles, uavs, stopped.assignment, rule)
    assert stopped.gap is not None
    assert stopped.gap > 0.0
    full = select(vehicles, uavs, "two-sided", settings=rule, rounds="full")
    assert stopped.objective is not None
    assert full.qov[full.assignment >= 0].sum() <= stopped.objective[1] * (1 + stopped.gap) + 1e-6


def test_nearest_takes_the_nearest_with_room():
    vehicles, uavs = vehicles_at([0.0, 10.0, 20.0]), uavs_at([0.0, 1000.0], bandwidth=[4000, 2000])
    assert select(vehicles, uavs, "nearest").assignment.tolist() == [0, 0, 1]


def test_nnm_takes_the_closest_score_with_room():
    # QoV is 25 (0.5 + r/100 + p/700 + closeness); the UAVs differ in battery alone.
    vehicles = vehicles_at([0.0, 0.0], payment=[350, 350], reputation=[50, 50])
    uavs = uavs_at([0.0, 0.0, 0.0], bandwidth=[2000, 2000, 2000], battery=[100, 60, 90], reputation=[50, 50, 50])
    gap = np.abs(qou(vehicles, uavs, DEFAULT) - qov(vehicles, uavs, DEFAULT))
    assert gap[0].argsort().tolist() == [2, 0, 1] or gap[0].argsort().tolist() == [0, 2, 1]
    first, second = gap[0].argsort()[:2].tolist()
    assert select(vehicles, uavs, "nnm").assignment.tolist() == [first, second]


def test_random_follows_its_seed():
    vehicles, uavs = drawn(2, vehicles=80, uavs=30)
    first, again, other = (select(vehicles, uavs, "random", seed=seed).assignment for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_rounds_come_from_the_settings_unless_given():
    vehicles, uavs = drawn(3, vehicles=200, uavs=20)
    by_settings = select(vehicles, uavs, settings=Settings(rounds=3))
    np.testing.assert_array_equal(by_settings.assignment, select(vehicles, uavs, rounds=3).assignment)
    assert len(by_settings.rounds) == 3


def test_hysteresis_keeps_a_vehicle_until_another_uav_is_that_much_better():
    vehicles, uavs = vehicles_at([0.0]), uavs_at([0.0, 0.0], battery=[50, 62])  # 3 points apart
    stay = np.array([0])
    assert select(vehicles, uavs, incumbent=stay).assignment.tolist() == [1]
    assert select(vehicles, uavs, incumbent=stay, hysteresis=2.9).assignment.tolist() == [1]
    assert select(vehicles, uavs, incumbent=stay, hysteresis=3.1).assignment.tolist() == [0]


def test_each_vehicle_may_have_a_hysteresis_of_its_own():
    vehicles, uavs = vehicles_at([0.0, 0.0]), uavs_at([0.0, 0.0], battery=[50, 62])
    stay = np.array([0, 0])
    assert select(vehicles, uavs, incumbent=stay, hysteresis=np.array([5.0, 0.0])).assignment.tolist() == [0, 1]
    with pytest.raises(UsageError, match=r"hysteresis\.shape"):
        select(vehicles, uavs, incumbent=stay, hysteresis=np.array([5.0]))
    with pytest.raises(UsageError, match="hysteresis: is -2"):
        select(vehicles, uavs, incumbent=stay, hysteresis=np.array([5.0, -2.0]))


@given(tables(), settings_drawn, st.randoms(use_true_random=False), st.sampled_from((1, 2, "full")))
def test_hysteresis_asks_by_qou_with_a_bonus_for_the_incumbent(both, rule, chance, rounds):
    """Against a plain loop over lists that are sorted in full."""
    vehicles, uavs = both
    bonus = 5.0
    incumbent = np.array([chance.randint(-1, len(uavs) - 1) for _ in range(len(vehicles))], dtype=np.int64)
    quality = qou(vehicles, uavs, rule)
    lists = [
        sorted(
            (u for u in range(len(uavs)) if quality[v, u] > 0),
            key=lambda u: (-(quality[v, u] + bonus * (u == incumbent[v])), u != incumbent[v], u),
        )
        for v in range(len(vehicles))
    ]
    chosen = select(vehicles, uavs, settings=rule, rounds=rounds, incumbent=incumbent, hysteresis=bonus)
    asked = [[] for _ in range(len(vehicles))]
    for played in chosen.rounds:
        for v, u in zip(played.vehicle.tolist(), played.uav.tolist(), strict=True):
            asked[v].append(u)
    assert asked == [wanted[: len(done)] for wanted, done in zip(lists, asked, strict=True)]


# --- bad input ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_nobody_asks_or_nobody_flies(method):
    some_vehicles, some_uavs = vehicles_at([0.0, 1.0]), uavs_at([0.0])
    for vehicles, uavs in ((vehicles_at([]), some_uavs), (some_vehicles, uavs_at([])), (vehicles_at([]), uavs_at([]))):
        chosen = select(vehicles, uavs, method)
        assert chosen.assignment.tolist() == [-1] * len(vehicles)
        metrics = evaluate(vehicles, uavs, chosen)
        assert (metrics.served, metrics.uavs_selected, metrics.blocking_pairs) == (0, 0, 0)
        assert metrics.mean_qou is None
        assert metrics.vehicles_per_uav is None


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("vehicle", "uav"),
    [
        ({}, {"bandwidth": [0, 0]}),  # zero capacity
        ({"demand": [90000]}, {}),  # asks more than any UAV has
        ({}, {"x": [4000, 9000]}),  # no UAV in range
        ({}, {"zone": [2, 3]}),  # no UAV in the zone
    ],
)
def test_a_vehicle_that_cannot_be_served_is_not(method, vehicle, uav):
    vehicles, uavs = vehicles_at([0.0], **vehicle), uavs_at(**({"x": [10.0, 20.0]} | uav))
    chosen = select(vehicles, uavs, method)
    assert chosen.assignment.tolist() == [-1]
    assert evaluate(vehicles, uavs, chosen).blocking_pairs == 0


def test_a_vehicle_that_asks_too_much_does_not_keep_the_others_out():
    vehicles = vehicles_at([0.0, 0.0], demand=[90000, 1000])
    for method in METHODS:
        assert select(vehicles, uavs_at([0.0]), method).assignment.tolist() == [-1, 0]


@pytest.mark.parametrize("method", ["two_sided", "twosided", "TWO-SIDED"])
def test_an_unknown_method_is_refused_with_a_suggestion(method):
    with pytest.raises(UsageError, match=r"method: is .*did you mean 'two-sided'\?"):
        select(vehicles_at([0.0]), uavs_at([0.0]), method)


@pytest.mark.parametrize(
    ("arguments", "place"),
    [
        ({"rounds": 0}, "rounds"),
        ({"rounds": 1.5}, "rounds"),
        ({"rounds": "all"}, "rounds"),
        ({"rounds": True}, "rounds"),
        ({"hysteresis": -1.0}, "hysteresis"),
        ({"hysteresis": float("nan")}, "hysteresis"),
        ({"method": "optimal", "objective": "qo"}, "objective"),
        ({"method": "optimal", "time_limit": 0.0}, "time_limit"),
        ({"method": "optimal", "time_limit": float("nan")}, "time_limit"),
        ({"method": "optimal", "gap": -0.1}, "gap"),
    ],
)
def test_an_option_that_does_not_fit_is_named(arguments, place):
    with pytest.raises(UsageError) as fault:
        select(vehicles_at([0.0]), uavs_at([0.0]), **arguments)
    assert fault.value.place == place


@pytest.mark.parametrize(
    ("incumbent", "place"),
    [([0, 0], "incumbent.shape"), ([1], "incumbent[0]"), ([-2], "incumbent[0]")],
)
def test_an_incumbent_that_is_no_uav_is_named(incumbent, place):
    with pytest.raises(SelectionError) as fault:
        select(vehicles_at([0.0]), uavs_at([0.0]), incumbent=np.array(incumbent))
    assert fault.value.place == place


# --- QoU that knows the load -------------------------------------------------------------------------------------


def test_load_aware_without_weight_is_two_sided():
    vehicles, uavs = drawn(4, vehicles=150, uavs=25, zones=2)
    for rounds in (1, 3, "full"):
        plain = select(vehicles, uavs, "two-sided", rounds=rounds).assignment
        aware = select(vehicles, uavs, "load-aware", settings=Settings(load_weight=0.0), rounds=rounds).assignment
        np.testing.assert_array_equal(plain, aware)


def test_load_aware_sends_vehicles_where_less_is_asked():
    # Both vehicles in the middle like u0 better; all that u0 alone reaches ask it, too.
    vehicles = vehicles_at([3000.0, 3000.0, 0.0, 0.0, 0.0, 0.0])
    uavs = uavs_at([2000.0, 4100.0], bandwidth=[8000, 8000])
    plain = select(vehicles, uavs, "two-sided", rounds=1).assignment
    aware = select(vehicles, uavs, "load-aware", rounds=1).assignment
    assert plain.tolist()[:2] == [0, 0]
    assert aware.tolist()[:2] == [1, 1]
    assert (aware >= 0).sum() == 6 > (plain >= 0).sum() == 4


@given(tables(), settings_drawn)
def test_load_aware_asks_by_qou_and_availability(both, rule):
    """Against plain loops over lists that are sorted in full."""
    vehicles, uavs = both
    quality = qou(vehicles, uavs, rule)
    expected = np.zeros(len(uavs))
    for v in range(len(vehicles)):
        candidates = [u for u in range(len(uavs)) if quality[v, u] > 0]
        for u in candidates:
            expected[u] += vehicles.demand[v] / len(candidates)
    free = np.divide(uavs.bandwidth, uavs.bandwidth + expected, out=np.zeros(len(uavs)), where=uavs.bandwidth > 0)
    lists = [
        sorted(
            (u for u in range(len(uavs)) if quality[v, u] > 0),
            key=lambda u: (-(quality[v, u] * (1 - rule.load_weight + rule.load_weight * free[u])), u),
        )
        for v in range(len(vehicles))
    ]
    asked = [[] for _ in range(len(vehicles))]
    for played in select(vehicles, uavs, "load-aware", settings=rule, rounds="full").rounds:
        for v, u in zip(played.vehicle.tolist(), played.uav.tolist(), strict=True):
            asked[v].append(u)
    assert asked == [wanted[: len(done)] for wanted, done in zip(lists, asked, strict=True)]
