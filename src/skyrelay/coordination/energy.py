"""Charge in games with energy: flying takes it, the charging point gives it back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

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


@dataclass(frozen=True)
class Batteries:
    """Games with energy to draw from; the charging point is anywhere in the zone but near its border.

    Attributes:
        hover: what a hovering step costs.
        move: what a moving step costs, over a hovering one's cost.
        gain: what a charging step gives.
        radius: of the charging point [zone sides].
        least: of the charges at the start.

    Raises:
        UsageError: a number is out of its range.
    """

    hover: Interval = (0.004, 0.01)
    move: Interval = (1.0, 1.5)
    gain: Interval = (0.03, 0.1)
    radius: Interval = (0.06, 0.1)
    least: float = 0.2

    def __post_init__(self) -> None:
        for name, least, most in (("hover", 0.0, 1.0), ("move", 1.0, 100.0), ("gain", 0.0, 1.0), ("radius", 0.0, 1.0)):
            low, high = getattr(self, name)
            if not least <= low <= high <= most:
                raise UsageError(f"game.batteries.{name}", f"{low}-{high}", f"two numbers from {least:g} to {most:g}")

    def draw(self, key: PRNGKeyArray) -> Charging:
        """The numbers of one game."""
        draws = jax.random.uniform(key, (6,))

        def between(bounds: Interval, draw: Array) -> Array:
            return bounds[0] + (bounds[1] - bounds[0]) * draw

        hover = between(self.hover, draws[0])
        return Charging(
            hover=hover,
            move=hover * between(self.move, draws[1]),
            gain=between(self.gain, draws[2]),
            point=between((0.1, 0.9), draws[3:5]),
            radius=between(self.radius, draws[5]),
            least=jnp.float32(self.least),
        )


def at_charger(uavs: Float[Array, "uavs 2"], charging: Charging) -> Bool[Array, " uavs"]:
    """Whether each UAV, at [zone sides], is within the charging point's radius."""
    apart = uavs - charging.point
    return jnp.sum(apart * apart, -1) <= charging.radius**2


def spend(
    charge: Float[Array, " uavs"], uavs: Float[Array, "uavs 2"], moved: Bool[Array, " uavs"], charging: Charging
) -> Float[Array, " uavs"]:
    """The charge after a step that ended at ``uavs``: hovering within the charging point's radius fills the battery.

    Args:
        moved: whether the UAV's action was a move.
    """
    charged = ~moved & at_charger(uavs, charging)
    flown = jnp.where(moved, charging.move, charging.hover)
    # Who is on the ground spends nothing.
    change = jnp.where(charged, charging.gain, jnp.where(charge > 0.0, -flown, 0.0))
    return jnp.clip(charge + change, 0.0, 1.0)
