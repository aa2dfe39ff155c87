"""QoU that knows the load: where much is asked of a UAV, vehicles like it less, and spread before they are refused."""

from __future__ import annotations

import numpy as np

from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.candidates import Pairs, candidate_pairs
from skyrelay.selection.quality import pair_qou


def load_aware_lists(vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> Lists:
    """Every vehicle's candidates, by QoU times (1 - w + w a): w is ``load_weight``, a the UAV's `availability`.

    A UAV that has less than the vehicle asks for stands at its place all the same, as in Algorithm 1.
    """
    pairs = candidate_pairs(vehicles, uavs, settings)
    weight = settings.load_weight
    liking = pairs.qou * (1.0 - weight + weight * availability(vehicles, uavs, pairs)[pairs.uav])
    return Lists(vehicles, uavs, settings, pairs, liking)


def availability(vehicles: VehicleTable, uavs: UavTable, pairs: Pairs) -> FloatArray:
    """[U] a UAV's bandwidth as a share of that and what is expected to be asked of it: 1 where nobody asks.

    Expected is that a vehicle asks each of its candidates with the same probability.
    """
    choices = np.diff(pairs.start)
    expected = np.bincount(pairs.uav, vehicles.demand[pairs.vehicle] / choices[pairs.vehicle], len(uavs))
    total = uavs.bandwidth + expected
    return np.divide(uavs.bandwidth, total, out=np.zeros(len(uavs)), where=total > 0.0)


class Lists:
    """Vehicles' lists of candidates in an order of their own; see `proposal.Preferences`."""

    def __init__(
        self, vehicles: VehicleTable, uavs: UavTable, settings: Settings, pairs: Pairs, liking: FloatArray
    ) -> None:
        self._tables = vehicles, uavs, settings
        self._uav = pairs.uav[np.lexsort((-liking, pairs.vehicle))]  # stable: the first of equals first
        self._start = pairs.start

    def at(self, rows: IntArray, place: IntArray) -> tuple[IntArray, FloatArray]:
        """As `proposal.Preferences.at`: [R] UAV and its QoU."""
        vehicles, uavs, settings = self._tables
        uav, qou = np.full(len(rows), -1, dtype=np.int64), np.full(len(rows), -np.inf)
        spot = self._start[rows] + place
        there = np.flatnonzero(spot < self._start[rows + 1])
        uav[there] = self._uav[spot[there]]
        qou[there] = pair_qou(vehicles, uavs, rows[there], uav[there], settings)
        return uav, qou
