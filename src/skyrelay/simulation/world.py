"""The world of a run: who the vehicles and UAVs are, where the fleet is deployed, what flying costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.cluster.vq import kmeans2

from skyrelay.airspace.charge import Charger, at_charger, spend
from skyrelay.airspace.law import Law
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.core.errors import ScenarioError
from skyrelay.core.resolved import ResolvedScenario, resolve
from skyrelay.core.scenario import Building, Demand, Scenario
from skyrelay.core.scenario import Fleet as FleetConfig
from skyrelay.core.zones import ZoneGrid
from skyrelay.mobility import Tracks, load_tracks, read_streets

SMALLEST_BUILDING = 1.0
"""Of which at least one must be so long or wide [m]: a house in degrees is a thousand times smaller."""


@dataclass(frozen=True)
class Members:
    """What each connected vehicle asks for and offers, in the contract's units; rows as in the run's tracks.

    Attributes:
        demand: [V] [kbit/s].
        payment: [V] [cents per Mbit/s].
        reputation: [V] [0-100], in hundredths.
    """

    demand: IntArray
    payment: IntArray
    reputation: FloatArray


@dataclass
class Fleet:
    """The UAVs, as they are at the present step.

    Attributes:
        ids: [U].
        x, y: [U] position [m].
        zone: [U] zone id; 0 for a UAV that has left.
        bandwidth: [U] [kbit/s].
        battery: [U] [0-100], falling.
        reputation: [U] [0-100], in hundredths.
    """

    ids: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    zone: IntArray
    bandwidth: IntArray
    battery: FloatArray
    reputation: FloatArray

    def copy(self) -> Fleet:
        """The same UAVs, independent of these."""
        return replace(self, x=self.x.copy(), y=self.y.copy(), zone=self.zone.copy(), battery=self.battery.copy())

    def drain(self, law: Law, moved: npt.NDArray[np.bool_]) -> None:
        """Take from every UAV in the air what a step cost it, or charge it; a UAV that has left has landed."""
        at_point = np.zeros(len(self.ids), dtype=bool)
        for zone in np.unique(self.zone[self.zone > 0]).tolist():
            if (charger := law.charger(zone)) is not None:
                near = at_charger(np.column_stack([self.x, self.y]), Charger(np.array(charger[:2]), charger[2]))
                at_point |= (self.zone == zone) & near
        airborne = self.zone > 0
        self.battery = spend(self.battery, moved, airborne, at_point & airborne, law.cost, full=100.0)


@dataclass(frozen=True)
class World:
    """Who is where: all that the seed draws and the trace gives.

    Attributes:
        scenario: in its area.
        law: of the area.
        tracks: of the vehicles.
        members: what the vehicles ask for and offer.
        fleet: as it is deployed; it moves with the run.
        streets: lines for the page, each [P, 2] [m]; none where the scenario names none.
    """

    scenario: ResolvedScenario
    law: Law
    tracks: Tracks
    members: Members
    fleet: Fleet
    streets: tuple[FloatArray, ...] = ()

    @classmethod
    def of(cls, scenario: Scenario) -> World:
        """A scenario's.

        Raises:
            TraceError: the trace cannot be read, or is shorter than the run.
            ScenarioError: no building stands in the area, or the file of streets does not fit.
        """
        tracks = load_tracks(scenario)
        grid = ZoneGrid.over(*tracks.box, scenario.zones.columns, scenario.zones.rows)
        _check_buildings(scenario.obstacles.buildings, tracks.box)
        named = scenario.map.streets
        streets = read_streets(Path(named), tracks.box, tracks.plane) if named else ()
        resolved = resolve(scenario, grid)
        return cls(
            resolved,
            Law.of(resolved, grid),
            tracks,
            draw_members(scenario.demand, scenario.seed, len(tracks.ids)),
            deploy_fleet(scenario.fleet, scenario.seed, tracks, grid),
            tuple(streets),
        )

    def addresses(self, account: Callable[[str], str]) -> dict[str, str]:
        """Every member's, by its name."""
        return {name: account(name) for name in (*self.tracks.ids, *self.fleet.ids)}

    def reputations(self, account: Callable[[str], str]) -> dict[str, float]:
        """Every member's [0-100], by its address."""
        values = (*self.members.reputation.tolist(), *self.fleet.reputation.tolist())
        return dict(zip(self.addresses(account).values(), values, strict=True))


