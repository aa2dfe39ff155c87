"""Whether a selection keeps the rules, and how many pairs of a vehicle and a UAV would rather have each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.candidates import Pairs, candidate_pairs
from skyrelay.selection.quality import are_candidates, density, pair_qou, pair_qov

BANDWIDTH_TOLERANCE = 1e-6
"""[kbit/s] by which the MILP's solver may overstep a quota that is no whole number."""

_CHUNK_PAIRS = 4_000_000


def is_valid(vehicles: VehicleTable, uavs: UavTable, assignment: IntArray, settings: Settings) -> bool:
    """Whether each served vehicle has a candidate of QoU above 0, and no UAV serves more than its bandwidth.

    Args:
        assignment: [V] UAV or -1.
    """
    rows = np.flatnonzero(assignment >= 0)
    chosen = assignment[rows]
    load = np.bincount(chosen, weights=vehicles.demand[rows], minlength=len(uavs))
    return bool(
        are_candidates(vehicles, uavs, rows, chosen, settings).all()
        and (pair_qou(vehicles, uavs, rows, chosen, settings) > 0.0).all()
        and (load <= uavs.bandwidth + BANDWIDTH_TOLERANCE).all()
    )


def excess(vehicles: VehicleTable, uavs: UavTable, assignment: IntArray) -> FloatArray:
    """[U] bandwidth that each UAV promised above what it has [kbit/s]; of a valid selection none."""
    rows = np.flatnonzero(assignment >= 0)
    over = np.bincount(assignment[rows], weights=vehicles.demand[rows], minlength=len(uavs)) - uavs.bandwidth
    return np.where(over > BANDWIDTH_TOLERANCE, over, 0.0)


def count_blocking_pairs(vehicles: VehicleTable, uavs: UavTable, assignment: IntArray, settings: Settings) -> int:
    """How many pairs block the assignment under bandwidth quotas; none: it is stable.

    A candidate pair (v, u) blocks when v would gain QoU by changing to u (or is unserved), and u has the bandwidth
    that v asks once the vehicles are sent away whose QoV/sqrt(RB) at u is below v's. For equal demands this is the
    blocking pair of the hospital-resident problem. Where a UAV promised more than it has, its bandwidth counts as
    raised to what it promised; a vehicle that asks for more than it has by itself is no pair.

    Args:
        assignment: [V] UAV or -1.
    Source: docs/explanation/stability.md.
    """
    return sum(
        int(_blocks(vehicles, uavs, assignment, pairs, settings).sum()) for pairs in _chunks(vehicles, uavs, settings)
    )


def blocking_pairs(
    vehicles: VehicleTable, uavs: UavTable, assignment: IntArray, settings: Settings
) -> list[tuple[int, int]]:
    """The blocking pairs themselves, as (vehicle, UAV); see `count_blocking_pairs`."""
    pairs = candidate_pairs(vehicles, uavs, settings)
    blocks = _blocks(vehicles, uavs, assignment, pairs, settings)
    return list(zip(pairs.vehicle[blocks].tolist(), pairs.uav[blocks].tolist(), strict=True))


def _blocks(
    vehicles: VehicleTable, uavs: UavTable, assignment: IntArray, pairs: Pairs, settings: Settings
) -> npt.NDArray[np.bool_]:
    """[P] true where the pair blocks."""
    served = np.flatnonzero(assignment >= 0)
    home = assignment[served]
    current = np.full(len(vehicles), -np.inf)
    current[served] = pair_qou(vehicles, uavs, served, home, settings)
    gains = pairs.qou > current[pairs.vehicle]
    vehicle, uav = pairs.vehicle[gains], pairs.uav[gains]
    held_score = density(pair_qov(vehicles, uavs, served, home, settings), vehicles.demand[served])
    score = density(pairs.qov[gains], vehicles.demand[vehicle])
    kept = _load_at_least(home, held_score, vehicles.demand[served], uav, score)
    raised = uavs.bandwidth + excess(vehicles, uavs, assignment)
    result = np.zeros(len(pairs), dtype=bool)
    asked = vehicles.demand[vehicle]
    result[gains] = (asked <= raised[uav] - kept) & (asked <= uavs.bandwidth[uav])
    return result


def _load_at_least(
    home: IntArray, held_score: FloatArray, held_demand: FloatArray, uav: IntArray, score: FloatArray
) -> FloatArray:
    """[P] bandwidth [kbit/s] that each UAV of ``uav`` [P] gives to vehicles whose score is at least ``score`` [P].

    Held vehicles and questions are sorted together by UAV and falling score, held ones first among equals; the answer
    is then the running sum of what is held.
    """
    of = np.concatenate([home, uav])
    value = np.concatenate([held_score, score])
    is_question = np.concatenate([np.zeros(len(home), dtype=bool), np.ones(len(uav), dtype=bool)])
    demand = np.concatenate([held_demand, np.zeros(len(uav))])
    order = np.lexsort((is_question, -value, of))
    running = np.cumsum(demand[order])
    begins = np.searchsorted(of[order], of[order], side="left")
    before = np.concatenate([[0.0], running])[begins]
    answer = np.empty(len(of))
    answer[order] = running - before
    return answer[len(home) :]


def _chunks(vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> Iterator[Pairs]:
    """All candidate pairs, so many vehicles at a time that memory stays bounded."""
    step = max(1, _CHUNK_PAIRS // max(1, len(uavs)))
    for start in range(0, len(vehicles), step):
        yield candidate_pairs(
            vehicles, uavs, settings, np.arange(start, min(start + step, len(vehicles)), dtype=np.int64)
        )
