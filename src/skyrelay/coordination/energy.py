"""Games with energy: what their batteries and charging points are; the law is `skyrelay.airspace.charge`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from skyrelay.airspace.charge import Charger, Cost
from skyrelay.airspace.rotor import Rotor
from skyrelay.core.errors import UsageError

Interval = tuple[float, float]


class Charging(NamedTuple):
    """The numbers of one game. Charge is a share of a full battery.

    Attributes:
        hover, move: what a step costs.
        gain: what a step at the charging point gives.
        point: where it is [zone sides].
        radius: within which a UAV that hovers is charged [zone sides].
        least: a UAV starts with a charge drawn uniformly from here to 1.
    """

    hover: Float[Array, ""]
    move: Float[Array, ""]
    gain: Float[Array, ""]
    point: Float[Array, " 2"]
    radius: Float[Array, ""]
    least: Float[Array, ""]

    @property
    def charger(self) -> Charger:
        """The charging point."""
        return Charger(self.point, self.radius)

    @property
    def cost(self) -> Cost:
        """Of a step."""
        return Cost(self.hover, self.move, self.gain)


@dataclass(frozen=True)
class Batteries:
    """Games with energy to draw from; the charging point is anywhere in the zone but near its border.

    Attributes:
        hover: what a hovering step costs.
        move: what a moving step costs, over a hovering one's cost; of no account with ``speeds``.
        gain: what a charging step gives.
        radius: of the charging point [zone sides].
        least: of the charges at the start.
        speeds: of a rotary-wing UAV [m/s], whose power in flight, over that in hover, is what a move costs more or less
            (`skyrelay.airspace.rotor`); None: the cost is drawn from ``move``.

    Raises:
        UsageError: a number is out of its range.
    """

    hover: Interval = (0.004, 0.01)
    move: Interval = (1.0, 1.5)
    gain: Interval = (0.03, 0.1)
    radius: Interval = (0.06, 0.1)
    least: float = 0.2
    speeds: Interval | None = None

    def __post_init__(self) -> None:
        for name, least, most in (("hover", 0.0, 1.0), ("move", 1.0, 100.0), ("gain", 0.0, 1.0), ("radius", 0.0, 1.0)):
            low, high = getattr(self, name)
            if not least <= low <= high <= most:
                raise UsageError(f"game.batteries.{name}", f"{low}-{high}", f"two numbers from {least:g} to {most:g}")
        if self.speeds is not None and not 0.0 < self.speeds[0] <= self.speeds[1] <= 100.0:
            low, high = self.speeds
            raise UsageError("game.batteries.speeds", f"{low}-{high}", "two numbers above 0 and up to 100")

    def draw(self, key: PRNGKeyArray) -> Charging:
        """The numbers of one game."""
        draws = jax.random.uniform(key, (6,))

        def between(bounds: Interval, draw: Array) -> Array:
            return bounds[0] + (bounds[1] - bounds[0]) * draw

        hover = between(self.hover, draws[0])
        ratio = between(self.move if self.speeds is None else self.speeds, draws[1])
        if self.speeds is not None:
            rotor = Rotor()
            ratio = rotor.power(ratio) / rotor.power(jnp.zeros(()))
        return Charging(
            hover=hover,
            move=hover * ratio,
            gain=between(self.gain, draws[2]),
            point=between((0.1, 0.9), draws[3:5]),
            radius=between(self.radius, draws[5]),
            least=jnp.float32(self.least),
        )
