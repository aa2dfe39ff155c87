"""Figures over runs and tasks, against values worked out by hand and against SciPy."""

import numpy as np
import pytest
from scipy import stats

from skyrelay.core import aggregates
from skyrelay.core.errors import UsageError

RANDOM = np.random.default_rng(3)
SCORES = RANDOM.normal(0.8, 0.2, (10, 5))


def test_the_interquartile_mean_is_of_the_middle_half():
    assert aggregates.interquartile_mean(np.array([[8.0, 1.0, 3.0, 4.0], [5.0, 6.0, 7.0, 1000.0]])) == 5.5
    middle = np.sort(SCORES.ravel())[12:-12]  # 50 values: 12.5 at each end, whole ones
    assert aggregates.interquartile_mean(SCORES) == pytest.approx(middle.mean())


def test_of_many_at_once_each_is_what_it_is_alone():
    many = RANDOM.normal(size=(6, 4, 3))
    for figure in (aggregates.interquartile_mean, aggregates.mean, aggregates.optimality_gap):
        np.testing.assert_allclose(figure(many), [figure(one) for one in many])
    at = np.linspace(-2, 2, 9)
    np.testing.assert_allclose(aggregates.profile(many, at), [aggregates.profile(one, at) for one in many])


def test_a_gap_counts_what_is_above_one_as_one():
    assert aggregates.optimality_gap(np.array([[0.5, 2.0], [1.0, 0.7]])) == pytest.approx((0.5 + 0.0 + 0.0 + 0.3) / 4)


def test_a_profile_is_the_share_above_each_threshold():
    shares = aggregates.profile(np.array([[0.1, 0.5], [0.5, 0.9]]), np.array([0.0, 0.1, 0.5, 0.6, 0.9]))
    np.testing.assert_allclose(shares, [1.0, 0.75, 0.25, 0.25, 0.0])


def test_improvement_is_mann_and_whitneys_u_task_by_task():
    ours, theirs = RANDOM.integers(0, 4, (7, 5)).astype(float), RANDOM.integers(0, 4, (9, 5)).astype(float)
    each = [stats.mannwhitneyu(ours[:, task], theirs[:, task]).statistic / 63 for task in range(5)]
    assert aggregates.improvement(ours, theirs) == pytest.approx(np.mean(each))
    assert aggregates.improvement(ours, ours) == 0.5
    assert aggregates.improvement(np.array([[1.0], [3.0]]), np.array([[2.0], [2.0]])) == 0.5
    assert aggregates.improvement(np.array([[1.0, 2.0]]), np.array([[2.0, 2.0]])) == 0.25


def test_runs_are_drawn_within_their_task():
    drawn = aggregates.resampled(SCORES, np.random.default_rng(0), 400)
    for task in range(5):
        assert set(drawn[..., task].ravel()) == set(SCORES[:, task])
    # Independently: the tasks of a drawn run are of different runs.
    assert len({tuple(row) for row in drawn.reshape(-1, 5).round(9).tolist()}) > 3000


def test_an_interval_is_as_wide_as_the_standard_error_says():
    scores = np.random.default_rng(1).normal(2.0, 1.0, (200, 3))
    found = aggregates.with_interval(aggregates.mean, scores)
    half = 1.96 * np.sqrt((scores.var(0) / 200).sum()) / 3
    assert found.mean == pytest.approx(scores.mean())
    assert (found.high - found.low) / 2 == pytest.approx(half, rel=0.1)
    assert found.low < found.mean < found.high
    assert found == aggregates.with_interval(aggregates.mean, scores)  # the same draws
    value, low, high = aggregates.profile_with_band(scores, np.array([2.0]))
    assert low[0] < value[0] < high[0]
    better = aggregates.improvement_with_interval(scores[:20] + 0.2, scores[20:40])
    assert 0.3 < better.low < better.mean < better.high < 0.8


def test_a_single_run_has_no_interval():
    found = aggregates.with_interval(aggregates.interquartile_mean, SCORES[:1])
    assert found.count == 1
    assert found.closed()["low"] == found.mean
    assert aggregates.improvement_with_interval(SCORES[:1], SCORES).closed()["high"] <= 1
    for line in aggregates.profile_with_band(SCORES[:1], np.array([0.5])):
        np.testing.assert_array_equal(line, aggregates.profile(SCORES[:1], np.array([0.5])))


@pytest.mark.parametrize("scores", [np.ones(3), np.ones((0, 3)), np.array([[1.0, np.nan]])])
def test_scores_that_are_none_are_refused(scores):
    with pytest.raises(UsageError, match="finite"):
        aggregates.with_interval(aggregates.mean, scores)
