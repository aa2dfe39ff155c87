"""A learner of your own on the compiled game: policy gradients for one layer of weights, in forty lines of JAX.

pip install ".[train]"
python examples/own_jax_loop.py
"""

from __future__ import annotations

import argparse
from typing import Any

import jax
import jax.numpy as jnp
import optax

from skyrelay.airspace.maps import OUTLOOK_MAPS, normalise
from skyrelay.coordination import game
from skyrelay.coordination.settings import Shape, physical

GAMES = 64
SHAPE = Shape(uavs=3, vehicles=10, n=9, steps=40, outlook=True)
DOMAIN = physical((3, 3), (10, 10))
SAFE = SHAPE.maps.index(OUTLOOK_MAPS[0])


def look(state: game.State) -> tuple[jax.Array, jax.Array]:
    """[uavs, inputs] what each UAV sees, and [uavs, 9] which of its moves break no link."""
    maps = normalise(game.observe(state).astype(jnp.float32), SHAPE.zoom, SHAPE.maps)
    middle = SHAPE.n // 2
    square = maps[:, SAFE, middle - 1 : middle + 2, middle - 1 : middle + 2].reshape(len(maps), 9)
    # Actions are: stay, then the headings counter-clockwise; rows of a map are from south.
    headings = jnp.array([4, 8, 7, 6, 3, 0, 1, 2, 5])
    return maps.reshape(len(maps), -1), square[:, headings] > 0


def rollout(weights: jax.Array, key: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """One episode: its return, and the sum over steps of log-probability times the reward still to come."""
    start, key = jax.random.split(key)
    state = game.reset(start, SHAPE, DOMAIN.draw(start))

    def move(state: game.State, key: jax.Array) -> tuple[game.State, Any]:
        inputs, safe = look(state)
        logits = jnp.where(safe, inputs @ weights, -1e9)
        actions = jax.random.categorical(key, logits)
        chosen = jnp.take_along_axis(jax.nn.log_softmax(logits), actions[:, None], 1)[:, 0]
        state, transition = game.step(state, actions)
        return state, (chosen, transition.score.credit, transition.score.reward)

    _, (chosen, credit, reward) = jax.lax.scan(move, state, jax.random.split(key, SHAPE.steps))

    def discounted(after: jax.Array, now: jax.Array) -> tuple[jax.Array, jax.Array]:
        return (total := now + 0.8 * after), total

    _, to_come = jax.lax.scan(discounted, jnp.zeros(SHAPE.uavs), credit, reverse=True)
    return reward.sum(), (chosen, to_come)


def loss(weights: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """REINFORCE: what came out better than usual at that step of the episode becomes more likely."""
    returns, (chosen, to_come) = jax.vmap(rollout, (None, 0))(weights, jax.random.split(key, GAMES))
    advantage = to_come - to_come.mean((0, 2), keepdims=True)
    return -(chosen * jax.lax.stop_gradient(advantage)).mean(), returns.mean()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--updates", type=int, default=60)
    arguments = parser.parse_args()
    weights = jnp.zeros((len(SHAPE.maps) * SHAPE.n**2, 9))
    optimiser = optax.adam(3e-3)
    memory = optimiser.init(weights)

    @jax.jit
    def update(weights: jax.Array, memory: Any, key: jax.Array) -> tuple[jax.Array, Any, jax.Array]:
        (_, reached), gradient = jax.value_and_grad(loss, has_aux=True)(weights, key)
        change, memory = optimiser.update(gradient, memory)
        return optax.apply_updates(weights, change), memory, reached

    for number, key in enumerate(jax.random.split(jax.random.key(0), arguments.updates)):
        weights, memory, reached = update(weights, memory, key)
        if number % 10 == 0 or number == arguments.updates - 1:
            print(f"update {number:3}  mean return of {GAMES} games {float(reached):7.2f}", flush=True)


if __name__ == "__main__":
    main()