def _check_buildings(buildings: Sequence[Building], box: tuple[float, float, float, float]) -> None:
    """That some stand in the area; in degrees or another projection all of a city's are a speck, or elsewhere.

    Args:
        box: the area's smallest x and y, largest x and y [m].
    Raises:
        ScenarioError: none does.
    """
    if not buildings:
        return
    corners = [np.array(building.polygon) for building in buildings]
    low = np.array([ring.min(axis=0) for ring in corners])
    high = np.array([ring.max(axis=0) for ring in corners])
    inside = (high >= box[:2]).all(axis=1) & (low <= box[2:]).all(axis=1)
    if (inside & (np.ptp([low, high], axis=0).max(axis=1) >= SMALLEST_BUILDING)).any():
        return
    (x0, y0), (x1, y1) = low.min(axis=0), high.max(axis=0)
    raise ScenarioError(
        "obstacles.buildings",
        f"{len(buildings)} at x {x0:g} to {x1:g}, y {y0:g} to {y1:g}",
        f"buildings of at least {SMALLEST_BUILDING:g} m in the run's area, x {box[0]:g} to {box[2]:g} m and "
        f"y {box[1]:g} to {box[3]:g} m (degrees have to be projected to these metres)",
    )


def draw_members(config: Demand, seed: int, count: int) -> Members:
    """Attributes of ``count`` vehicles, uniform as in Table "Simulation Setup"."""
    random = np.random.default_rng([seed, 2])
    return Members(
        demand=_uniform(random, config.bandwidth, 1000, count),
        payment=_uniform(random, config.payment, 1, count),
        reputation=_uniform(random, config.reputation, 100, count) / 100.0,
    )


def deploy_fleet(config: FleetConfig, seed: int, tracks: Tracks, grid: ZoneGrid) -> Fleet:
    """A fleet over the first step's traffic: each zone has its share of the UAVs, at the centres of its clusters.

    The paper leaves the first positions open ("each UAV hovers at the same location prior to the selection"); clusters
    of the traffic are what an operator would choose without knowing who will select whom (docs/assumptions.md).
    """
    random = np.random.default_rng([seed, 3])
    x, y = tracks.x[0], tracks.y[0]
    there = np.isfinite(x)
    points = np.column_stack([x[there], y[there]])
    zones = grid.zone_of(points[:, 0], points[:, 1])
    counts = np.array([(zones == zone).sum() for zone in grid.ids])
    zone = np.repeat(np.array(grid.ids), _apportion(counts, config.uavs))
    position = np.empty((config.uavs, 2))
    for number in grid.ids:
        rows = np.flatnonzero(zone == number)
        position[rows] = _stations(points[zones == number], grid, number, len(rows), random)
    width = len(str(config.uavs))
    return Fleet(
        ids=tuple(f"u{number:0{width}d}" for number in range(1, config.uavs + 1)),
        x=position[:, 0].copy(),
        y=position[:, 1].copy(),
        zone=zone.astype(np.int64),
        bandwidth=_uniform(random, config.bandwidth, 1000, config.uavs),
        battery=_uniform(random, config.battery, 100, config.uavs) / 100.0,
        reputation=_uniform(random, config.reputation, 100, config.uavs) / 100.0,
    )


def _uniform(random: np.random.Generator, bounds: tuple[float, float], scale: int, count: int) -> IntArray:
    """Integers in the contract's units, uniform between ``bounds`` (in the scenario's units)."""
    return np.rint(random.uniform(bounds[0] * scale, bounds[1] * scale, count)).astype(np.int64)


def _apportion(counts: IntArray, seats: int) -> IntArray:
    """``seats`` by largest remainder over ``counts``; every zone gets one first where there are enough for that."""
    first = np.ones_like(counts) if seats >= len(counts) else np.zeros_like(counts)
    weights = counts if counts.sum() else np.ones_like(counts)
    quota = weights / weights.sum() * (seats - first.sum())
    result: IntArray = first + np.floor(quota).astype(np.int64)
    remainder = np.argsort(-(quota - np.floor(quota)), kind="stable")
    result[remainder[: seats - result.sum()]] += 1
    return result


def _stations(points: FloatArray, grid: ZoneGrid, zone: int, count: int, random: np.random.Generator) -> FloatArray:
    """``count`` positions [count, 2] in a zone: the centres of its vehicles' clusters, then random ones."""
    corner = np.array(grid.corner(zone))
    stations = random.uniform(corner, corner + grid.side, (count, 2))
    distinct = np.unique(points, axis=0)
    clusters = min(count, len(distinct))
    if clusters:
        centres, _ = kmeans2(distinct, clusters, minit="++", rng=random)
        stations[:clusters] = centres
    return np.clip(stations, corner, corner + grid.side)
