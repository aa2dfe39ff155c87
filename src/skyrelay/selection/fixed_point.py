"""QoV, score and Algorithm 2 in the contract's integers: `contracts/src/SkyRelay.sol` agrees to the last unit.

Units on chain: positions and distances 0.1 m; bandwidth and demand 1 kbit/s; payment 1 cent per Mbit/s; reputation
0.01 (0 to 10,000); weights 1e-6; QoV 1e-15 (100 is 1e17); score 1e-17 of QoV per square root of kbit/s.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from math import isqrt

from skyrelay.core.errors import SelectionError

WEIGHT_SUM = 10**6
MAX_REPUTATION = 10_000
DISTANCE_SCALE = 10**15
"""One unit of distance (0.1 m) inside the square root."""
QOV_SCALE = 10**15
"""QoV of 1."""
SCORE_SCALE = 10**17
"""Score of QoV 1 at a demand of 1 kbit/s."""

_UINT32_MAX = 2**32 - 1
_QOV_PER_WEIGHT = 100 * QOV_SCALE // WEIGHT_SUM


@dataclass(frozen=True)
class FixedParameters:
    """What the contract fixes about Eq. 2 at deployment.

    Attributes:
        weights: of demand, payment, reputation, closeness [1e-6]; they sum to 1,000,000.
        max_demand: Max RB [kbit/s].
        max_payment: Max PayPerMbps [cents per Mbit/s].
        max_distance: Max distance [0.1 m].

    Raises:
        SelectionError: a weight or maximum that the contract would refuse.
    """

    weights: tuple[int, int, int, int]
    max_demand: int
    max_payment: int
    max_distance: int

    def __post_init__(self) -> None:
        if sum(self.weights) != WEIGHT_SUM or min(self.weights) < 0:
            raise SelectionError("weights", self.weights, f"four weights of 0 or more that sum to {WEIGHT_SUM}")
        for name in ("max_demand", "max_payment", "max_distance"):
            _check(name, getattr(self, name), 1, _UINT32_MAX)


def fixed_weights(weights: Sequence[float]) -> tuple[int, int, int, int]:
    """Four weights that sum to 1 as integers [1e-6] that sum to 1,000,000 exactly.

    Each is rounded down, then the largest remainders take the units that are missing (equal ones: the first).

    Raises:
        SelectionError: not four weights, one is negative, or they do not sum to 1.
    """
    if len(weights) != 4 or min(weights) < 0 or abs(sum(weights) - 1) > 1e-9:
        raise SelectionError("weights", tuple(weights), "four weights of 0 or more that sum to 1")
    exact = [weight * WEIGHT_SUM for weight in weights]
    units = [int(value) for value in exact]
    by_remainder = sorted(range(4), key=lambda k: units[k] - exact[k])
    for k in by_remainder[: WEIGHT_SUM - sum(units)]:
        units[k] += 1
    return units[0], units[1], units[2], units[3]


def distance_fixed(dx: int, dy: int) -> int:
    """Euclidean distance [1e-16 m], floored, of a difference of positions [0.1 m]."""
    return isqrt((dx * dx + dy * dy) * DISTANCE_SCALE**2)


def qov_fixed(parameters: FixedParameters, demand: int, payment: int, reputation: int, distance: int) -> int:
    """QoV_uv [1e-15], one fraction floored once.

    Args:
        parameters: weights and maxima.
        demand: RB_v [kbit/s], 1 to the maximum.
        payment: PayPerMbps_v [cents per Mbit/s], 0 to the maximum.
        reputation: Rep_v [0.01], 0 to 10,000.
        distance: from `distance_fixed` [1e-16 m]; what exceeds the maximum counts as the maximum.
    Returns: 0 to 1e17, which is a QoV of 100.
    Raises: SelectionError: an argument that the contract would refuse.
    Source: Eq. 2.
    """
    _check("demand", demand, 1, parameters.max_demand)
    _check("payment", payment, 0, parameters.max_payment)
    _check("reputation", reputation, 0, MAX_REPUTATION)
    w5, w6, w7, w8 = parameters.weights
    farthest = parameters.max_distance * DISTANCE_SCALE
    closeness = max(farthest - distance, 0)
    numerator = (
        w5 * demand * parameters.max_payment * MAX_REPUTATION * farthest
        + w6 * payment * parameters.max_demand * MAX_REPUTATION * farthest
        + w7 * reputation * parameters.max_demand * parameters.max_payment * farthest
        + w8 * closeness * parameters.max_demand * parameters.max_payment * MAX_REPUTATION
    )
    denominator = parameters.max_demand * parameters.max_payment * MAX_REPUTATION * farthest
    return _QOV_PER_WEIGHT * numerator // denominator


def score_fixed(qov: int, demand: int) -> int:
    """QoV/sqrt(RB) [1e-17], floored, of a QoV [1e-15] and a demand [kbit/s].

    Raises: SelectionError: the demand is below 1.
    Source: Algorithm 2, line 2.
    """
    _check("demand", demand, 1, _UINT32_MAX)
    return isqrt(qov * qov * (SCORE_SCALE // QOV_SCALE) ** 2 // demand)


def allocate_fixed(capacity: int, proposals: Sequence[tuple[int, int]]) -> list[int]:
    """Algorithm 2 for one UAV.

    Args:
        capacity: AB_u for the period [kbit/s]; what is already promised to held proposals is part of it.
        proposals: (score [1e-17], demand [kbit/s]) in the order of submission; those held from earlier rounds of the
            period and the new ones together.
    Returns: indices of the accepted proposals, in the order taken: descending score, equal scores by submission. One
        that does not fit is skipped, smaller ones after it may still fit.
    Source: Algorithm 2.
    """
    queue = [(-score, index) for index, (score, _) in enumerate(proposals)]
    heapq.heapify(queue)
    least = min((demand for _, demand in proposals), default=0)
    accepted: list[int] = []
    left = capacity
    # Once less is left than the least that anyone asks for, all others are rejected.
    while queue and least <= left:
        _, index = heapq.heappop(queue)
        demand = proposals[index][1]
        if demand <= left:
            left -= demand
            accepted.append(index)
    return accepted


def _check(place: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise SelectionError(place, value, f"a whole number from {low} to {high}")
