"""The selected UAVs in the air: each zone's team decides and moves at once, and every step is measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyrelay.core import flight as rules
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.core.scenario import Scenario
from skyrelay.core.zones import ZoneGrid
from skyrelay.policy import Policy, observe_team
from skyrelay.simulation.world import Fleet, charging_point, walls_of

NOBODY = -1


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
    """

    zone: int
    vehicles: int
    covered: int
    coverage: float
    connectivity: float
    connectivity_neighbor: float
    served_mbps: float


class Flight:
    """A fleet over a period's selection.

    Args:
        scenario: resolved (`fleet.range` is a number).
        fleet: moved and drained in place.
        grid: of the zones.
        demand: [V] of the run's vehicles [kbit/s].
    """

    def __init__(self, scenario: Scenario, fleet: Fleet, grid: ZoneGrid, demand: IntArray) -> None:
        if scenario.fleet.range is None:
            raise TypeError("a resolved scenario has a range")
        self.fleet = fleet
        self._range = scenario.fleet.range
        self._stride = scenario.fleet.speed * scenario.coordination.step_seconds
        self._seconds = scenario.coordination.step_seconds
        self._energy = scenario.energy
        self._walls = walls_of(scenario)
        self._grid = grid
        self._demand = demand
        self._policies: Mapping[int, Policy] = {}
        self.owner: IntArray = np.full(len(demand), NOBODY)
        self.actions = np.zeros(len(fleet.ids), dtype=np.int8)

    @property
    def selected(self) -> npt.NDArray[np.bool_]:
        """[U] whether a UAV has a vehicle in this period and is still in the air."""
        return np.isin(np.arange(len(self.fleet.ids)), self.owner) & (self.fleet.zone > 0)

    def assign(self, owner: IntArray, policies: Mapping[int, Policy]) -> None:
        """Begin a period: ``owner`` [V] is the row of each vehicle's UAV or -1; a zone without a policy hovers."""
        self.owner = owner.copy()
        self._policies = policies

    def step(self, x: FloatArray, y: FloatArray) -> None:
        """Every selected UAV decides on what it sees (vehicles at ``x``, ``y`` [V], NaN if absent) and moves."""
        # A new array: the record of the last step holds on to the old one.
        self.actions = np.full(len(self.fleet.ids), rules.STAY, dtype=np.int8)
        zones_of: dict[Policy, list[int]] = {}
        for zone, policy in self._policies.items():
            zones_of.setdefault(policy, []).append(zone)
        for policy, zones in zones_of.items():
            teams = [np.flatnonzero(self.selected & (self.fleet.zone == zone)) for zone in zones]
            observations = [self._observe(policy, zone, team, x, y) for zone, team in zip(zones, teams, strict=True)]
            self.actions[np.concatenate(teams)] = policy.decide(np.concatenate(observations))
            for zone, team in zip(zones, teams, strict=True):
                self._move(zone, team)
        self.fleet.drain(self._energy, self.actions != rules.STAY, self._seconds, self._grid)

    def spent(self) -> IntArray:
        """Rows of the UAVs in the air whose battery is down to the reserve."""
        low = (self.fleet.zone > 0) & (self.fleet.battery <= self._energy.reserve)
        return np.flatnonzero(low).astype(np.int64)

    def retire(self, rows: IntArray) -> None:
        """UAVs land: no zone, no vehicles covered by them."""
        self.fleet.zone[rows] = 0

    def covered(self, x: FloatArray, y: FloatArray) -> npt.NDArray[np.bool_]:
        """[V] whether each vehicle is inside its own UAV's range and in its sight; a landed UAV covers nobody."""
        has_uav = self._served(x) & (self.fleet.zone[self.owner] > 0)
        apart = np.hypot(x - self.fleet.x[self.owner], y - self.fleet.y[self.owner])
        inside: npt.NDArray[np.bool_] = has_uav & (np.nan_to_num(apart, nan=np.inf) <= self._range)
        if self._walls is not None:
            rows = np.flatnonzero(inside)
            ground = np.column_stack([x[rows], y[rows]])
            inside[rows] = rules.in_sight(ground, self._positions(self.owner[rows]), self._walls)
        return inside

    def measure(self, x: FloatArray, y: FloatArray, zone_of_owner: IntArray) -> list[Measure]:
        """Every zone with a selected UAV, then the whole area.

        Args:
            x, y: [V] position of the run's vehicles [m], NaN if absent.
            zone_of_owner: [V] zone of each vehicle's UAV when it was selected.
        """
        served, covered = self._served(x), self.covered(x, y)
        measures, teams = [], []
        for zone in np.unique(zone_of_owner[self.owner != NOBODY]).tolist():
            here = zone_of_owner == zone
            team = np.flatnonzero(self.selected & (self.fleet.zone == zone))
            active = np.ones(len(team), dtype=bool)
            graph = rules.links(self._positions(team), self._range, active)
            path = float(rules.connectivity(graph, active)) if len(team) else 0.0
            neighbor = float(rules.connectivity_neighbor(graph, active)) if len(team) else 0.0
            measures.append(self._summary(zone, served & here, covered & here, path, neighbor))
            if np.isin(np.arange(len(self.fleet.ids)), self.owner[here]).sum() > 1:
                teams.append((path, neighbor))
        path, neighbor = np.mean(teams, axis=0).tolist() if teams else (1.0, 1.0)
        return [*measures, self._summary(0, served, covered, path, neighbor)]

    def _served(self, x: FloatArray) -> npt.NDArray[np.bool_]:
        there: npt.NDArray[np.bool_] = (self.owner != NOBODY) & np.isfinite(x)
        return there

    def _positions(self, rows: IntArray) -> FloatArray:
        return np.column_stack([self.fleet.x[rows], self.fleet.y[rows]])

    def _summary(
        self, zone: int, served: npt.NDArray[np.bool_], covered: npt.NDArray[np.bool_], path: float, neighbor: float
    ) -> Measure:
        vehicles, inside = int(served.sum()), int(covered.sum())
        share = inside / vehicles if vehicles else 1.0
        return Measure(zone, vehicles, inside, share, path, neighbor, float(self._demand[covered].sum()) / 1000.0)

    def _observe(
        self, policy: Policy, zone: int, team: IntArray, x: FloatArray, y: FloatArray
    ) -> npt.NDArray[np.float32]:
        """[len(team), maps, n, n]: what the team's UAVs see."""
        row_in_team = np.full(len(self.fleet.ids) + 1, NOBODY)  # the last one stands for nobody
        row_in_team[team] = np.arange(len(team))
        energy = self._energy
        charger = (*charging_point(energy, self._grid, zone), energy.charging_radius)
        left = (self.fleet.battery[team] - energy.reserve).clip(0.0)  # at the reserve it has to leave
        minutes = left / max(energy.move_per_minute, 1e-9)
        return observe_team(
            self._positions(team),
            np.column_stack([x, y]),
            row_in_team[self.owner],
            self._grid.corner(zone),
            self._grid.side,
            self._range,
            n=policy.card.n,
            zoom=policy.card.zoom,
            names=policy.card.maps,
            walls=self._walls_near(zone),
            charger=charger if energy.charge_per_minute > 0 else None,
            flight=minutes * 60.0 / self._seconds * self._stride,
            step=self._stride,
        )

    def _walls_near(self, zone: int) -> FloatArray | None:
        """The walls that can stand between two points of a zone: those whose box meets it."""
        if self._walls is None:
            return None
        corner = np.array(self._grid.corner(zone))
        ends = self._walls[:, :4].reshape(-1, 2, 2)
        near = (ends.max(axis=1) >= corner) & (ends.min(axis=1) <= corner + self._grid.side)
        walls: FloatArray = self._walls[near.all(axis=1)]
        return walls

    def _move(self, zone: int, team: IntArray) -> None:
        corner = np.array(self._grid.corner(zone))
        moved = rules.move(self._positions(team), self.actions[team], self._stride, corner, corner + self._grid.side)
        self.fleet.x[team], self.fleet.y[team] = moved[:, 0], moved[:, 1]
