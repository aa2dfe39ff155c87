"""How the game's UAVs and vehicles move, in units of the zone's side.

UAVs: `skyrelay.airspace.flight.move` (9 actions at constant speed). Vehicles: two models, compiled inside the step, and
the replay of a trace.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from skyrelay.airspace.flight import move as move


class Traffic(NamedTuple):
    """Vehicles between two steps.

    Attributes:
        position: of each vehicle [zone sides].
        heading: 0..3, east, north, west, south (Manhattan).
        target: where each vehicle drives to [zone sides] (random waypoint).
        stride: what each vehicle drives in a step [zone sides].
        halted: whether it stands.
    """

    position: Float[Array, "vehicles 2"]
    heading: Int[Array, " vehicles"]
    target: Float[Array, "vehicles 2"]
    stride: Float[Array, " vehicles"]
    halted: Bool[Array, " vehicles"]


def fractions(bits: UInt32[Array, " vehicles"]) -> tuple[Float[Array, " vehicles"], Float[Array, " vehicles"]]:
    """Two independent uniform numbers in [0, 1) from each 32 random bits (16 bits each)."""
    return (bits >> 16).astype(jnp.float32) / 65536.0, (bits & 0xFFFF).astype(jnp.float32) / 65536.0


def mirrored(position: Float[Array, "vehicles 2"]) -> Float[Array, "vehicles 2"]:
    """Positions outside the zone, mirrored at its border; none gets further from any point of the zone."""
    return jnp.clip(1.0 - jnp.abs(1.0 - jnp.abs(position)), 0.0, 1.0)


def halting(
    draw: Float[Array, " vehicles"], halted: Bool[Array, " vehicles"], halt: Array, go: Array
) -> Bool[Array, " vehicles"]:
    """Whether each vehicle stands in this step: a moving one halts with probability ``halt``, a standing one goes with
    ``go``.
    """
    return jnp.where(halted, draw >= go, draw < halt)


def manhattan(
    draw: Float[Array, " vehicles"], traffic: Traffic, turn: Array, halted: Bool[Array, " vehicles"]
) -> Traffic:
    """Drive along the axes; turn left or right with probability ``turn`` a step; turn back at the border."""
    turns = jnp.where(draw < 0.5 * turn, 1, jnp.where(draw < turn, 3, 0))
    heading = (traffic.heading + jnp.where(halted, 0, turns)) % 4
    ahead = jnp.stack([(heading == 0) * 1.0 - (heading == 2), (heading == 1) * 1.0 - (heading == 3)], -1)
    position = traffic.position + ahead * jnp.where(halted, 0.0, traffic.stride)[:, None]
    outside = jnp.any((position < 0.0) | (position > 1.0), -1)
    heading = jnp.where(outside, (heading + 2) % 4, heading)
    return traffic._replace(position=mirrored(position), heading=heading, halted=halted)


def random_waypoint(draws: Float[Array, "vehicles 2"], traffic: Traffic, halted: Bool[Array, " vehicles"]) -> Traffic:
    """Drive straight to a target, then choose another, uniform in the zone."""
    way = traffic.target - traffic.position
    distance = jnp.sqrt(jnp.sum(way * way, -1))
    reach = jnp.where(halted, 0.0, traffic.stride)
    arrived = distance <= reach
    step = way * (reach / jnp.maximum(distance, 1e-9))[:, None]
    position = jnp.where(arrived[:, None], traffic.target, traffic.position + step)
    target = jnp.where(arrived[:, None], draws, traffic.target)
    return traffic._replace(position=position, target=target, halted=halted)
