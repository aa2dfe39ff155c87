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
    """JaxMARL, small vector observations, discrete actions, all games and steps in one compiled program."""
    import jax
    from jaxmarl import make

    env = make(task, num_agents=agents)
    _, first = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), games))

    @jax.jit
    def play(state: Any, key: jax.Array) -> Any:
        def step(state: Any, key: jax.Array) -> Any:
            k_action, k_step = jax.random.split(key)
            draws = jax.random.randint(k_action, (agents, games), 0, 5)
            actions = dict(zip(env.agents, draws, strict=True))
            observations, state, rewards, _, _ = jax.vmap(env.step)(jax.random.split(k_step, games), state, actions)
            return state, (observations, rewards)

        return jax.lax.scan(step, state, jax.random.split(key, steps))

    def run() -> None:
        jax.block_until_ready(play(first, jax.random.key(1)))

    return games * agents * steps / fastest(run, repeats)


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
