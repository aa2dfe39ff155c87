"""The contract's integers: exact where they can be, close to Eq. 2 elsewhere, never turning an order round."""

from __future__ import annotations

from fractions import Fraction
from math import hypot, isqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrelay.core.errors import SelectionError
from skyrelay.selection.fixed_point import (
    QOV_SCALE,
    SCORE_SCALE,
    FixedParameters,
    allocate_fixed,
    distance_fixed,
    fixed_weights,
    qov_fixed,
    score_fixed,
)

PAPER = FixedParameters((250_000, 250_000, 250_000, 250_000), 4_000, 700, 30_000)
demands = st.integers(1, 4_000)
payments = st.integers(0, 700)
reputations = st.integers(0, 10_000)
offsets = st.integers(-40_000, 40_000)
proposals = st.lists(st.tuples(st.integers(0, 50), st.integers(1, 40)), max_size=40)


@st.composite
def parameters(draw: st.DrawFn) -> FixedParameters:
    cuts = sorted(draw(st.lists(st.integers(0, 10**6), min_size=3, max_size=3)))
    weights = (cuts[0], cuts[1] - cuts[0], cuts[2] - cuts[1], 10**6 - cuts[2])
    maximum = st.integers(1, 2**32 - 1)
    return FixedParameters(weights, draw(maximum), draw(maximum), draw(maximum))


def test_the_best_vehicle_has_a_qov_of_100_and_the_worst_none():
    assert qov_fixed(PAPER, 4_000, 700, 10_000, 0) == 100 * QOV_SCALE
    only_closeness = FixedParameters((0, 0, 0, 10**6), 4_000, 700, 30_000)
    assert qov_fixed(only_closeness, 4_000, 700, 10_000, distance_fixed(30_000, 0)) == 0
    assert qov_fixed(only_closeness, 4_000, 700, 10_000, distance_fixed(90_000, 90_000)) == 0


def test_a_hand_computed_case():
    # 25 (1000/4000 + 350/700 + 60/100 + 1 - 500/3000), the distance being 3-4-5
    qov = qov_fixed(PAPER, 1_000, 350, 6_000, distance_fixed(3_000, 4_000))
    assert qov == int(25 * (Fraction(1, 4) + Fraction(1, 2) + Fraction(3, 5) + Fraction(5, 6)) * QOV_SCALE)
    assert score_fixed(qov, 1_600) == qov * 100 // 40


@given(demands, payments, reputations, offsets, offsets)
def test_qov_is_eq_2_to_twelve_digits(demand, payment, reputation, dx, dy):
    closeness = 1 - min(hypot(dx, dy) / 30_000, 1)
    expected = 25 * (demand / 4_000 + payment / 700 + reputation / 10_000 + closeness)
    assert qov_fixed(PAPER, demand, payment, reputation, distance_fixed(dx, dy)) / QOV_SCALE == pytest.approx(
        expected, rel=1e-12, abs=1e-10
    )


@given(parameters(), st.data())
def test_values_fit_the_words_of_the_contract(fixed, data):
    demand = data.draw(st.integers(1, fixed.max_demand))
    payment = data.draw(st.integers(0, fixed.max_payment))
    reputation = data.draw(reputations)
    distance = distance_fixed(data.draw(st.integers(-(2**32), 2**32)), data.draw(st.integers(-(2**32), 2**32)))
    qov = qov_fixed(fixed, demand, payment, reputation, distance)
    assert 0 <= qov <= 100 * QOV_SCALE < 2**64
    score = score_fixed(qov, demand)
    assert 0 <= score <= 100 * SCORE_SCALE < 2**64
    exact = qov * qov * 10**4
    assert score * score * demand <= exact < (score + 1) ** 2 * demand


