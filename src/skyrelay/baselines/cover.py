"""A rule for each UAV alone, from exact positions: cover more of the own vehicles without losing the team.

The team stays linked without a word (`skyrelay.airspace.guard`).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from skyrelay.airspace.guard import too_far
from skyrelay.baselines.centroid import centroids
from skyrelay.baselines.player import Memory, Player, choices, owned, squared
from skyrelay.coordination import game

DIRECTIONS = 8
RADII = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5)
"""Where a UAV considers to go, about where it is [ranges]."""
EDGE = 0.2
"""Steps over which a vehicle at the edge of the range counts less and less: it may be gone on arrival."""
FLIGHT_COST = 0.02
"""Vehicles that a place must cover more for each step that it is farther away."""
CENTRE_COST = 0.05
"""Likewise for each step that it is farther from the centroid of the UAV's vehicles: there they stay longest."""
GAP_COST = 100.0
"""Likewise for each step that it is too far for a link: a link outweighs all vehicles."""


class Cover(Player):
    """Every UAV flies to the place where it would cover most of its own vehicles, of those that its links allow."""

    def act(self, state: game.State, memory: Memory) -> tuple[Int[Array, " uavs"], Memory]:
        """One step towards the best place, as far as the links hold."""
        uavs, vehicles = state.uavs, state.traffic.position
        reach, step = state.parameters.reach, state.parameters.uav_step

        def gap(places: Float[Array, "places uavs 2"]) -> Float[Array, "places uavs"]:
            """Steps to where every link holds."""
            steps: Float[Array, "places uavs"] = too_far(places, uavs, state.flying, reach) / step
            return steps

        places = jnp.clip(uavs + reach * _about()[:, None], 0.0, 1.0)
        inside = jax.nn.sigmoid((reach - _length(places[:, :, None] - vehicles)) / (EDGE * step))
        covered = jnp.sum(jnp.where(owned(state), inside, 0.0), axis=-1)
        flight, off_centre = _length(places - uavs) / step, _length(places - centroids(state)) / step
        worth = covered - FLIGHT_COST * flight - CENTRE_COST * off_centre - GAP_COST * gap(places)
        best = jnp.take_along_axis(places, jnp.argmax(worth, axis=0)[None, :, None], axis=0)[0]

        options = choices(state)
        return jnp.argmin(_length(options - best) / step + GAP_COST * gap(options), axis=0), memory


def _about() -> Float[Array, "places 2"]:
    """The places that a UAV considers, seen from where it is [ranges]; the first is where it is."""
    angles = 2.0 * jnp.pi * jnp.arange(DIRECTIONS) / DIRECTIONS
    circle = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
    return jnp.concatenate([jnp.zeros((1, 2)), *(radius * circle for radius in RADII)])


def _length(vectors: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    return jnp.sqrt(squared(vectors))
