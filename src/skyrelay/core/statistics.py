"""Means of independent values (episodes, seeds) with their 95 % intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import stats


@dataclass(frozen=True)
class Interval:
    """A mean and its 95 % interval (Student's t), NaN where there are too few values.

    Attributes:
        mean, low, high: NaN mean for no value, NaN bounds for fewer than two.
        count: of the values.
    """

    mean: float
    low: float
    high: float
    count: int

    def text(self, digits: int = 1, unit: str = "") -> str:
        """``12.3 % [11.0, 13.6]``."""
        return f"{self.mean:.{digits}f}{unit} [{self.low:.{digits}f}, {self.high:.{digits}f}]"

    def closed(self) -> dict[str, float]:
        """Mean, low and high for JSON, which has no NaN: a single value is its own bounds."""
        low, high = (self.mean if math.isnan(bound) else bound for bound in (self.low, self.high))
        return {"mean": self.mean, "low": low, "high": high}


def interval(values: Iterable[float | None]) -> Interval:
    """Of the values that are there (None and NaN are not)."""
    there = np.array([value for value in values if value is not None and not np.isnan(value)], np.float64)
    if not len(there):
        return Interval(np.nan, np.nan, np.nan, 0)
    mean = float(there.mean())
    if len(there) < 2:
        return Interval(mean, np.nan, np.nan, 1)
    half = float(stats.t.ppf(0.975, len(there) - 1) * there.std(ddof=1) / np.sqrt(len(there)))
    return Interval(mean, mean - half, mean + half, len(there))
