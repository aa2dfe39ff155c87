"""Selection within a period: whoever has a UAV keeps it, whoever has none asks those that have room."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from skyrelay.core.entities import IntArray, UavTable, VehicleTable
from skyrelay.core.errors import SelectionError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.allocation import allocate
from skyrelay.selection.proposal import propose
from skyrelay.selection.quality import density, pair_qov


def reselect(vehicles: VehicleTable, uavs: UavTable, assignment: IntArray, settings: Settings) -> IntArray:
    """Algorithms 1 and 2, one round of them, over the bandwidth that has fallen free.

    A vehicle without a UAV asks the one of highest QoU among those whose room is at least its demand. UAVs choose
    among these proposals alone.

    Args:
        assignment: [V] index of the UAV that each vehicle has, or -1.
    Returns: [V] the same, with those that have got one.
    Raises:
        SelectionError: ``assignment`` is not of shape [V], or names no UAV of the table.
    """
    if assignment.shape != (len(vehicles),) or (assignment >= len(uavs)).any():
        raise SelectionError("assignment", assignment, f"{len(vehicles)} indices below {len(uavs)}")
    chosen = assignment.copy()
    held = chosen >= 0
    room = uavs.bandwidth - np.bincount(chosen[held], vehicles.demand[held], len(uavs))
    asking = np.flatnonzero(~held)
    full = room < vehicles.demand[asking, None]
    target = propose(_rows(vehicles, asking), uavs, settings, full)
    asking, target = asking[target >= 0], target[target >= 0]
    demand = vehicles.demand[asking]
    score = density(pair_qov(vehicles, uavs, asking, target, settings), demand)
    accepted = allocate(target, score, demand, room)
    chosen[asking[accepted]] = target[accepted]
    return chosen


def _rows(vehicles: VehicleTable, rows: IntArray) -> VehicleTable:
    """A table of some of the vehicles."""
    columns = {field.name: getattr(vehicles, field.name)[rows] for field in fields(vehicles) if field.name != "ids"}
    return VehicleTable(ids=tuple(vehicles.ids[row] for row in rows), **columns)
