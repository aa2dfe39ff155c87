"""What a game is played with: the compiled shape, and the numbers that may differ from game to game."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skyrelay.airspace.maps import map_names
from skyrelay.coordination.energy import Batteries, Charging
from skyrelay.coordination.obstacles import Cities
from skyrelay.core.errors import UsageError

MobilityModel = Literal["manhattan", "random-waypoint", "mixed", "replay"]
Interval = tuple[float, float]


@dataclass(frozen=True)
class Shape:
    """What is fixed when the game is compiled.

    Attributes:
        uavs, vehicles: rows for the largest team and the most vehicles; smaller games leave rows empty.
        n: side of the maps [cells], odd.
        zoom: the full maps have zoom x n cells a side.
        steps: length of an episode.
        mobility: how vehicles move; "mixed" lets each game choose, "replay" takes positions from a trace.
        drop_outs: UAVs may leave for good during a game.
        walls: rows for the walls of buildings, which block the sight from UAVs to vehicles; 0 for open ground.
        energy: UAVs have a charge, spend it, and charge at a point.
        tells_range: the observation tells how far the links reach, which differs from game to game.
        outlook: the observation tells which moves keep the links, and how many own vehicles are covered from nearby.

    An option that is off costs nothing in a compiled step.

    Raises:
        UsageError: a number is out of its range.
    """

    uavs: int
    vehicles: int
    n: int = 11
    zoom: int = 2
    steps: int = 100
    mobility: MobilityModel = "manhattan"
    drop_outs: bool = False
    walls: int = 0
    energy: bool = False
    tells_range: bool = False
    outlook: bool = False

    def __post_init__(self) -> None:
        for name, low, high in (("uavs", 1, 16), ("vehicles", 1, 255), ("steps", 1, 100_000), ("zoom", 2, 3)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise UsageError(f"game.{name}", value, f"a number from {low} to {high}")
        if self.n % 2 == 0 or not 3 <= self.n <= 63:
            raise UsageError("game.n", self.n, "an odd number from 3 to 63")

    @property
    def maps(self) -> tuple[str, ...]:
        """Names of the observation's maps."""
        return map_names(
            obstacles=self.walls > 0, energy=self.energy, tells_range=self.tells_range, outlook=self.outlook
        )


class Parameters(NamedTuple):
    """The numbers of one game. Lengths are in zone sides, probabilities are per vehicle and step.

    Attributes:
        uavs, vehicles: how many there are.
        reach: range of both links.
        uav_step: length of a UAV's move.
        slowest, fastest: between which each vehicle's drive in a step is drawn.
        turn: a vehicle turns (Manhattan).
        halt, go: a moving vehicle halts, a standing one drives on (traffic lights).
        swap: a vehicle leaves, and another appears in its place in the table, elsewhere.
        astray: a vehicle starts anywhere in the zone, not within its UAV's range.
        waypoint: vehicles follow the random-waypoint model ("mixed" games).
        drop_out: a UAV leaves (per UAV and step; games with drop-outs).
        walls: of the buildings (see `skyrelay.airspace.flight.in_sight`); None on open ground.
        charging: in games with energy, else None.
    """

    uavs: Int[Array, ""]
    vehicles: Int[Array, ""]
    reach: Float[Array, ""]
    uav_step: Float[Array, ""]
    slowest: Float[Array, ""]
    fastest: Float[Array, ""]
    turn: Float[Array, ""]
    halt: Float[Array, ""]
    go: Float[Array, ""]
    swap: Float[Array, ""]
    astray: Float[Array, ""]
    waypoint: Bool[Array, ""]
    drop_out: Float[Array, ""]
    walls: Float[Array, "walls 5"] | None = None
    charging: Charging | None = None


