"""The team's reward (Eq. 3) and the measures it is made of."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from skyrelay.airspace.flight import connectivity, connectivity_neighbor, coverage, links, of_owner, served, sight_share
from skyrelay.coordination.energy import Charging

POTENTIAL_STEPS = 10.0
POTENTIAL_RANGE = 0.9
"""Share of the range within which the potential sees no cost: better a little before the edge than on it."""
SPARE_STEPS = 5.0
"""Of flight that should be left on arrival at the charging point."""


class Score(NamedTuple):
    """How a team stands at one instant.

    Attributes:
        reward: Eq. 3, in [-2, 0].
        coverage: share of the vehicles inside their own UAV's range.
        connectivity: 1 where a path of links joins every two UAVs, else 0.
        connectivity_neighbor: 1 where each UAV has at least one neighbour, else 0 (the paper's results text).
        missed: of each UAV, the share of all vehicles that are its own and out of its range (or sight).
        credit: of each UAV, what it answers for itself: (connectivity - 1) - missed. Summed over the team, the coverage
            part is Eq. 3's. Where charge counts, those in the air answer for the links between them, one on the ground
            for the cut that it makes.
    """

    reward: Float[Array, ""]
    coverage: Float[Array, ""]
    connectivity: Float[Array, ""]
    connectivity_neighbor: Float[Array, ""]
    missed: Float[Array, " uavs"]
    credit: Float[Array, " uavs"]


def score(
    uavs: Float[Array, "uavs 2"],
    active: Bool[Array, " uavs"],
    vehicles: Float[Array, "vehicles 2"],
    owner: Int[Array, " vehicles"],
    reach: Float[Array, ""],
    walls: Float[Array, "walls 5"] | None = None,
    flying: Bool[Array, " uavs"] | None = None,
) -> Score:
    """Measure a team (arguments as `skyrelay.coordination.observation.observe`).

    Args:
        walls: what blocks the sight between UAVs and vehicles (links between UAVs are above the roofs); None: nothing.
        flying: false for an active UAV on the ground, which serves nobody and has no link; None where all fly.

    Source: Eq. 3, reward = (coverage - 1) + (connectivity - 1), shared by all UAVs of the team.
    """
    graph = links(uavs, reach, active if flying is None else flying)
    covered = coverage(uavs, vehicles, owner, reach, walls, flying)
    outside = (owner >= 0) & ~served(uavs, vehicles, owner, reach, walls, flying)
    own = owner == jnp.arange(uavs.shape[0])[:, None]
    missed = jnp.sum(outside & own, -1) / jnp.maximum(jnp.sum(owner >= 0), 1)
    connected = connectivity(graph, active).astype(covered.dtype)
    neighbored = connectivity_neighbor(graph, active).astype(covered.dtype)
    reward = (covered - 1.0) + (connected - 1.0)
    joined = connected if flying is None else jnp.where(flying, connectivity(graph, flying), 0.0)
    return Score(reward, covered, connected, neighbored, missed, (joined - 1.0) - missed)


def potential(
    uavs: Float[Array, "uavs 2"],
    active: Bool[Array, " uavs"],
    vehicles: Float[Array, "vehicles 2"],
    owner: Int[Array, " vehicles"],
    reach: Float[Array, ""],
    uav_step: Float[Array, ""],
    walls: Float[Array, "walls 5"] | None = None,
) -> Float[Array, " uavs"]:
    """For each UAV, roughly the credit that is already lost: minus the steps until all is in range, times their cost.

    A vehicle out of range or sight costs its share of all vehicles for each step that its UAV needs, straight towards
    it, until it is covered; a team that is cut in two costs 1 for each step that the gap takes to close from both
    sides. As a potential (Ng et al. 1999) it shapes the reward without changing which policy is best: it tells a UAV
    that it is on the way.

    Returns: at most 0; each part is bounded by `POTENTIAL_STEPS` steps.
    """
    rows = jnp.arange(uavs.shape[0])
    away = jnp.sqrt(jnp.sum((uavs[:, None] - vehicles[None]) ** 2, -1))
    near = POTENTIAL_RANGE * reach
    if walls is not None:
        share = sight_share(vehicles, of_owner(uavs, owner), walls)
        near = jnp.minimum(near, jnp.where(share < 1.0, share * away, jnp.inf))
    steps_away = jnp.clip((away - near) / uav_step, 0.0, POTENTIAL_STEPS)
    own = owner[None] == rows[:, None]
    late = jnp.sum(jnp.where(own, steps_away, 0.0), -1) / jnp.maximum(jnp.sum(owner >= 0), 1)

    # The longest hop that cannot be avoided on the way from the first active UAV to any other (minimax path).
    first = jnp.argmax(active)
    hop = jnp.sqrt(jnp.sum((uavs[:, None] - uavs[None]) ** 2, -1))
    hop = jnp.where(active[:, None] & active[None], hop, jnp.inf)
    longest = hop[first]
    for _ in range(uavs.shape[0] - 2):
        longest = jnp.minimum(longest, jnp.min(jnp.maximum(longest[:, None], hop), axis=0))
    gap = jnp.max(jnp.where(active & (rows != first), longest, 0.0)) - POTENTIAL_RANGE * reach
    apart = jnp.clip(gap / (2.0 * uav_step), 0.0, POTENTIAL_STEPS)
    return -(late + apart)


def energy_potential(
    uavs: Float[Array, "uavs 2"], charge: Float[Array, " uavs"], uav_step: Float[Array, ""], charging: Charging
) -> Float[Array, " uavs"]:
    """For each UAV, minus the steps that its charge falls short of the way to the charging point, with some to spare.

    A UAV on the ground cuts the team, which costs 1 a step: so does each step that it is short.

    Returns: at most 0; bounded by `POTENTIAL_STEPS` steps.
    """
    away = jnp.sqrt(jnp.sum((uavs - charging.point) ** 2, -1))
    way = jnp.maximum(away - charging.radius, 0.0) / uav_step + SPARE_STEPS
    return -jnp.clip(way - charge / charging.move, 0.0, POTENTIAL_STEPS)
