"""A fleet in the air: it moves as its UAVs have decided, and every step is measured."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyrelay.airspace import flight as rules
from skyrelay.airspace.charging import straight
from skyrelay.airspace.law import Law
from skyrelay.airspace.wind import progress
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.protocol.messages import Fix
from skyrelay.simulation.world import Fleet

NOBODY = -1


@dataclass(frozen=True)
class Service:
    """What vehicles get at one step: [V] each.

    Attributes:
        covered: inside their own UAV's range, and in its sight where there are buildings; none has a landed UAV.
        carried: over their link to it [kbit/s].
        delivered: of that, what reaches a gateway [kbit/s]: all of it, where the scenario has none.
    """

    covered: npt.NDArray[np.bool_]
    carried: FloatArray
    delivered: FloatArray


@dataclass(frozen=True)
class Measure:
    """One zone, or the whole area (zone 0), at one step.

    Attributes:
        vehicles: that are there and have a UAV.
        covered: of them, those inside their own UAV's range, and in its sight where there are buildings.
        coverage: covered / vehicles; 1 where there is no vehicle.
        connectivity: 1 where a path of links joins the team; over the area, the mean over teams of two or more.
        connectivity_neighbor: 1 where each UAV has another in range; likewise.
        served_mbps: requested bandwidth of the covered vehicles [Mbit/s].
        carried_mbps, delivered_mbps: what they get (`Service`) [Mbit/s].
        battery: mean of the zone's UAVs in the air [%], NaN where none is.
    """

    zone: int
    vehicles: int
    covered: int
    coverage: float
    connectivity: float
    connectivity_neighbor: float
    served_mbps: float
    carried_mbps: float
    delivered_mbps: float
    battery: float


class Flight:
    """A fleet over a period's selection, as an onlooker who sees everything.

    Args:
        law: of the area.
        fleet: moved and drained in place.
        demand: [V] of the run's vehicles [kbit/s].
    """

    def __init__(self, law: Law, fleet: Fleet, demand: IntArray) -> None:
        self.fleet = fleet
        self._law = law
        self._demand = demand
        self.owner: IntArray = np.full(len(demand), NOBODY)
        self.actions = np.zeros(len(fleet.ids), dtype=np.int8)
        self._steps = 0  # flown

    @property
    def selected(self) -> npt.NDArray[np.bool_]:
        """[U] whether a UAV has a vehicle in this period and is still in the air."""
        return np.isin(np.arange(len(self.fleet.ids)), self.owner) & (self.fleet.zone > 0)

    @property
    def point_names(self) -> tuple[str, ...]:
        """Of the charging points, in their order."""
        return self._law.places.names

    @property
    def charging(self) -> tuple[IntArray, IntArray, list[str]]:
        """Rows of the UAVs that are away to be charged, the charging point of each, and what each does there."""
        fleet, places = self.fleet, self._law.places
        if not places:
            nobody = np.empty(0, dtype=np.int64)
            return nobody, nobody, []
        rows = np.flatnonzero(fleet.zone == 0).astype(np.int64)
        points = np.where(fleet.pads.landed[rows], fleet.pads.at[rows], places.nearest(self._positions(rows))[0])
        states = fleet.pads.states(fleet.battery)
        return rows, points, [states[row] for row in rows.tolist()]

    def assign(self, owner: IntArray) -> None:
        """Begin a period: ``owner`` [V] is the row of each vehicle's UAV or -1."""
        self.owner = owner.copy()

    def correct(self, fixes: Mapping[int, Fix]) -> None:
        """Put UAVs, by their rows, where their airframes are."""
        for row, fix in fixes.items():
            if fix.position is not None:
                self.fleet.x[row], self.fleet.y[row] = fix.position
                self.fleet.battery[row] = fix.battery

    def move(self, moves: Mapping[int, int]) -> None:
        """Fly one step: the action of each UAV that moves, by its row; all others hover, or stay where they landed."""
        # A new array: the record of the last step holds on to the old one.
        self.actions = np.full(len(self.fleet.ids), rules.STAY, dtype=np.int8)
        known = rules.ACTIONS + len(self._law.places.names)
        for row, action in moves.items():
            self.actions[row] = action if action < known else rules.STAY
        rows = np.flatnonzero((self.actions > rules.STAY) & (self.actions < rules.ACTIONS) & (self.fleet.zone > 0))
        if len(rows):
            here = self._positions(rows)
            fences = [
                self._law.fence(zone, place) for zone, place in zip(self.fleet.zone[rows].tolist(), here, strict=True)
            ]
            low, high = (np.array(corners) for corners in zip(*fences, strict=True))
            moved = rules.move(here, self.actions[rows], self._law.stride, low, high)
            if self._law.weather is not None:
                wind = self._law.weather.at(self._steps * self._law.seconds)
                moved = (
                    here
                    + (moved - here) * progress(self.actions[rows].astype(np.int64), wind, self._law.speed)[:, None]
                )
            self.fleet.x[rows], self.fleet.y[rows] = moved[:, 0], moved[:, 1]
        rows = np.flatnonzero(self.actions >= rules.ACTIONS)
        if len(rows):
            goals = self._law.places.points[self.actions[rows] - rules.ACTIONS]
            moved = straight(self._positions(rows), goals, self._law.stride)
            self.fleet.x[rows], self.fleet.y[rows] = moved[:, 0], moved[:, 1]
        self._steps += 1
        self.fleet.drain(self._law, self.actions)

    def spent(self) -> IntArray:
        """Rows of the UAVs in the air whose battery is down to the reserve."""
        low = (self.fleet.zone > 0) & (self.fleet.battery <= self._law.energy.reserve)
        return np.flatnonzero(low).astype(np.int64)

    def station(self, zones: Mapping[int, int]) -> None:
        """UAVs, by their rows, fly in these zones from now on; in zone 0 they have landed."""
        for row, zone in zones.items():
            self.fleet.zone[row] = zone

    def retire(self, rows: IntArray) -> None:
        """UAVs land: no zone, no vehicles covered by them."""
        self.fleet.zone[rows] = 0

    def serve(self, x: FloatArray, y: FloatArray) -> Service:
        """What the run's vehicles get where they are: [V] positions [m], NaN if absent."""
        covered = self._covered(x, y)
        demand, available = self._demand.astype(np.float64), self.fleet.bandwidth.astype(np.float64)
        ground, uavs, aloft = np.column_stack([x, y]), self._positions(slice(None)), self.fleet.zone > 0
        network = self._law.network
        carried = network.carried(demand, self.owner, covered, ground, uavs, aloft, available)
        return Service(covered, carried, network.delivered(carried, self.owner, uavs, aloft))

    def _covered(self, x: FloatArray, y: FloatArray) -> npt.NDArray[np.bool_]:
        inside: npt.NDArray[np.bool_] = self._served(x) & (self.fleet.zone[self.owner] > 0)
        rows = np.flatnonzero(inside)
        ground, air = np.column_stack([x[rows], y[rows]]), self._positions(self.owner[rows])
        near = rules.in_range(air, ground, self._law.reach)
        if self._law.walls is not None:
            near &= rules.in_sight(ground, air, self._law.walls)
        inside[rows] = near
        return inside

    def measure(self, x: FloatArray, got: Service, zone_of_owner: IntArray) -> list[Measure]:
        """Every zone with a selected UAV, then the whole area.

        Args:
            x: [V] of the run's vehicles [m], NaN if absent.
            got: what they get there.
            zone_of_owner: [V] zone of each vehicle's UAV when it was selected.
        """
        served = self._served(x)
        measures, teams = [], []
        for zone in np.unique(zone_of_owner[self.owner != NOBODY]).tolist():
            here = zone_of_owner == zone
            team = np.flatnonzero(self.selected & (self.fleet.zone == zone))
            active = np.ones(len(team), dtype=bool)
            graph = rules.links(self._positions(team), self._law.reach, active)
            path = float(rules.connectivity(graph, active)) if len(team) else 0.0
            neighbor = float(rules.connectivity_neighbor(graph, active)) if len(team) else 0.0
            measures.append(self._summary(zone, served & here, got, path, neighbor))
            if np.isin(np.arange(len(self.fleet.ids)), self.owner[here]).sum() > 1:
                teams.append((path, neighbor))
        path, neighbor = np.mean(teams, axis=0).tolist() if teams else (1.0, 1.0)
        return [*measures, self._summary(0, served, got, path, neighbor)]

    def _served(self, x: FloatArray) -> npt.NDArray[np.bool_]:
        there: npt.NDArray[np.bool_] = (self.owner != NOBODY) & np.isfinite(x)
        return there

    def _positions(self, rows: IntArray | slice) -> FloatArray:
        return np.column_stack([self.fleet.x[rows], self.fleet.y[rows]])

    def _summary(self, zone: int, served: npt.NDArray[np.bool_], got: Service, path: float, neighbor: float) -> Measure:
        covered = got.covered & served
        vehicles, inside = int(served.sum()), int(covered.sum())
        air = (self.fleet.zone == zone) if zone else (self.fleet.zone > 0)
        return Measure(
            zone=zone,
            vehicles=vehicles,
            covered=inside,
            coverage=inside / vehicles if vehicles else 1.0,
            connectivity=path,
            connectivity_neighbor=neighbor,
            served_mbps=float(self._demand[covered].sum()) / 1000.0,
            carried_mbps=float(got.carried[served].sum()) / 1000.0,
            delivered_mbps=float(got.delivered[served].sum()) / 1000.0,
            battery=float(self.fleet.battery[air].mean()) if air.any() else math.nan,
        )
