"""What the vehicles of a game have over a radio and by way of gateways: the run's laws, compiled.

A function of a state beside the game: who does not ask for it pays nothing. `jax.vmap` takes many games. No training
here asks: it is for rewards of one's own, and `benchmarks/radio.py` says what it costs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from skyrelay.airspace import service
from skyrelay.airspace.flight import in_sight, links, of_owner, served
from skyrelay.airspace.network import Network
from skyrelay.coordination.game import State

_once: Callable[[Any], Any] = jax.lax.optimization_barrier
"""What goes through it is worked out before what goes on from there."""


def serve(
    state: State,
    network: Network,
    side: float,
    demand: Float[Array, " vehicles"],
    available: Float[Array, " uavs"],
) -> tuple[Float[Array, " vehicles"], Float[Array, ""]]:
    """What vehicles have: carried for each, and at most so much delivered in all [kbit/s].

    `delivered_bound` stands for the flow, which does not vectorise. The reach is the game's.

    Args:
        network: of the zone; its gateways' places are metres from the zone's corner. Walls are the game's.
        side: of the zone [m].
        demand: of each vehicle [kbit/s].
        available: each UAV's bandwidth [kbit/s].
    """
    parameters, vehicles = state.parameters, state.traffic.position
    owner, flying, air = state.served_by, state.flying, network.air
    uavs, ground = side * state.uavs, side * vehicles
    if air is None:
        covered = served(state.uavs, vehicles, owner, parameters.reach, parameters.walls, flying)
        carried = service.in_disc(demand, owner, covered, available)
    else:
        aloft = (owner >= 0) & jnp.take(flying, jnp.maximum(owner, 0))
        held = jnp.where(aloft, owner, -1)
        rows = jnp.arange(state.uavs.shape[0])
        sending = jnp.any(held[None] == rows[:, None], axis=-1)
        seen = None
        if parameters.walls is not None:
            seen = in_sight(vehicles, of_owner(state.uavs, owner), parameters.walls[None])
        # Kept apart: the compiler would work a link's loss out again for each sum that it goes into.
        received = _once(air.received(uavs, ground, held[None] == rows[:, None], seen))
        efficiency = _once(air.of_received(received, held, rows % air.radio.channels, sending))
        carried = service.carried(demand, held, efficiency, air.radio.bandwidth * 1e6, available)
    carried = _once(carried)
    if not network.gateways:
        return carried, jnp.sum(carried)
    graph = links(state.uavs, parameters.reach, flying) & ~jnp.eye(uavs.shape[0], dtype=bool)
    # What is wide enough for all of it: sums of the largest number would be inexact.
    wide = jnp.sum(carried)
    apart = _distance(uavs[:, None], uavs[None])
    rate = wide if air is None else jnp.minimum(air.backhaul(apart, None), wide)
    places = jnp.asarray([(gateway.x, gateway.y) for gateway in network.gateways])
    away = _distance(uavs[:, None], places[None])
    down = jnp.full(away.shape, wide)
    if air is not None:
        each = [air.backhaul(away[:, column], gateway.height) for column, gateway in enumerate(network.gateways)]
        down = jnp.stack(each, axis=-1)
    ways = jnp.where((away <= side * parameters.reach) & flying[:, None], down, 0.0)
    capacity = jnp.asarray([gateway.capacity * 1000.0 for gateway in network.gateways])
    brought = service.of_uavs(carried, owner, uavs.shape[0])
    between, ways = _once((jnp.where(graph, rate, 0.0), ways))
    return carried, service.delivered_bound(brought, between, ways, capacity)


def _distance(one: Array, other: Array) -> Array:
    away = one - other
    return jnp.sqrt(jnp.sum(away * away, axis=-1))