@given(parameters(), st.data())
def test_rounding_never_turns_an_order_round(fixed, data):
    """Against exact fractions: a higher QoV at the same distance never gets the lower integer, nor a higher score."""

    def draw():
        return (
            data.draw(st.integers(1, fixed.max_demand)),
            data.draw(st.integers(0, fixed.max_payment)),
            data.draw(reputations),
        )

    distance = distance_fixed(data.draw(offsets), data.draw(offsets))

    def exact(demand, payment, reputation):
        w5, w6, w7, w8 = fixed.weights
        near = max(1 - Fraction(distance, fixed.max_distance * 10**15), Fraction(0))
        return (
            w5 * Fraction(demand, fixed.max_demand)
            + w6 * Fraction(payment, fixed.max_payment)
            + w7 * Fraction(reputation, 10_000)
            + w8 * near
        )

    one, other = draw(), draw()
    low, high = sorted((one, other), key=lambda v: exact(*v))
    first, second = (qov_fixed(fixed, offer[0], offer[1], offer[2], distance) for offer in (low, high))
    assert first <= second
    if exact(*low) == exact(*high):
        assert first == second
    assert score_fixed(first, high[0]) <= score_fixed(second, high[0])


@given(proposals, st.integers(0, 200))
def test_allocation_is_algorithm_2(found, capacity):
    expected, left = [], capacity
    for index in sorted(range(len(found)), key=lambda i: (-found[i][0], i)):
        if found[index][1] <= left:
            left -= found[index][1]
            expected.append(index)
    assert allocate_fixed(capacity, found) == expected


@given(proposals, st.integers(0, 200))
def test_allocation_never_promises_more_than_there_is(found, capacity):
    accepted = allocate_fixed(capacity, found)
    assert len(set(accepted)) == len(accepted)
    assert sum(found[i][1] for i in accepted) <= capacity
    used = sum(found[i][1] for i in accepted)
    rejected = set(range(len(found))) - set(accepted)
    assert all(found[i][1] > capacity - used for i in rejected)


def test_equal_scores_go_to_the_earlier_and_smaller_ones_may_still_fit():
    assert allocate_fixed(25, [(5, 10), (5, 10), (5, 10), (1, 5)]) == [0, 1, 3]


@given(st.integers(0, 2**34), st.integers(0, 2**34))
def test_distance_is_floored(dx, dy):
    assert distance_fixed(dx, -dy) == isqrt((dx * dx + dy * dy) * 10**30)


@given(st.lists(st.floats(0, 1), min_size=4, max_size=4).filter(lambda w: sum(w) > 0.01))
def test_weights_sum_to_a_million(weights):
    total = sum(weights)
    shares = [weight / total for weight in weights]
    units = fixed_weights(shares)
    assert sum(units) == 10**6
    assert all(abs(unit - share * 10**6) <= 1 for unit, share in zip(units, shares, strict=True))


@pytest.mark.parametrize("weights", [(0.5, 0.5), (0.5, 0.5, 0.5, -0.5), (0.3, 0.3, 0.3, 0.3)])
def test_weights_that_are_none_are_refused(weights):
    with pytest.raises(SelectionError, match="weights"):
        fixed_weights(weights)


def test_what_the_contract_refuses_is_refused():
    with pytest.raises(SelectionError, match=r"demand: is 0; expected a whole number from 1 to 4000"):
        qov_fixed(PAPER, 0, 0, 0, 0)
    with pytest.raises(SelectionError, match="payment"):
        qov_fixed(PAPER, 1, 701, 0, 0)
    with pytest.raises(SelectionError, match="reputation"):
        qov_fixed(PAPER, 1, 0, 10_001, 0)
    with pytest.raises(SelectionError, match="demand"):
        score_fixed(1, 0)
    with pytest.raises(SelectionError, match="max_payment"):
        FixedParameters((250_000,) * 4, 1, 0, 1)
    with pytest.raises(SelectionError, match="weights"):
        FixedParameters((250_000, 250_000, 250_000, 250_001), 1, 1, 1)
