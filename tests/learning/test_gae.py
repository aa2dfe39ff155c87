"""Advantages against a plain loop over the definition."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.learning.gae import advantages


def plain(rewards, values, next_values, truncated, gamma, decay):
    """The sum of discounted one-step errors, game by game, up to a time limit or the horizon."""
    steps, games = rewards.shape
    result = np.zeros_like(rewards)
    for game in range(games):
        for begin in range(steps):
            weight, total = 1.0, 0.0
            for step in range(begin, steps):
                error = rewards[step, game] + gamma * next_values[step, game] - values[step, game]
                total += weight * error
                weight *= gamma * decay
                if truncated[step, game]:
                    break
            result[begin, game] = total
    return result


@pytest.mark.parametrize(("gamma", "decay"), [(0.99, 0.95), (0.9, 0.0), (1.0, 1.0)])
def test_against_a_plain_loop(gamma, decay):
    random = np.random.default_rng(1)
    rewards, values, next_values = (random.normal(size=(12, 5)) for _ in range(3))
    truncated = random.random((12, 5)) < 0.2
    reward, value, following, cut = map(jnp.asarray, (rewards, values, next_values, truncated))
    result = advantages(reward, value, following, cut, gamma, decay)
    np.testing.assert_allclose(
        result, plain(rewards, values, next_values, truncated, gamma, decay), rtol=1e-4, atol=1e-5
    )


def test_a_time_limit_is_bootstrapped_through():
    # One step before the limit, reward 0, and the cut-off state is worth 10: the advantage must know of it.
    one = jnp.zeros((1, 1))
    result = advantages(one, one, one + 10.0, jnp.ones((1, 1), bool), 0.5, 0.95)
    assert float(result[0, 0]) == pytest.approx(5.0)
