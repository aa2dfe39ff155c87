"""The figures of a run, worked out from its tables: one definition each, for the run, its page, its charts, its audit.

All are over the steps 1 to N, each of which a move led to; step 0, before the first move, is in the tables only.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

DIGITS = 6

Columns = Mapping[str, npt.NDArray[Any]]


def over_the_run(metrics: Columns, vehicles: Columns) -> dict[str, float | None]:
    """The figures of ``summary.json`` that are made from these tables.

    Args:
        metrics, vehicles: the columns of ``metrics.parquet`` and of ``vehicles.parquet``.
    Returns: by key; None where there was nothing to measure.
    """
    rows = (metrics["zone"] == 0) & (metrics["step"] > 0)
    whole = {name: column[rows] for name, column in metrics.items()}
    connected, demand = int(whole["connected"].sum()), float(whole["demand_mbps"].sum())
    steps = int(rows.sum())
    figures = {
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
        "demand_mbps": _mean(whole["demand_mbps"]),
    }
    seconds = float(whole["time"][0] / whole["step"][0]) if steps else 0.0
    there = _tracks(vehicles)
    for kind in ("", "static_"):
        for what in ("carried", "delivered"):
            rate = whole[f"{kind}{what}_mbps"]
            figures[f"{kind}{what}_mbps"] = _mean(rate)
            figures[f"{kind}{what}_share"] = _share(float(rate.sum()), demand)
        figures[f"{kind}fairness"] = fairness(there, f"{kind}delivered_kbps")
        figures[f"{kind}handovers"] = handovers(there, f"{kind}uav")
        figures[f"{kind}outage_p95_seconds"] = outage(there, f"{kind}delivered_kbps", seconds)
    return figures


def over_charging(charging: Columns, uavs: Columns, seconds: float) -> dict[str, float | None]:
    """The figures of ``summary.json`` about charging places.

    Args:
        charging, uavs: the columns of ``charging.parquet`` and of ``uavs.parquet``.
        seconds: a step takes.
    Returns: by key.
    """
    moved, away = uavs["step"] > 0, charging["step"] > 0
    uav, step = _codes(charging["uav"][away]), charging["step"][away]
    order = np.lexsort((step, uav))
    uav, step = uav[order], step[order]
    stays = int((np.diff(uav, prepend=-1) != 0).sum()) + int(((np.diff(uav) == 0) & (np.diff(step) != 1)).sum())
    waits = int((charging["state"][away] == "waiting").sum())
    return {
        "charged_share": _share(int(away.sum()), int(moved.sum())),
        "waiting_seconds": _share(waits * seconds, stays),
        "lowest_battery": round(float(uavs["battery"].min()), DIGITS) if len(uavs["battery"]) else None,
    }


def fairness(tracks: Columns, rate: str) -> float | None:
    """Jain's index of what vehicles got of what they asked for, each over all of its steps; None where none got any.

    1 where all got the same share, 1/n where one of n got everything (R. Jain, D. Chiu, W. Hawe, DEC-TR-301, 1984).

    Args:
        tracks: rows in order (`_tracks`).
        rate: the column of what they got.
    """
    asked = np.bincount(tracks["vehicle"], weights=tracks["demand_kbps"])
    got = np.bincount(tracks["vehicle"], weights=tracks[rate])
    share = got[asked > 0] / asked[asked > 0]
    squares = len(share) * float((share**2).sum())
    return round(float(share.sum()) ** 2 / squares, DIGITS) if squares else None


def handovers(tracks: Columns, uav: str) -> int:
    """How often a vehicle had another UAV than the one that served it last; arguments as in `fairness`."""
    served = tracks[uav] >= 0
    vehicle, by = tracks["vehicle"][served], tracks[uav][served]
    return int(((vehicle[1:] == vehicle[:-1]) & (by[1:] != by[:-1])).sum())


def outage(tracks: Columns, rate: str, seconds: float) -> float | None:
    """How long 19 of 20 outages lasted at most [s]; 0 without an outage, None without a vehicle.

    An outage is steps one after the other at which a vehicle is there and gets nothing.

    Args:
        tracks, rate: as in `fairness`.
        seconds: a step takes.
    """
    vehicle, step = tracks["vehicle"], tracks["step"]
    if not len(vehicle):
        return None
    without = tracks[rate] <= 0.0
    goes_on = without[:-1] & (vehicle[1:] == vehicle[:-1]) & (step[1:] == step[:-1] + 1)
    begins = without & ~np.concatenate([[False], goes_on])
    lengths = np.bincount(np.cumsum(begins)[without])[1:]
    return round(float(np.quantile(lengths, 0.95, method="inverted_cdf")) * seconds, DIGITS) if len(lengths) else 0.0


def _tracks(vehicles: Columns) -> Columns:
    """Rows from step 1 on, one vehicle's after the other's in the order of steps; texts as numbers, -1 for none."""
    moved = np.flatnonzero(vehicles["step"] > 0)
    vehicle = _codes(vehicles["vehicle"][moved])
    order = np.lexsort((vehicles["step"][moved], vehicle))
    numbers = ("step", "demand_kbps", "delivered_kbps", "static_delivered_kbps")
    columns = {name: vehicles[name][moved][order] for name in numbers}
    uavs = {name: _codes(vehicles[name][moved])[order] for name in ("uav", "static_uav")}
    return {"vehicle": vehicle[order]} | columns | uavs


def _codes(texts: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    names = [text for text in dict.fromkeys(texts.tolist()) if text]
    codes = {"": -1} | {name: number for number, name in enumerate(names)}
    return np.array([codes[text] for text in texts.tolist()], dtype=np.int64)


def _share(part: float, whole: float) -> float | None:
    return round(part / whole, DIGITS) if whole else None


def _mean(values: npt.NDArray[Any]) -> float | None:
    there = values[np.isfinite(values)]
    return round(float(np.mean(there)), DIGITS) if len(there) else None
