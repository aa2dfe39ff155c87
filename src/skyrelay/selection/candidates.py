"""The candidate pairs of vehicles and UAVs, listed: for the methods that look at all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.quality import are_candidates, pair_qou, pair_qov


@dataclass(frozen=True)
class Pairs:
    """Pairs whose UAV is a candidate of the vehicle with a QoU above 0, by vehicle and then by UAV.

    Attributes:
        vehicle, uav: [P] indices.
        qou, qov: [P] Eq. 1 and 2.
        start: [V + 1] where each vehicle's pairs begin.
    """

    vehicle: IntArray
    uav: IntArray
    qou: FloatArray
    qov: FloatArray
    start: IntArray

    def __len__(self) -> int:
        return len(self.vehicle)


def candidate_pairs(vehicles: VehicleTable, uavs: UavTable, settings: Settings, of: IntArray | None = None) -> Pairs:
    """List the candidate pairs; memory grows with their number (about 60 bytes a pair at the peak).

    Args:
        of: indices of the vehicles whose pairs are wanted; left out: all.
    """
    wanted = np.arange(len(vehicles), dtype=np.int64) if of is None else of
    rows, columns = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for zone in np.intersect1d(vehicles.zone[wanted], uavs.zone):
        members, there = wanted[vehicles.zone[wanted] == zone], np.flatnonzero(uavs.zone == zone)
        if settings.candidates == "zone":
            rows.append(np.repeat(members, len(there)))
            columns.append(np.tile(there, len(members)))
            continue
        tree = cKDTree(np.column_stack([uavs.x[there], uavs.y[there]]))
        spot = np.column_stack([vehicles.x[members], vehicles.y[members]])
        # A hair more than the range: the last word is `are_candidates`, which rounds as the scores do.
        near = tree.query_ball_point(spot, settings.max_distance * (1 + 1e-9), return_sorted=True)
        rows.append(np.repeat(members, [len(found) for found in near]))
        columns.append(there[np.concatenate([np.asarray(found, dtype=np.int64) for found in near])])
    vehicle, uav = np.concatenate(rows), np.concatenate(columns)
    order = np.argsort(vehicle, kind="stable")
    vehicle, uav = vehicle[order], uav[order]
    kept = are_candidates(vehicles, uavs, vehicle, uav, settings)
    vehicle, uav = vehicle[kept], uav[kept]
    qou = pair_qou(vehicles, uavs, vehicle, uav, settings)
    vehicle, uav, qou = vehicle[qou > 0.0], uav[qou > 0.0], qou[qou > 0.0]
    return Pairs(
        vehicle=vehicle,
        uav=uav,
        qou=qou,
        qov=pair_qov(vehicles, uavs, vehicle, uav, settings),
        start=np.searchsorted(vehicle, np.arange(len(vehicles) + 1)),
    )
