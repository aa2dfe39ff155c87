"""Figures over many tasks and runs, with bootstrap intervals: what a benchmark of few runs should be told by.

Scores are [runs, tasks]: what one run of a method (one training, one set of episodes) has in each task. An interval
resamples the runs within each task (stratified bootstrap) and takes the percentiles: it says what other runs would have
given in these very tasks.

Source: R. Agarwal, M. Schwarzer, P. S. Castro, A. Courville, M. G. Bellemare, "Deep reinforcement learning at the edge
of the statistical precipice", NeurIPS 2021.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy import stats

from skyrelay.core.entities import FloatArray
from skyrelay.core.errors import UsageError
from skyrelay.core.statistics import Interval

RESAMPLES = 2000
PERCENTILES = (2.5, 97.5)

Figure = Callable[[FloatArray], FloatArray]
"""From scores [..., runs, tasks] to a figure of each [...]."""


def interquartile_mean(scores: FloatArray) -> FloatArray:
    """[...] mean of the middle half of all runs and tasks together.

    No outlier moves it, unlike a mean, and it uses more of the scores than a median does.
    """
    flat = scores.reshape(*scores.shape[:-2], -1)
    middle: FloatArray = np.asarray(stats.trim_mean(flat, 0.25, axis=-1))
    return middle


def mean(scores: FloatArray) -> FloatArray:
    """[...] of all runs and tasks."""
    return np.asarray(scores.mean((-2, -1)))


def optimality_gap(scores: FloatArray) -> FloatArray:
    """[...] how far the scores are below 1 on average; what is above 1 counts as 1."""
    return np.asarray(1.0 - np.minimum(scores, 1.0).mean((-2, -1)))


def profile(scores: FloatArray, thresholds: FloatArray) -> FloatArray:
    """[..., thresholds] share of all runs and tasks with a score above each threshold."""
    flat = np.sort(scores.reshape(*scores.shape[:-2], -1), axis=-1)
    above = [(flat > threshold).mean(-1) for threshold in thresholds.tolist()]
    return np.stack(above, axis=-1)


def improvement(ours: FloatArray, theirs: FloatArray) -> FloatArray:
    """[...] probability that a run of ours has more than a run of theirs, the mean over the tasks; a tie counts half.

    Args:
        ours, theirs: [..., runs, tasks], the same tasks; the numbers of runs may differ.
    """
    apart = ours[..., :, None, :] - theirs[..., None, :, :]
    return np.asarray(((apart > 0.0) + 0.5 * (apart == 0.0)).mean((-3, -2, -1)))


def resampled(scores: FloatArray, random: np.random.Generator, times: int = RESAMPLES) -> FloatArray:
    """[times, runs, tasks] runs drawn anew with replacement, in each task by itself."""
    rows = random.integers(0, scores.shape[0], (times, *scores.shape))
    return np.take_along_axis(scores[None], rows, axis=1)


def with_interval(figure: Figure, scores: FloatArray, seed: int = 0) -> Interval:
    """A figure of scores [runs, tasks] with its 95 % interval.

    Returns: of a single run the bounds are NaN.
    Raises:
        UsageError: there is no score, or one is not finite.
    """
    _check(scores)
    value = float(figure(scores))
    if scores.shape[0] < 2:
        return Interval(value, np.nan, np.nan, 1)
    low, high = _bounds(figure(resampled(scores, np.random.default_rng(seed))))
    return Interval(value, float(low), float(high), scores.shape[0])


def profile_with_band(
    scores: FloatArray, thresholds: FloatArray, seed: int = 0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """[thresholds] three times: `profile`, and its 95 % interval at each threshold (its own value for a single run)."""
    _check(scores)
    value = profile(scores, thresholds)
    if scores.shape[0] < 2:
        return value, value, value
    low, high = _bounds(profile(resampled(scores, np.random.default_rng(seed)), thresholds))
    return value, low, high


def improvement_with_interval(ours: FloatArray, theirs: FloatArray, seed: int = 0) -> Interval:
    """`improvement` with its 95 % interval, the runs of both drawn anew."""
    _check(ours)
    _check(theirs)
    value, runs = float(improvement(ours, theirs)), min(ours.shape[0], theirs.shape[0])
    if runs < 2:
        return Interval(value, np.nan, np.nan, runs)
    random = np.random.default_rng(seed)
    low, high = _bounds(improvement(resampled(ours, random), resampled(theirs, random)))
    return Interval(value, float(low), float(high), runs)


def _bounds(drawn: FloatArray) -> tuple[FloatArray, FloatArray]:
    low, high = np.percentile(drawn, PERCENTILES, axis=0)
    return np.asarray(low), np.asarray(high)


def _check(scores: npt.NDArray[np.float64]) -> None:
    if scores.ndim != 2 or not scores.size or not np.isfinite(scores).all():
        raise UsageError("scores", list(scores.shape), "finite numbers [runs, tasks], at least one of each")
