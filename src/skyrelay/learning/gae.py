"""Generalised advantage estimation (Schulman et al. 2016), through time limits."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def advantages(
    rewards: Float[Array, time * batch],
    values: Float[Array, time * batch],
    next_values: Float[Array, time * batch],
    truncated: Bool[Array, time * batch],
    gamma: float,
    decay: float,
) -> Float[Array, time * batch]:
    """A_t = delta_t + gamma lambda A_{t+1}, with delta_t = r_t + gamma V(s_{t+1}) - V(s_t).

    Args:
        rewards: of the transition from s_t to s_{t+1}.
        values: V(s_t).
        next_values: V(s_{t+1}), of the state before a reset: a time limit is no end of the game, so its value counts.
        truncated: whether a time limit follows s_{t+1}; the sum stops there, since what comes next is another game.
        gamma: discount factor.
        decay: lambda (the paper's table calls it a discount).
    """
    deltas = rewards + gamma * next_values - values

    def back(later: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        delta, stop = now
        advantage = delta + gamma * decay * jnp.where(stop, 0.0, later)
        return advantage, advantage

    _, result = jax.lax.scan(back, jnp.zeros_like(deltas[0]), (deltas, truncated), reverse=True)
    return result
