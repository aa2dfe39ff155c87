"""The best assignment there is, by mixed-integer programming: what any selection can be held against."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array, vstack

from skyrelay.core.entities import IntArray, UavTable, VehicleTable
from skyrelay.core.errors import UsageError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.candidates import candidate_pairs
from skyrelay.selection.deferred_acceptance import deferred_acceptance
from skyrelay.selection.quality import pair_qou, pair_qov

Objective = Literal["qou", "qov", "served"]


def optimal(
    vehicles: VehicleTable,
    uavs: UavTable,
    settings: Settings,
    objective: Objective = "qou",
    time_limit: float | None = None,
    gap: float = 1e-4,
) -> tuple[IntArray, float, float]:
    """Maximise total QoU, total QoV or the number of served vehicles under the UAVs' bandwidths.

    Args:
        time_limit: stop after so many seconds with the best assignment found; None: no limit.
        gap: stop when the assignment is within this share of the bound.
    Returns: [V] UAV or -1, the total, and the gap left: (bound - total) / total, infinite where there is no bound yet.
    Raises:
        UsageError: a time limit that is not above 0, or a gap below 0.
    Source: HiGHS, as scipy carries it.
    """
    if time_limit is not None and not time_limit > 0.0:
        raise UsageError("time_limit", time_limit, "seconds above 0")
    if not gap >= 0.0:
        raise UsageError("gap", gap, "a share of the bound, at least 0")
    # The solver takes no start, and stopped early it may have nothing: deferred acceptance is the least there is.
    candidates = [deferred_acceptance(vehicles, uavs, settings, rounds=None)[0]]
    pairs = candidate_pairs(vehicles, uavs, settings)
    fits = vehicles.demand[pairs.vehicle] <= uavs.bandwidth[pairs.uav]
    vehicle, uav = pairs.vehicle[fits], pairs.uav[fits]
    if not len(vehicle):
        return candidates[0], 0.0, 0.0
    worth = {"qou": pairs.qou[fits], "qov": pairs.qov[fits], "served": np.ones(len(vehicle))}[objective]
    column = np.arange(len(vehicle))
    one_uav_each = csr_array((np.ones(len(vehicle)), (vehicle, column)), shape=(len(vehicles), len(vehicle)))
    bandwidth = csr_array((vehicles.demand[vehicle], (uav, column)), shape=(len(uavs), len(vehicle)))
    solved = milp(
        -worth,
        integrality=np.ones(len(vehicle), dtype=np.int64),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(
            vstack([one_uav_each, bandwidth]), ub=np.concatenate([np.ones(len(vehicles)), uavs.bandwidth])
        ),
        options={"mip_rel_gap": gap, "time_limit": np.inf if time_limit is None else time_limit},
    )
    if solved.x is not None:
        chosen = solved.x > 0.5
        found = np.full(len(vehicles), -1, dtype=np.int64)
        found[vehicle[chosen]] = uav[chosen]
        candidates.append(found)
    totals = [_total(vehicles, uavs, settings, objective, assignment) for assignment in candidates]
    best = int(np.argmax(totals))
    bound = np.inf if solved.mip_dual_bound is None else -float(solved.mip_dual_bound)
    return candidates[best], totals[best], max(0.0, (bound - totals[best]) / totals[best])


def _total(
    vehicles: VehicleTable, uavs: UavTable, settings: Settings, objective: Objective, assignment: IntArray
) -> float:
    rows = np.flatnonzero(assignment >= 0)
    if objective == "served":
        return float(len(rows))
    score = pair_qou if objective == "qou" else pair_qov
    return float(score(vehicles, uavs, rows, assignment[rows], settings).sum())
