"""How fast the game is played: agent-steps a second, observations of every agent at every step included.

Prints a table and JSON. With ``--peers`` it also measures VMAS and JaxMARL in this process where they are installed
(``pip install vmas jaxmarl`` in an environment of their own), so that the ratio comes from one run on one machine.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import time
from collections.abc import Callable
from typing import Any

import jax

from skyrelay.coordination import game
from skyrelay.coordination.settings import Shape, physical, varied

STEPS = 50


def best(run: Callable[[], Any], repeats: int) -> float:
    """Seconds of the fastest of several runs, after one that compiles."""
    jax.block_until_ready(run())
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def agent_steps(shape: Shape, domain: Any, games: int, repeats: int) -> tuple[float, int]:
    """Agent-steps a second under random actions, and bytes of state and observations per game."""

    def new(key: jax.Array) -> game.State:
        return game.reset(key, shape, domain.draw(key))

    state = jax.jit(jax.vmap(new))(jax.random.split(jax.random.key(0), games))

    @jax.jit
    def play(state: game.State, key: jax.Array) -> Any:
        def body(carry: tuple[game.State, jax.Array], key: jax.Array) -> Any:
            state, _ = carry
            actions = jax.random.randint(key, (games, shape.uavs), 0, 9)
            state, transition = jax.vmap(game.step)(state, actions)
            return (state, transition.observation), transition.score.reward

        first = jax.vmap(game.observe)(state)
        return jax.lax.scan(body, (state, first), jax.random.split(key, STEPS))

    seconds = best(lambda: play(state, jax.random.key(1)), repeats)
    size = sum(leaf.nbytes for leaf in jax.tree.leaves((jax.random.key_data(state.key), strip(state))))
    maps = jax.eval_shape(jax.vmap(game.observe), state)
    return games * shape.uavs * STEPS / seconds, (size + maps.size * maps.dtype.itemsize) // games


def strip(state: game.State) -> Any:
    """The state's arrays without its random key."""
    return (state.parameters, state.uavs, state.active, state.traffic, state.owner, state.present, state.time)


def vmas_navigation(games: int, agents: int, repeats: int) -> float:
    """VMAS's navigation, vector observations."""
    import torch
    import vmas

    env = vmas.make_env("navigation", num_envs=games, device="cpu", n_agents=agents)
    env.reset()
    actions = [torch.rand(games, 2) * 2 - 1 for _ in range(agents)]

    def run() -> None:
        for _ in range(STEPS):
            env.step(actions)

    return games * agents * STEPS / best(run, repeats)


def jaxmarl_spread(games: int, agents: int, repeats: int) -> float:
    """JaxMARL's simple_spread, vector observations."""
    import jaxmarl

    env = jaxmarl.make("MPE_simple_spread_v3", num_agents=agents)
    _, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), games))

    @jax.jit
    def play(state: Any, key: jax.Array) -> Any:
        def body(state: Any, key: jax.Array) -> Any:
            k_action, k_step = jax.random.split(key)
            actions = {
                agent: jax.random.randint(jax.random.fold_in(k_action, i), (games,), 0, 5)
                for i, agent in enumerate(env.agents)
            }
            maps, state, reward, _, _ = jax.vmap(env.step)(jax.random.split(k_step, games), state, actions)
            return state, (maps, reward)

        return jax.lax.scan(body, state, jax.random.split(key, STEPS))

    return games * agents * STEPS / best(lambda: play(state, jax.random.key(1)), repeats)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--games", type=int, nargs="+", default=[64, 256, 1024])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--peers", action="store_true")
    parser.add_argument("--quick", action="store_true", help="N = 3, V = 20 only")
    options = parser.parse_args()
    settings = [(11, 3, 20), (19, 3, 20)]
    if not options.quick:
        settings += [(11, 2, 5), (11, 5, 20), (19, 2, 5), (19, 5, 20)]
    rows: list[dict[str, Any]] = []

    def report(**row: Any) -> None:
        rows.append(row)
        shown = {key: f"{value:,.0f}" if isinstance(value, float) else value for key, value in row.items()}
        print("  ".join(f"{key} {value}" for key, value in shown.items()), flush=True)

    for games in options.games:
        for n, uavs, vehicles in settings:
            speed, size = agent_steps(
                Shape(uavs, vehicles, n=n), physical((uavs, uavs), (vehicles, vehicles)), games, options.repeats
            )
            numbers = {"n": n, "uavs": uavs, "vehicles": vehicles, "games": games}
            report(what="skyrelay", **numbers, agent_steps=speed, bytes_per_game=size)
        shape = Shape(8, 40, mobility="mixed")
        speed, size = agent_steps(shape, varied((2, 8), (1, 40)), games, options.repeats)
        report(what="skyrelay mixed", n=11, uavs=8, vehicles=40, games=games, agent_steps=speed, bytes_per_game=size)
        if options.peers:
            for name, module, peer in (
                ("vmas navigation", "vmas", vmas_navigation),
                ("jaxmarl simple_spread", "jaxmarl", jaxmarl_spread),
            ):
                if importlib.util.find_spec(module):
                    report(what=name, uavs=3, games=games, agent_steps=peer(games, 3, options.repeats))
                else:
                    print(f"{name}: not installed")
    ours = max(row["agent_steps"] for row in rows if row["what"] == "skyrelay" and row["n"] == 11)
    for name in ("vmas navigation", "jaxmarl simple_spread"):
        speeds = [row["agent_steps"] for row in rows if row["what"] == name]
        if speeds:
            print(f"skyrelay at n = 11 over {name}: {ours / max(speeds):.2f}")
    print(json.dumps({"device": jax.devices()[0].device_kind, "rows": rows}))


if __name__ == "__main__":
    main()
