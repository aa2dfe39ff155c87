"""Vehicles and UAVs as tables: one array an attribute, one row a member."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyrelay.core.errors import SelectionError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class VehicleTable:
    """Vehicles at one instant (Table "Symbols and Notations").

    Attributes:
        ids: [V], unique.
        x, y: [V] position [m].
        zone: [V] zone id; a vehicle may only be served from its own zone.
        demand: [V] requested bandwidth RB_v [kbit/s], above 0.
        payment: [V] PayPerMbps_v [cents per Mbit/s], at least 0.
        reputation: [V] Rep_v [0-100].

    Raises:
        SelectionError: lengths differ, an id stands twice, or a number is not finite or out of its range.
    """

    ids: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    zone: IntArray
    demand: FloatArray
    payment: FloatArray
    reputation: FloatArray

    def __post_init__(self) -> None:
        _check_ids("vehicles", self.ids)
        count = len(self.ids)
        _check_column("vehicles", "x", self.x, count)
        _check_column("vehicles", "y", self.y, count)
        _check_zone("vehicles", self.zone, count)
        _check_column("vehicles", "demand", self.demand, count, above=0.0)
        _check_column("vehicles", "payment", self.payment, count, low=0.0)
        _check_column("vehicles", "reputation", self.reputation, count, low=0.0, high=100.0)

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class UavTable:
    """UAVs at one instant (Table "Symbols and Notations").

    Attributes:
        ids: [U], unique.
        x, y: [U] position [m].
        zone: [U] zone id.
        bandwidth: [U] available bandwidth AB_u [kbit/s], at least 0.
        battery: [U] battery level BL_u [0-100].
        reputation: [U] Rep_u [0-100].

    Raises:
        SelectionError: lengths differ, an id stands twice, or a number is not finite or out of its range.
    """

    ids: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    zone: IntArray
    bandwidth: FloatArray
    battery: FloatArray
    reputation: FloatArray

    def __post_init__(self) -> None:
        _check_ids("uavs", self.ids)
        count = len(self.ids)
        _check_column("uavs", "x", self.x, count)
        _check_column("uavs", "y", self.y, count)
        _check_zone("uavs", self.zone, count)
        _check_column("uavs", "bandwidth", self.bandwidth, count, low=0.0)
        _check_column("uavs", "battery", self.battery, count, low=0.0, high=100.0)
        _check_column("uavs", "reputation", self.reputation, count, low=0.0, high=100.0)

    def __len__(self) -> int:
        return len(self.ids)


def _check_ids(table: str, ids: Sequence[str]) -> None:
    if len(set(ids)) == len(ids):
        return
    seen: set[str] = set()
    for row, name in enumerate(ids):
        if name in seen:
            raise SelectionError(f"{table}.ids[{row}]", name, "an id that no other row has")
        seen.add(name)


def _check_zone(table: str, column: IntArray, count: int) -> None:
    if not np.issubdtype(column.dtype, np.integer):
        raise SelectionError(f"{table}.zone", column.dtype, "integers")
    _check_column(table, "zone", column, count)


def _check_column(
    table: str,
    name: str,
    column: FloatArray | IntArray,
    count: int,
    low: float = -np.inf,
    high: float = np.inf,
    above: float = -np.inf,
) -> None:
    if column.shape != (count,):
        raise SelectionError(f"{table}.{name}", f"of shape {column.shape}", f"one number for each of {count} ids")
    wrong = ~(np.isfinite(column) & (column >= low) & (column <= high) & (column > above))
    if wrong.any():
        row = int(np.argmax(wrong))
        bounds = [f"above {above:g}"] if np.isfinite(above) else [f"at least {low:g}"] if np.isfinite(low) else []
        bounds += [f"at most {high:g}"] if np.isfinite(high) else []
        raise SelectionError(
            f"{table}.{name}[{row}]", column[row].item(), " ".join(["a finite number", " and ".join(bounds)]).strip()
        )