@dataclass(frozen=True)
class Domain:
    """The games that parameters are drawn from, each uniform between two bounds (domain randomisation).

    Attributes:
        uavs, vehicles: team sizes and vehicle counts, inclusive.
        ratio: zone side over range.
        uav_step: length of a UAV's move [zone sides]; drawn log-uniformly.
        speed_ratio: the fastest vehicle's speed over the UAV's.
        slow_share: the slowest vehicle's speed over the fastest's.
        turn, halt, go, swap, astray: as in `Parameters`.
        waypoint: share of games with the random-waypoint model, in "mixed" games.
        drop_out: as in `Parameters`, in games with drop-outs.
        cities: what is built; None for open ground.
        batteries: of games with energy; None for those without.
        weighted: small teams come up more often (as one over their size), so that teams of each size make about as many
            decisions, and wide zones (as their ratio, which is uniform in area): there most is left to learn. Else each
            size comes up as often, and each ratio.
    """

    uavs: tuple[int, int]
    vehicles: tuple[int, int]
    ratio: Interval = (2.0, 2.0)
    uav_step: Interval = (0.05, 0.05)
    speed_ratio: Interval = (0.5, 0.5)
    slow_share: float = 0.3
    turn: Interval = (0.5, 0.5)
    halt: Interval = (0.0, 0.0)
    go: Interval = (1.0, 1.0)
    swap: Interval = (0.0, 0.0)
    astray: Interval = (0.0, 0.0)
    waypoint: float = 0.0
    drop_out: Interval = (0.0, 0.0)
    cities: Cities | None = None
    batteries: Batteries | None = None
    weighted: bool = False

    def __post_init__(self) -> None:
        for name in ("uavs", "vehicles"):
            low, high = getattr(self, name)
            if not 1 <= low <= high:
                raise UsageError(f"game.{name}", f"{low}-{high}", "at least 1, the smaller number first")

    @property
    def team_sizes(self) -> npt.NDArray[np.float64]:
        """[sizes] how likely each team size is, from the smallest to the largest."""
        sizes = np.arange(self.uavs[0], self.uavs[1] + 1)
        weights = 1.0 / sizes if self.weighted else np.ones(len(sizes))
        shares: npt.NDArray[np.float64] = weights / weights.sum()
        return shares

    @property
    def mean_uavs(self) -> float:
        """UAVs of a game on average."""
        return float(self.team_sizes @ np.arange(self.uavs[0], self.uavs[1] + 1))

    def draw(self, key: PRNGKeyArray) -> Parameters:
        """The parameters of one game."""
        draws = iter(jax.random.uniform(key, (12,)))

        def between(bounds: Interval) -> Array:
            return jnp.asarray(bounds[0] + (bounds[1] - bounds[0]) * next(draws))

        def count(bounds: tuple[int, int]) -> Array:
            return jnp.minimum(bounds[0] + ((bounds[1] - bounds[0] + 1) * next(draws)).astype(jnp.int32), bounds[1])

        def team() -> Array:
            bounds = jnp.asarray(self.team_sizes.cumsum()[:-1], jnp.float32)
            return self.uavs[0] + jnp.searchsorted(bounds, next(draws), side="right").astype(jnp.int32)

        areas = (self.ratio[0] ** 2, self.ratio[1] ** 2)
        low, high = self.uav_step
        uav_step = low * (high / low) ** between((0.0, 1.0))
        fastest = uav_step * between(self.speed_ratio)
        return Parameters(
            uavs=team(),
            vehicles=count(self.vehicles),
            reach=1.0 / (jnp.sqrt(between(areas)) if self.weighted else between(self.ratio)),
            uav_step=uav_step,
            slowest=fastest * self.slow_share,
            fastest=fastest,
            turn=between(self.turn),
            halt=between(self.halt),
            go=between(self.go),
            swap=between(self.swap),
            astray=between(self.astray),
            waypoint=next(draws) < self.waypoint,
            drop_out=between(self.drop_out),
            walls=self.cities.draw(jax.random.fold_in(key, 1)) if self.cities else None,
            charging=self.batteries.draw(jax.random.fold_in(key, 2)) if self.batteries else None,
        )


def physical(
    uavs: tuple[int, int],
    vehicles: tuple[int, int],
    *,
    zone_side: float = 6000.0,
    reach: float = 3000.0,
    step_seconds: float = 10.0,
    uav_speed: float = 30.0,
    vehicle_speed: Interval = (4.5, 15.0),
    turn: float = 0.5,
) -> Domain:
    """A domain of one setting in metres and seconds; the defaults are the preset ``paper`` (docs/assumptions.md).

    Args:
        uavs, vehicles: between which the numbers are drawn.
        zone_side, reach: [m].
        uav_speed, vehicle_speed: [m/s].
    """
    ratio, uav_step, speed_ratio = zone_side / reach, uav_speed * step_seconds / zone_side, vehicle_speed[1] / uav_speed
    return Domain(
        uavs=uavs,
        vehicles=vehicles,
        ratio=(ratio, ratio),
        uav_step=(uav_step, uav_step),
        speed_ratio=(speed_ratio, speed_ratio),
        slow_share=vehicle_speed[0] / vehicle_speed[1],
        turn=(turn, turn),
    )


def varied(uavs: tuple[int, int] = (2, 8), vehicles: tuple[int, int] = (1, 40)) -> Domain:
    """Games of many scales, speeds and kinds of traffic, with drop-outs: what the generalist policy is trained on."""
    return Domain(
        uavs=uavs,
        vehicles=vehicles,
        ratio=(1.5, 3.0),
        uav_step=(1 / 60, 1 / 8),
        speed_ratio=(0.1, 0.6),
        turn=(0.05, 0.5),
        halt=(0.0, 0.2),
        go=(0.1, 1.0),
        swap=(0.0, 0.02),
        astray=(0.0, 0.5),
        waypoint=0.3,
        drop_out=(0.0, 0.002),
        weighted=True,
    )
