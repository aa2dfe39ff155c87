"""What holds for every UAV of an area: where the zones are, how far links and moves reach, what flying costs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skyrelay.airspace.charge import Cost
from skyrelay.airspace.charging import Places, steps_of
from skyrelay.airspace.flight import ACTIONS, move
from skyrelay.airspace.guard import keep_apart
from skyrelay.airspace.network import Network
from skyrelay.airspace.rotor import rated
from skyrelay.airspace.wind import Weather
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.core.resolved import ResolvedScenario, charging_points
from skyrelay.core.scenario import Energy
from skyrelay.core.zones import ZoneGrid

SEPARATION = 30.0
"""What UAVs keep where nothing else is said and the radio is no disc [m]."""
LATE = 1
"""Steps that the way to a charging point may begin late: a host may miss one."""


@dataclass(frozen=True)
class Law:
    """One area's.

    Attributes:
        grid: of its zones.
        reach: range of the UAV-vehicle and the UAV-UAV link [m].
        speed: of a UAV [m/s].
        seconds: a step takes [s].
        energy: what flying costs; the rates are those of its model.
        walls: [W, 5] of the buildings [m], heights over the UAVs' altitude (`in_sight` of
            `skyrelay.airspace.flight`); None on open ground.
        patience: beyond this age a beacon no longer counts [s].
        network: what links carry; by default the paper's disc without gateways.
        separation: least distance that UAVs of a zone keep [m].
        places: where UAVs land to be charged; empty where there are none.
        rotates: whether they go there by one plan, and not each when it must.
        dispatch: whether they go where bandwidth lacks, between two periods.
        period_steps: between two selections.
        weather: the wind; None: still air.
    """

    grid: ZoneGrid
    reach: float
    speed: float
    seconds: float
    energy: Energy
    walls: FloatArray | None
    patience: float
    network: Network = field(default_factory=Network)
    separation: float = 0.0
    places: Places = field(default_factory=Places)
    rotates: bool = False
    dispatch: bool = False
    period_steps: int = 1
    weather: Weather | None = None

    @classmethod
    def of(cls, scenario: ResolvedScenario, grid: ZoneGrid) -> Law:
        """A scenario's."""
        fleet, coordination = scenario.fleet, scenario.coordination
        walls = [
            (*start, *end, building.height / fleet.altitude)
            for building in scenario.obstacles.buildings
            for start, end in zip(building.polygon, building.polygon[1:] + building.polygon[:1], strict=True)
        ]
        sides = np.array(walls, dtype=np.float64) if walls else None
        return cls(
            grid=grid,
            reach=fleet.range,
            speed=fleet.speed,
            seconds=coordination.step_seconds,
            energy=rated(scenario.energy, fleet.speed, scenario.wind.speed),
            walls=sides,
            patience=coordination.patience,
            network=Network.of(scenario, fleet.range, sides),
            separation=_separation(scenario),
            places=Places.of(charging_points(scenario, grid), scenario.energy.battery, coordination.step_seconds),
            rotates=scenario.energy.rotation == "rotate",
            dispatch=coordination.dispatch,
            period_steps=coordination.period_steps,
            weather=Weather.of(scenario.wind, scenario.seed),
        )

    @property
    def stride(self) -> float:
        """Length of a move [m]."""
        return self.speed * self.seconds

    @property
    def cost(self) -> Cost:
        """Of a step [% of the battery]."""
        per_minute = (self.energy.hover_per_minute, self.energy.move_per_minute, self.energy.charge_per_minute)
        return Cost(*(rate * self.seconds / 60.0 for rate in per_minute))

    def flight(self, battery: float) -> float:
        """How far a battery [0-100] still carries a UAV [m]: at the reserve it has to leave."""
        minutes = max(battery - self.energy.reserve, 0.0) / max(self.energy.move_per_minute, 1e-9)
        return minutes * 60.0 / self.seconds * self.stride

    @property
    def worst(self) -> float:
        """The most that a step can take [% of the battery]."""
        return float(max(self.cost.hover, self.cost.move))

    def way_home(self, places: FloatArray) -> tuple[IntArray, FloatArray]:
        """[U] the charging point that UAVs at [U, 2] go to, and the steps of the straight way there."""
        which, away = self.places.nearest(places)
        return which, steps_of(away, self.stride)

    def must_charge(self, battery: float, place: tuple[float, float], spare: float = 0.0) -> bool:
        """Whether a UAV has to set out to its charging point now: after another step, it might come there too low.

        Who heeds this never comes below the reserve: the next step takes at most `worst`, and leads at most a stride
        away.

        Args:
            battery: [%].
            place: where it is [m].
            spare: steps of flight that shall be left beyond.
        """
        _, away = self.places.nearest(np.array([place]))
        back = float(steps_of(away + self.stride, self.stride)[0]) + LATE + spare
        return bool(battery - self.worst - back * self.cost.move < self.energy.reserve)

    def fence(self, zone: int, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Corners [2] of where a UAV at a place [2] may fly: the zone, and what lies between it and the UAV [m]."""
        corner = np.array(self.grid.corner(zone))
        return np.minimum(corner, place), np.maximum(corner + self.grid.side, place)

    def way_in(self, zone: int, place: tuple[float, float]) -> int | None:
        """The action that brings a UAV at a place [m] nearest to its zone; None where it is in it."""
        here, corner = np.array(place), np.array(self.grid.corner(zone))
        if ((corner <= here) & (here <= corner + self.grid.side)).all():
            return None
        inset = min(self.stride, self.grid.side / 2)  # on the border a goal could be nearer than any move ends
        goal = np.clip(here, corner + inset, corner + self.grid.side - inset)
        ends = move(np.tile(here, (ACTIONS, 1)), np.arange(ACTIONS), np.array(self.stride), *self.fence(zone, here))
        return int(np.hypot(*(ends - goal).T).argmin())

    def apart(self, action: int, zone: int, place: tuple[float, float], others: FloatArray) -> int:
        """The action, or where it ends too near to the others [M, 2] the one that ends nearest to it and does not."""
        if not self.separation or not len(others):
            return action
        here = np.array(place)
        ends = move(np.tile(here, (ACTIONS, 1)), np.arange(ACTIONS), np.array(self.stride), *self.fence(zone, here))
        free = keep_apart(ends, here, others, self.separation)
        return action if free[action] else int(np.where(free, np.hypot(*(ends - ends[action]).T), np.inf).argmin())

    def charger(self, zone: int) -> tuple[float, float, float] | None:
        """Where a zone's charging point is and how far it reaches [m]; None where there are none."""
        if self.energy.charge_per_minute <= 0:
            return None
        x, y = self.grid.corner(zone)
        east, north = self.energy.charging_point
        return x + east * self.grid.side, y + north * self.grid.side, self.energy.charging_radius

    def walls_near(self, zone: int) -> FloatArray | None:
        """The walls that can stand between two points of a zone: those whose box meets it."""
        if self.walls is None:
            return None
        corner = np.array(self.grid.corner(zone))
        ends = self.walls[:, :4].reshape(-1, 2, 2)
        near = (ends.max(axis=1) >= corner) & (ends.min(axis=1) <= corner + self.grid.side)
        walls: FloatArray = self.walls[near.all(axis=1)]
        return walls


def _separation(scenario: ResolvedScenario) -> float:
    told = scenario.fleet.separation
    if told is None:
        return 0.0 if scenario.radio.model == "disc" else SEPARATION
    return told
