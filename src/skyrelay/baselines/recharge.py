"""The linked centroid rule for games with energy: who is short of charge goes to the charging point first."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skyrelay.airspace.charging import RECHARGE
from skyrelay.airspace.flight import STAY
from skyrelay.baselines.centroid import centroids, linked_towards
from skyrelay.baselines.player import Player, squared, towards
from skyrelay.coordination import game
from skyrelay.core.errors import UsageError

SPARE_STEPS = RECHARGE.spare
"""Of flight that must be left beyond the way to the charging point."""
ENOUGH = RECHARGE.enough / 100.0
"""Charge at which a UAV leaves the charging point."""


class Recharge(Player):
    """Every UAV flies as `Centroid` does, linked, but turns back in time; its memory is who is at it.

    It knows what the maps only hint at: exact positions, and what each step costs.
    """

    def begin(self, key: PRNGKeyArray, state: game.State) -> tuple[game.State, Bool[Array, " uavs"]]:  # noqa: ARG002
        """Nobody is at it.

        Raises:
            UsageError: nothing is ever charged in these games.
        """
        if state.parameters.charging is None:
            raise UsageError("baseline", "recharge", "games with energy (--games energy), or another baseline")
        return state, jnp.zeros(state.shape.uavs, bool)

    def act(self, state: game.State, memory: Bool[Array, " uavs"]) -> tuple[Int[Array, " uavs"], Bool[Array, " uavs"]]:
        """To the charging point, or to the centroid."""
        charging, charge = state.parameters.charging, state.charge
        assert charging is not None and charge is not None  # noqa: S101, PT018 (`begin` has looked)
        away = jnp.sqrt(squared(state.uavs - charging.point))
        way = jnp.maximum(away - charging.radius, 0.0) / state.parameters.uav_step
        short = charge / charging.move < way + SPARE_STEPS
        busy = short | (memory & (charge < ENOUGH))
        point: Float[Array, "uavs 2"] = jnp.broadcast_to(charging.point, state.uavs.shape)
        back = jnp.where(away <= charging.radius, STAY, towards(state, point))
        on = linked_towards(state, jnp.where(busy[:, None], point, centroids(state)))
        return jnp.where(busy, back, on), busy
