"""Agent-steps a second of other libraries' environments; run by benchmarks/environment.py, each in its environment.

Prints one number. Imports nothing of SkyRelay: JaxMARL may need another JAX.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any


def fastest(run: Callable[[], Any], repeats: int) -> float:
    """Seconds of the fastest of several runs, after one that compiles."""
    run()
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def vmas(task: str, games: int, agents: int, steps: int, repeats: int) -> float:
    """VMAS, small vector observations, continuous actions."""
    import torch
    from vmas import make_env

    env = make_env(task, num_envs=games, device="cpu", n_agents=agents)
    env.reset()
    actions = [torch.rand(games, 2) * 2 - 1 for _ in range(agents)]

    def run() -> None:
        for _ in range(steps):
            env.step(actions)

    return games * agents * steps / fastest(run, repeats)


def jaxmarl(task: str, games: int, agents: int, steps: int, repeats: int) -> float:
    """JaxMARL, small vector observations, discrete actions, one compiled program, games on every device."""
    import jax
    from jaxmarl import make

    env, devices = make(task, num_agents=agents), len(jax.devices())
    own = games // devices
    keys = jax.random.split(jax.random.key(0), (devices, own))
    first = jax.pmap(lambda keys: jax.vmap(env.reset)(keys)[1])(keys)

    def play(state: Any, key: jax.Array) -> Any:
        def step(state: Any, key: jax.Array) -> Any:
            k_action, k_step = jax.random.split(key)
            draws = jax.random.randint(k_action, (agents, own), 0, 5)
            actions = dict(zip(env.agents, draws, strict=True))
            observations, state, rewards, _, _ = jax.vmap(env.step)(jax.random.split(k_step, own), state, actions)
            return state, (observations, rewards)

        return jax.lax.scan(step, state, jax.random.split(key, steps))

    on_each, keys = jax.pmap(play), jax.random.split(jax.random.key(1), devices)
    seconds = fastest(lambda: jax.block_until_ready(on_each(first, keys)), repeats)
    return own * devices * agents * steps / seconds


def main() -> None:
    """Measure one of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", choices=["vmas", "jaxmarl"])
    parser.add_argument("task")
    for name in ("games", "agents", "steps", "repeats"):
        parser.add_argument(f"--{name}", type=int, required=True)
    options = parser.parse_args()
    measure = {"vmas": vmas, "jaxmarl": jaxmarl}[options.library]
    print(measure(options.task, options.games, options.agents, options.steps, options.repeats))


if __name__ == "__main__":
    main()
