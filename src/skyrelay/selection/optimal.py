"""The best assignment there is, by mixed-integer programming: what any selection can be held against."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array, vstack

from skyrelay.core.entities import IntArray, UavTable, VehicleTable
from skyrelay.core.errors import SelectionError, UsageError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.candidates import candidate_pairs

Objective = Literal["qou", "qov", "served"]

_TIME_LIMIT_REACHED = 1  # `scipy.optimize.milp`: status


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
    Returns: [V] UAV or -1, the objective's value, and the gap left: (bound - value) / value, 0 where proved optimal.
    Raises:
        UsageError: a time limit that is not above 0, or a gap below 0.
        SelectionError: the solver found nothing within the time limit.
    Source: HiGHS, as scipy carries it.
    """
    if time_limit is not None and not time_limit > 0.0:
        raise UsageError("time_limit", time_limit, "seconds above 0")
    if not gap >= 0.0:
        raise UsageError("gap", gap, "a share of the bound, at least 0")
    assignment = np.full(len(vehicles), -1, dtype=np.int64)
    pairs = candidate_pairs(vehicles, uavs, settings)
    fits = vehicles.demand[pairs.vehicle] <= uavs.bandwidth[pairs.uav]
    vehicle, uav = pairs.vehicle[fits], pairs.uav[fits]
    if not len(vehicle):
        return assignment, 0.0, 0.0
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
    if solved.x is None:
        if solved.status == _TIME_LIMIT_REACHED:
            raise SelectionError("optimal: time_limit", time_limit, "more seconds; no assignment was found in these")
        raise SelectionError("optimal", solved.message, "a problem that HiGHS can solve")
    chosen = solved.x > 0.5
    assignment[vehicle[chosen]] = uav[chosen]
    value = float(worth[chosen].sum())
    return assignment, value, max(0.0, (-float(solved.mip_dual_bound) - value) / value) if value else 0.0
