"""Which UAV goes to which zone for the next period, so that the fleet holds more of what is asked for.

Every UAV works out the same plan from the same events of the contract, and moves itself alone (updateUAVZone).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from skyrelay.chain.abi import Event
from skyrelay.chain.client import DECIMETRES, HUNDREDTHS
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.core.zones import ZoneGrid

LEAST_GAIN = 0.8
"""That a move must bring, in mean demands of a vehicle: for less a UAV does not leave its place."""
FLIGHT_COST = 0.04
"""Likewise of each step that the UAV flies to the zone: of equals the nearest goes."""

_OF_A_MOVE = frozenset({"UAVZoneUpdated", "UAVSubmissionReset", "ZoneOpened"})


@dataclass
class Books:
    """What the contract's events say of supply and demand.

    Attributes:
        zone_of: zone by vehicle, of those that have reported since the last period ended.
        zone_before: likewise, of the period before.
        demand_of: [kbit/s] by vehicle, of those that ever proposed.
        uav_zone, uav_bandwidth, uav_battery, uav_place: by UAV; zone 0 has left; [kbit/s]; [%]; [m].
        moving: zones that UAVs have changed to since anything else happened. They count once it does, so that a host
            that works out the plan after the first have gone works out the same one.
    """

    zone_of: dict[str, int] = field(default_factory=dict)
    zone_before: dict[str, int] = field(default_factory=dict)
    demand_of: dict[str, int] = field(default_factory=dict)
    uav_zone: dict[str, int] = field(default_factory=dict)
    uav_bandwidth: dict[str, int] = field(default_factory=dict)
    uav_battery: dict[str, float] = field(default_factory=dict)
    uav_place: dict[str, tuple[float, float]] = field(default_factory=dict)

    moving: dict[str, int] = field(default_factory=dict)

    def hear(self, event: Event) -> None:
        """Note an event."""
        args = event.args
        if event.name not in _OF_A_MOVE:
            self.uav_zone |= self.moving
            self.moving.clear()
        match event.name:
            case "ZoneListsReset":
                if self.zone_of:
                    self.zone_before, self.zone_of = self.zone_of, {}
            case "VehicleRegistered" | "VehicleUpdated":
                self.zone_of[args["vehicle"]] = args["zone"]
            case "VehSelectionSubmitted":
                self.demand_of[args["vehicle"]] = args["demand"]
            case "UAVRegistered" | "UAVUpdated":
                self.uav_bandwidth[args["uav"]] = args["bandwidth"]
                self.uav_battery[args["uav"]] = args["battery"] / HUNDREDTHS
                self.uav_place[args["uav"]] = (args["x"] / DECIMETRES, args["y"] / DECIMETRES)
            case "UAVZoneUpdated":
                self.moving[args["uav"]] = args["to"]

    def asked(self, grid: ZoneGrid, *, before: bool = False) -> tuple[FloatArray, float] | None:
        """[Z] what is asked for in each zone, and by a vehicle on average [kbit/s].

        None before anything was asked for: a vehicle tells its demand when it first proposes.

        Args:
            before: go by where vehicles were in the period before, where none has told yet where it is in this one: by
                batches they tell it with their proposals.
        """
        zone_of = self.zone_of or (self.zone_before if before else {})
        told = [self.demand_of[vehicle] for vehicle in zone_of if vehicle in self.demand_of]
        if not told:
            return None
        mean = float(np.mean(told))
        asked = np.zeros(len(grid.ids))
        for vehicle, zone in zone_of.items():
            if zone in grid.ids:
                asked[zone - 1] += self.demand_of.get(vehicle, mean)
        return asked, mean

    def moves(self, grid: ZoneGrid, stride: float, zones: Mapping[str, int] | None = None) -> dict[str, int]:
        """The zone that each UAV goes to that is not to stay; nobody moves before anything was asked for.

        Args:
            stride: length of a step [m].
            zones: by UAV, where they are by then; None: where they are now.
        """
        told = self.asked(grid)
        if told is None:
            return {}
        asked, mean = told
        at = self.uav_zone if zones is None else zones
        uavs = sorted(uav for uav, zone in at.items() if zone in grid.ids and uav in self.uav_place)
        stations = plan(
            asked,
            np.array([at[uav] for uav in uavs], dtype=np.int64),
            np.array([self.uav_bandwidth[uav] for uav in uavs], dtype=np.float64),
            np.array([self.uav_place[uav] for uav in uavs], dtype=np.float64).reshape(-1, 2),
            grid,
            mean,
            stride,
        )
        return {uav: zone for uav, zone in zip(uavs, stations.tolist(), strict=True) if zone != at[uav]}


def plan(
    asked: FloatArray,
    zone: IntArray,
    bandwidth: FloatArray,
    place: FloatArray,
    grid: ZoneGrid,
    mean: float,
    stride: float,
) -> IntArray:
    """Move UAV after UAV to the neighbouring zone where it adds most to what zones can hold, while it is worth it.

    What a zone can hold is the least of what is asked for in it and of what its UAVs have together.

    Args:
        asked: [Z] in each zone, in the order of its ids [kbit/s].
        zone: [U] id of each UAV's.
        bandwidth: [U] of each UAV [kbit/s].
        place: [U, 2] of each UAV [m].
        mean: demand of a vehicle [kbit/s].
        stride: length of a step [m].
    Returns: [U] id of the zone that each UAV shall fly in.
    """
    stations = zone.copy()
    supply = np.bincount(zone - 1, bandwidth, len(asked)).astype(np.float64)
    flight = np.array([_way(place, grid, one) for one in grid.ids]).T / stride
    near = np.array([_neighbours(grid, one) for one in grid.ids])[zone - 1]
    moved = np.zeros(len(zone), dtype=bool)
    for _ in range(len(zone)):
        held = np.minimum(asked, supply)
        here = stations - 1
        loss = held[here] - np.minimum(asked[here], supply[here] - bandwidth)
        gain = np.minimum(asked, supply + bandwidth[:, None]) - held - loss[:, None] - FLIGHT_COST * mean * flight
        gain[moved] = -np.inf
        gain[~near] = -np.inf
        uav, to = np.unravel_index(int(gain.argmax()), gain.shape)
        if gain[uav, to] <= LEAST_GAIN * mean:
            break
        supply[here[uav]] -= bandwidth[uav]
        supply[to] += bandwidth[uav]
        stations[uav], moved[uav] = to + 1, True
    return stations


def _way(place: FloatArray, grid: ZoneGrid, zone: int) -> FloatArray:
    """[U] distance to a zone [m]."""
    corner = np.array(grid.corner(zone))
    way: FloatArray = np.hypot(*(np.clip(place, corner, corner + grid.side) - place).T)
    return way


def _neighbours(grid: ZoneGrid, zone: int) -> npt.NDArray[np.bool_]:
    """[Z] which zones touch one, by a side or a corner."""
    row, column = np.divmod(np.arange(len(grid.ids)), grid.columns)
    near: npt.NDArray[np.bool_] = (abs(row - row[zone - 1]) <= 1) & (abs(column - column[zone - 1]) <= 1)
    near[zone - 1] = False
    return near
