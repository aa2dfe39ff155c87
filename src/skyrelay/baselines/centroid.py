"""The greedy centroid rule: each UAV follows its own vehicles."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from skyrelay.airspace.flight import connectivity, links
from skyrelay.baselines.player import Memory, Player, choices, owned, squared, team_centre, towards
from skyrelay.coordination import game


class Centroid(Player):
    """Every UAV flies towards the centroid of its own vehicles.

    Attributes:
        linked: keep the team connected: while it is not, fly towards the centre of the team; once it is, UAV after UAV
            goes towards its centroid as far as the team stays connected. The team must know its positions for that.
    """

    linked: bool = False

    def act(self, state: game.State, memory: Memory) -> tuple[Int[Array, " uavs"], Memory]:
        """One step towards the centroid."""
        centre = centroids(state)
        return (linked_towards(state, centre) if self.linked else towards(state, centre)), memory


def centroids(state: game.State) -> Float[Array, "uavs 2"]:
    """Mean position of each UAV's vehicles; the UAV's own position where it has none."""
    own = owned(state)[..., None]
    count = own.sum(1)
    mean = jnp.sum(jnp.where(own, state.traffic.position, 0.0), 1) / jnp.maximum(count, 1)
    return jnp.where(count > 0, mean, state.uavs)


def connected(state: game.State, uavs: Float[Array, "*batch uavs 2"]) -> Array:
    """[*batch]: whether a team at these positions is connected."""
    active = jnp.broadcast_to(state.active, uavs.shape[:-1])
    reach = jnp.broadcast_to(state.parameters.reach, uavs.shape[:-2])
    whole: Array = connectivity(links(uavs, reach, active), active)
    return whole


def linked_towards(state: game.State, centre: Float[Array, "uavs 2"]) -> Int[Array, " uavs"]:
    """UAV after UAV goes towards its place as far as the team stays connected; before it is, to the team's centre.

    Args:
        centre: where each would be [zone sides].
    Returns: the action of each UAV.
    """
    goal = jnp.where(connected(state, state.uavs), centre, team_centre(state))
    options = choices(state)

    def turn(places: Float[Array, "uavs 2"], uav: Int[Array, ""]) -> tuple[Float[Array, "uavs 2"], Int[Array, ""]]:
        mine = options[:, uav]
        teams = jnp.broadcast_to(places, options.shape).at[:, uav].set(mine)
        broken = ~connected(state, teams)
        # Two zone sides squared exceed any distance in the zone: a connected choice always wins.
        action = jnp.argmin(squared(mine - goal[uav]) + 4.0 * broken)
        return places.at[uav].set(mine[action]), action

    return jax.lax.scan(turn, state.uavs, jnp.arange(state.shape.uavs))[1]
