"""Cities for games with obstacles: blocks of houses between straight streets."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from skyrelay.core.errors import UsageError

Interval = tuple[float, float]


@dataclass(frozen=True)
class Cities:
    """Cities to draw from: a grid of lots, on each a rectangular building or none.

    Attributes:
        lots: along each side of the zone.
        built: share of the lots with a building; drawn for each city.
        width: a building's sides over the lot's.
        rise: a building's height over the UAVs' altitude; below 1.

    Raises:
        UsageError: a number is out of its range.
    """

    lots: int = 4
    built: Interval = (0.3, 0.8)
    width: Interval = (0.2, 0.6)
    rise: Interval = (0.1, 0.6)

    def __post_init__(self) -> None:
        if not 1 <= self.lots <= 32:
            raise UsageError("game.cities.lots", self.lots, "a number from 1 to 32")
        for name in ("built", "width", "rise"):
            low, high = getattr(self, name)
            if not 0.0 <= low <= high < 1.0:
                raise UsageError(f"game.cities.{name}", f"{low}-{high}", "two shares below 1, the smaller first")

    @property
    def walls(self) -> int:
        """Rows that a city takes."""
        return 4 * self.lots**2

    def draw(self, key: PRNGKeyArray) -> Float[Array, "walls 5"]:
        """The walls of one city (see `skyrelay.airspace.flight.in_sight`), counter-clockwise around each building."""
        lots = self.lots**2
        draws = jax.random.uniform(key, (6 * lots + 1,))
        share, draws = _between(self.built, draws[0]), draws[1:].reshape(lots, 6)
        size = _between(self.width, draws[:, :2]) / self.lots
        corner = jnp.stack(jnp.divmod(jnp.arange(lots), self.lots), -1) / self.lots
        low = corner + draws[:, 2:4] * (1.0 / self.lots - size)
        rise = jnp.where(draws[:, 4] < share, _between(self.rise, draws[:, 5]), 0.0)
        (x0, y0), (x1, y1) = low.T, (low + size).T
        sides = [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]
        return jnp.concatenate([jnp.stack([*side, rise], -1) for side in sides])


def _between(bounds: Interval, draw: Array) -> Array:
    return bounds[0] + (bounds[1] - bounds[0]) * draw
