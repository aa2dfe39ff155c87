"""The world of a run: who the vehicles and UAVs are, where the fleet is deployed, what flying costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.cluster.vq import kmeans2

from skyrelay.airspace.charge import Charger, at_charger, spend
from skyrelay.airspace.charging import Pads, Places
from skyrelay.airspace.flight import STAY
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
        battery: [U] [0-100].
        reputation: [U] [0-100], in hundredths.
        pads: who has landed at which charging place.
    """

    ids: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    zone: IntArray
    bandwidth: IntArray
    battery: FloatArray
    reputation: FloatArray
    pads: Pads = field(default_factory=lambda: Pads(Places(), 0))

    def copy(self) -> Fleet:
        """The same UAVs, independent of these."""
        own = {name: getattr(self, name).copy() for name in ("x", "y", "zone", "battery", "pads")}
        return replace(self, **own)

    @property
    def spent(self) -> npt.NDArray[np.bool_]:
        """[U] whether a UAV has left for good; where there are charging places, it never came to one."""
        gone: npt.NDArray[np.bool_] = self.zone == 0
        return gone & ~self.pads.landed & (self.battery <= 0.0) if self.pads.places else gone

    def drain(self, law: Law, actions: npt.NDArray[Any]) -> None:
        """Take from every UAV in the air what a step cost it, or charge it; a UAV that has left has landed.

        Args:
            actions: [U] that led to where it is; who stays at its charging point spends nothing.
        """
        moved: npt.NDArray[np.bool_] = actions != STAY
        if self.pads.places:
            was = self.pads.landed
            self.pads.land(actions, self.x, self.y, self.zone)
            stays = was & self.pads.landed
            airborne = ((self.zone > 0) | self.pads.under_way | (self.pads.landed & ~was)) & ~stays
            self.battery = spend(self.battery, moved, airborne, np.zeros_like(airborne), law.cost, full=100.0)
            self.battery = np.minimum(self.battery + np.where(stays, self.pads.charge(self.battery), 0.0), 100.0)
            return
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
            ScenarioError: no building stands in the area, the file of streets does not fit, or a charging point is
                out of a battery's reach.
        """
        tracks = load_tracks(scenario)
        grid = ZoneGrid.over(*tracks.box, scenario.zones.columns, scenario.zones.rows)
        _check_buildings(scenario.obstacles.buildings, tracks.box)
        named = scenario.map.streets
        streets = read_streets(Path(named), tracks.box, tracks.plane) if named else ()
        resolved = resolve(scenario, grid)
        law, fleet = Law.of(resolved, grid), deploy_fleet(scenario.fleet, scenario.seed, tracks, grid)
        if law.places:
            _check_charging(law, fleet)
            fleet.pads = Pads(law.places, len(fleet.ids))
        members = draw_members(scenario.demand, scenario.seed, len(tracks.ids))
        return cls(resolved, law, tracks, members, fleet, tuple(streets))

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


def _check_charging(law: Law, fleet: Fleet) -> None:
    """That every charging point is in the area, and that batteries last for the way to one.

    Raises:
        ScenarioError: one is not, a full battery does not last for the longest way and a period, or a UAV's present
            one not for its own way.
    """
    grid, places, reserve = law.grid, law.places, law.energy.reserve
    far = np.array([grid.x0 + grid.columns * grid.side, grid.y0 + grid.rows * grid.side])
    outside = (places.points < (grid.x0, grid.y0)).any(axis=1) | (places.points > far).any(axis=1)
    if outside.any():
        name, (x, y) = places.names[int(outside.argmax())], places.points[outside.argmax()]
        raise ScenarioError(
            "charging",
            f"{name!r} at x {x:g}, y {y:g}",
            f"points in the run's area, x {grid.x0:g} to {far[0]:g} m and y {grid.y0:g} to {far[1]:g} m",
        )
    corners = np.array([grid.corner(zone) for zone in grid.ids])
    ends = np.concatenate([corners + grid.side * np.array(offset) for offset in ((0, 0), (1, 0), (0, 1), (1, 1))])
    way = float(law.way_home(ends)[1].max())
    least = reserve + 2 * way * law.cost.move + law.period_steps * law.worst
    if not least < 100.0:
        raise ScenarioError(
            "charging",
            f"{least:.0f} % of a battery for the longest way there and back, a period and the reserve",
            "charging points that are nearer, a larger energy.battery or shorter periods",
        )
    place = np.column_stack([fleet.x, fleet.y])
    needed = law.way_home(place)[1] * law.cost.move + reserve
    if (fleet.battery < needed).any():
        row = int((fleet.battery - needed).argmin())
        raise ScenarioError(
            "fleet.battery",
            f"{fleet.battery[row]:.1f} % of {fleet.ids[row]}",
            f"at least the {needed[row]:.1f} % that its way to a charging point takes, the reserve included",
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
