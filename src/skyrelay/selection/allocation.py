"""Algorithm 2: each UAV takes the proposals of highest QoV/sqrt(RB) that fit its bandwidth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skyrelay.core.entities import FloatArray, IntArray


def allocate(
    uav: IntArray,
    score: npt.NDArray[np.float64] | IntArray,
    demand: FloatArray | IntArray,
    capacity: FloatArray | IntArray,
    order: IntArray | None = None,
) -> npt.NDArray[np.bool_]:
    """Which proposals are accepted (Algorithm 2).

    A proposal that does not fit is skipped; a smaller one after it may still fit. Works on the contract's integers as
    well as on floating point.

    Args:
        uav: [P] index of the UAV that each proposal is for.
        score: [P] QoV/sqrt(RB); the highest is taken first.
        demand: [P] RB [kbit/s].
        capacity: [U] AB [kbit/s].
        order: [P] of submission, which decides between equal scores; left out: as they stand.
    Returns: [P] true where accepted.
    Source: Algorithm 2, read as docs/assumptions.md has it (the listing sorts and walks the selection list and pushes
        u; the proposal list and v are meant).
    """
    accepted = np.zeros(len(uav), dtype=bool)
    # Stable sorts, the weightiest key last: by submission, by falling score, by UAV.
    ranking = np.arange(len(uav)) if order is None else np.argsort(order, kind="stable")
    ranking = ranking[np.argsort(-score[ranking], kind="stable")]
    ranking = ranking[np.argsort(uav[ranking], kind="stable")]
    free = capacity.tolist()
    taken = []
    for position, u, asked in zip(ranking.tolist(), uav[ranking].tolist(), demand[ranking].tolist(), strict=True):
        if asked <= free[u]:
            free[u] -= asked
            taken.append(position)
    accepted[taken] = True
    return accepted
