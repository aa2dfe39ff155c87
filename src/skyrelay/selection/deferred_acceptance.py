"""Algorithms 1 and 2 in rounds: a vehicle that was refused, or displaced later, asks the next UAV of its list.

One round is the paper's selection. Repeated until nobody has anyone left to ask it is deferred acceptance, with UAVs
that choose by Algorithm 2 among the vehicles they hold and the new proposals together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.allocation import allocate
from skyrelay.selection.load_aware import Lists
from skyrelay.selection.proposal import Preferences
from skyrelay.selection.quality import are_candidates, density, pair_qou, pair_qov


@dataclass(frozen=True)
class Round:
    """The proposals of one round, in order of submission.

    Attributes:
        vehicle, uav: [P] indices.
        qou: [P] of the UAV for the vehicle.
        score: [P] QoV/sqrt(RB).
        accepted: [P] at the end of this round; a later round may displace the vehicle.
    """

    vehicle: IntArray
    uav: IntArray
    qou: FloatArray
    score: FloatArray
    accepted: npt.NDArray[np.bool_]


def deferred_acceptance(
    vehicles: VehicleTable,
    uavs: UavTable,
    settings: Settings,
    rounds: int | None = 1,
    incumbent: IntArray | None = None,
    hysteresis: float | FloatArray = 0.0,
    preferences: Lists | None = None,
) -> tuple[IntArray, tuple[Round, ...]]:
    """Let vehicles propose and UAVs choose, for so many rounds or until nobody has anyone left to ask.

    Args:
        rounds: at most so many; None: no limit. A vehicle asks a UAV at most once, so it always ends.
        incumbent: [V] UAV that serves each vehicle now, or -1; matters only with ``hysteresis``.
        hysteresis: how many points of QoU above its incumbent another UAV must have for a vehicle to ask it first; one
            number, or [V].
        preferences: vehicles' lists; left out: by QoU.
    Returns: [V] UAV of each vehicle or -1, and the rounds played.
    Source: Algorithms 1 and 2; Gale and Shapley (1962), with a knapsack choice of the receiving side.
    """
    suitors = _Suitors(vehicles, uavs, settings, incumbent, hysteresis, preferences)
    assignment = np.full(len(vehicles), -1, dtype=np.int64)
    submitted = np.zeros(len(vehicles), dtype=np.int64)  # when a held vehicle's proposal came in
    score = np.zeros(len(vehicles))
    played: list[Round] = []
    asking = np.arange(len(vehicles), dtype=np.int64)
    clock = 0
    while rounds is None or len(played) < rounds:
        target, qou = suitors.ask(asking)
        found = target >= 0
        new, target, qou = asking[found], target[found], qou[found]
        if not len(new):
            break
        score[new] = density(pair_qov(vehicles, uavs, new, target, settings), vehicles.demand[new])
        submitted[new] = clock + np.arange(len(new))
        clock += len(new)
        # Only a UAV that was asked in this round can change what it holds.
        asked = np.zeros(len(uavs), dtype=bool)
        asked[target] = True
        held = np.flatnonzero(assignment >= 0)
        held = held[asked[assignment[held]]]
        contenders = np.concatenate([held, new])
        wanted = np.concatenate([assignment[held], target])
        accepted = allocate(
            wanted, score[contenders], vehicles.demand[contenders], uavs.bandwidth, submitted[contenders]
        )
        assignment[contenders] = np.where(accepted, wanted, -1)
        played.append(Round(new, target, qou, score[new], accepted[len(held) :]))
        asking = np.sort(contenders[~accepted])
    return assignment, tuple(played)


class _Suitors:
    """Where each vehicle stands in its list of UAVs; with hysteresis, when it asks its incumbent ahead of that list."""

    def __init__(
        self,
        vehicles: VehicleTable,
        uavs: UavTable,
        settings: Settings,
        incumbent: IntArray | None,
        hysteresis: float | FloatArray,
        preferences: Lists | None,
    ) -> None:
        self._preferences = preferences or Preferences(vehicles, uavs, settings)
        self._hysteresis = np.broadcast_to(np.asarray(hysteresis, dtype=np.float64), (len(vehicles),))
        self._place = np.zeros(len(vehicles), dtype=np.int64)  # of the next to ask
        self._incumbent = np.full(len(vehicles), -1, dtype=np.int64)
        self._incumbent_qou = np.full(len(vehicles), -np.inf)
        self._incumbent_asked = np.zeros(len(vehicles), dtype=bool)
        if incumbent is not None and (self._hysteresis > 0.0).any():
            rows = np.flatnonzero(incumbent >= 0)
            rows = rows[are_candidates(vehicles, uavs, rows, incumbent[rows], settings)]
            qou = pair_qou(vehicles, uavs, rows, incumbent[rows], settings)
            self._incumbent[rows[qou > 0.0]] = incumbent[rows[qou > 0.0]]
            self._incumbent_qou[rows[qou > 0.0]] = qou[qou > 0.0]

    def ask(self, rows: IntArray) -> tuple[IntArray, FloatArray]:
        """The UAV that each of ``rows`` asks next, or -1, and its QoU."""
        uav, qou = self._preferences.at(rows, self._place[rows])
        # An incumbent that was asked early comes up once more at its own place in the list: pass over it there.
        again = (uav >= 0) & (uav == self._incumbent[rows]) & self._incumbent_asked[rows]
        self._place[rows[again]] += 1
        uav[again], qou[again] = self._preferences.at(rows[again], self._place[rows[again]])
        stays = (self._incumbent[rows] >= 0) & ~self._incumbent_asked[rows]
        stays &= self._incumbent_qou[rows] + self._hysteresis[rows] >= qou
        self._incumbent_asked[rows[stays]] = True
        self._place[rows[~stays]] += 1
        return np.where(stays, self._incumbent[rows], uav), np.where(stays, self._incumbent_qou[rows], qou)
