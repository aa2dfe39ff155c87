"""The figures of a run, worked out from its tables: one definition each, for the run, its page, its charts, its audit.

All are over the steps 1 to N, each of which a move led to; step 0, before the first move, is in the tables only.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

DIGITS = 6


def over_the_run(metrics: Mapping[str, npt.NDArray[Any]]) -> dict[str, float | None]:
    """The figures of ``summary.json`` that are made from the metrics table.

    Args:
        metrics: the columns of ``metrics.parquet``.
    Returns: by key; None where there was nothing to measure.
    """
    rows = (metrics["zone"] == 0) & (metrics["step"] > 0)
    whole = {name: column[rows] for name, column in metrics.items()}
    connected = int(whole["connected"].sum())
    steps = int(rows.sum())
    return {
        "connected": _share(connected, steps),
        "in_range": _share(int(whole["covered"].sum()), steps),
        "static_in_range": _share(int(whole["static_covered"].sum()), steps),
        "in_range_share": _share(int(whole["covered"].sum()), connected),
        "static_in_range_share": _share(int(whole["static_covered"].sum()), connected),
        "coverage": _share(int(whole["covered"].sum()), int(whole["vehicles"].sum())),
        "static_coverage": _share(int(whole["static_covered"].sum()), int(whole["static_vehicles"].sum())),
        "connectivity": _mean(whole["connectivity"]),
        "connectivity_neighbor": _mean(whole["connectivity_neighbor"]),
        "static_connectivity": _mean(whole["static_connectivity"]),
        "served_mbps": _mean(whole["served_mbps"]),
        "static_served_mbps": _mean(whole["static_served_mbps"]),
        "energy_percent": _mean(whole["energy_percent"][whole["step"] == whole["step"].max(initial=0)]),
    }


def _share(part: int, whole: int) -> float | None:
    return round(part / whole, DIGITS) if whole else None


def _mean(values: npt.NDArray[Any]) -> float | None:
    there = values[np.isfinite(values)]
    return round(float(np.mean(there)), DIGITS) if len(there) else None
