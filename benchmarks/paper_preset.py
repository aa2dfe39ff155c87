"""Where the time of the preset paper goes, and what 10^6 steps would take on the device that JAX finds.

Times a piece of collecting, one gradient step, and each stage of a network forward and back, then counts how often a
training does each. Also says how many operations a second that is, and how many a training of 60 s asks for.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array
from shared.timing import fastest

from skyrelay.airspace.maps import normalise
from skyrelay.baselines.cost import decentralized_cost
from skyrelay.learning import ppo
from skyrelay.learning.networks import Network, convolve, max_pool
from skyrelay.learning.presets import Training, training

WANTED = 60.0
"""Seconds that the training should take on one H200 (3 UAVs, 20 vehicles)."""
HORIZON = 5
"""Steps of the piece of collecting; a training's time is proportional."""
PASSES = 3
"""Forward, and twice as much back."""


def stages(network: Network) -> dict[str, Callable[[Network, Array], Array]]:
    """The network's parts by name, each for what the one before it returns: channels first, the batch last."""

    def convolution(number: int) -> Callable[[Network, Array], Array]:
        stride, pool = network.architecture.strides[number], network.architecture.pools[number]
        return lambda net, x: max_pool(jax.nn.relu(convolve(net.convolutions[number], x, stride)), pool)

    parts = {f"convolution {k + 1}": convolution(k) for k in range(len(network.convolutions))}
    parts["fully connected"] = lambda net, x: net.conclude(x.reshape(-1, x.shape[-1]).T)
    return parts


def forward_and_back(part: Callable[[Network, Array], Array], network: Network, x: Array) -> Any:
    """The gradients of a part's summed squares, to its weights and to what goes in."""
    arrays, static = eqx.partition(network, eqx.is_array)
    return jax.grad(lambda arrays, x: jnp.sum(part(eqx.combine(arrays, static), x) ** 2), argnums=(0, 1))(arrays, x)


def profile(config: Training, repeats: int) -> dict[str, float]:
    """Seconds of a whole training by what they go to."""
    whole = config.hyperparameters
    short = replace(whole, horizon=HORIZON)
    learner = eqx.filter_jit(ppo.begin)(jax.random.key(0), short, config.shape, config.domain, config.updates)
    collect = eqx.filter_jit(partial(ppo.collect, config=short, domain=config.domain))
    collecting = fastest(lambda: collect(learner), repeats) * whole.horizon / HORIZON * config.updates

    experience = collect(learner)[1]
    size = whole.steps_per_update * config.shape.uavs // whole.minibatches
    rows = jax.tree.map(lambda x: jnp.resize(x.reshape(-1, *x.shape[3:]), (size, *x.shape[3:])), experience)
    step = eqx.filter_jit(eqx.filter_grad(partial(ppo.loss, config=whole, zoom=config.shape.zoom), has_aux=True))
    networks = learner.actor, learner.critic
    times = whole.epochs * whole.minibatches * config.updates
    found = {"collecting": collecting, "gradients": fastest(lambda: step(networks, rows), repeats) * times}

    maps = normalise(rows.maps, config.shape.zoom, config.shape.maps)
    x = jnp.moveaxis(maps, 0, -1)
    for name, part in stages(learner.actor).items():
        run = eqx.filter_jit(partial(forward_and_back, part))
        # Actor and critic have the same stages.
        found[f"gradients: {name}"] = 2 * fastest(lambda run=run, x=x: run(learner.actor, x), repeats) * times
        x = part(learner.actor, x)
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    config = training("paper", (3, 3), (20, 20))
    whole = config.hyperparameters
    found = profile(config, options.repeats)

    total = found["collecting"] + found["gradients"]
    rows = whole.epochs * whole.steps_per_update * config.shape.uavs * config.updates
    operations = 2 * PASSES * rows * decentralized_cost(whole.actor).operations
    result = {
        "device": jax.devices()[0].device_kind,
        "seconds": found,
        "total_seconds": total,
        "operations": operations,
        "gflops": operations / found["gradients"] / 1e9,
        "gflops_wanted": operations / WANTED / 1e9,
    }
    print(f"preset paper, {config.steps:,} steps on {result['device']}: about {total:,.0f} s")
    for name, seconds in found.items():
        print(f"  {name:28} {seconds:12,.1f} s  {100 * seconds / total:5.1f} %")
    print(f"gradients: {operations:.1e} operations, {result['gflops']:,.0f} GFLOP/s")
    print(f"{WANTED:g} s would take {result['gflops_wanted']:,.0f} GFLOP/s, and no time for collecting")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
