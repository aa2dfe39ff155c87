"""How fast the game is played: agent-steps a second, observations of every agent at every step included.

Every core is a device of JAX's, and each plays its share of the games (`--devices 1` for one). With ``--peers`` VMAS
and JaxMARL are measured in the same run, in the environments ``.venv/peers`` and ``.venv/jaxmarl`` (`make peers`), so
that the ratios come from one machine at one time; their observations are a few numbers for each agent, ours six maps
(with the outlook eight, which `skyrelay train` learns from).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
# Before JAX starts; it concerns CPUs only.
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={cores}"

import jax  # noqa: E402
from shared.timing import fastest  # noqa: E402

from skyrelay.coordination import game  # noqa: E402
from skyrelay.coordination.settings import Domain, Shape, physical, varied  # noqa: E402

STEPS = 50
ROOT = Path(__file__).parents[1]
PEERS = (
    ("peers", "vmas", "navigation"),
    ("peers", "vmas", "simple_spread"),
    ("jaxmarl", "jaxmarl", "MPE_simple_spread_v3"),
)


def agent_steps(shape: Shape, domain: Domain, games: int, devices: int, repeats: int) -> tuple[float, int]:
    """Agent-steps a second under random actions, and bytes of state and observations per game."""
    own = games // devices

    def new(key: jax.Array) -> game.State:
        return game.reset(key, shape, domain.draw(key))

    def play(state: game.State, key: jax.Array) -> Any:
        def step(carry: tuple[game.State, jax.Array], key: jax.Array) -> Any:
            state, _ = carry
            actions = jax.random.randint(key, (own, shape.uavs), 0, 9)
            state, transition = jax.vmap(game.step)(state, actions)
            return (state, transition.observation), transition.score.reward

        first = jax.vmap(game.observe)(state)
        return jax.lax.scan(step, (state, first), jax.random.split(key, STEPS))

    on_each = jax.pmap(play, devices=jax.devices()[:devices])
    state = jax.pmap(jax.vmap(new), devices=jax.devices()[:devices])(
        jax.random.split(jax.random.key(0), (devices, own))
    )
    keys = jax.random.split(jax.random.key(1), devices)
    seconds = fastest(lambda: on_each(state, keys), repeats)
    maps = jax.eval_shape(jax.vmap(jax.vmap(game.observe)), state)
    size = sum(leaf.nbytes for leaf in jax.tree.leaves((jax.random.key_data(state.key), without_key(state))))
    return own * devices * shape.uavs * STEPS / seconds, (size + maps.size * maps.dtype.itemsize) // games


def without_key(state: game.State) -> list[jax.Array]:
    """The state's arrays but its random keys, which have no size of their own."""
    return [leaf for leaf in jax.tree.leaves(state) if not jax.numpy.issubdtype(leaf.dtype, jax.dtypes.prng_key)]


def peer(environment: str, library: str, task: str, games: int, repeats: int) -> float | None:
    """Agent-steps a second of another library's task, or None where its environment was not made."""
    python = ROOT / ".venv" / environment / "bin" / "python"
    if not python.exists():
        print(f"{library} {task}: not measured, there is no environment .venv/{environment} (make peers makes it)")
        return None
    line = [python, ROOT / "benchmarks" / "peers" / "step_environments.py", library, task]
    line += ["--games", games, "--agents", 3, "--steps", STEPS, "--repeats", repeats]
    # JaxMARL finds as many devices as we do: XLA_FLAGS is passed on.
    ended = subprocess.run(list(map(str, line)), stdout=subprocess.PIPE, text=True, check=True)
    return float(ended.stdout.split()[-1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--games", type=int, nargs="+", default=[64, 256, 1024])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--devices", type=int, default=len(jax.devices()))
    parser.add_argument("--peers", action="store_true", help="measure VMAS and JaxMARL too")
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
            shape, domain = Shape(uavs, vehicles, n=n), physical((uavs, uavs), (vehicles, vehicles))
            speed, size = agent_steps(shape, domain, games, options.devices, options.repeats)
            numbers = {"n": n, "uavs": uavs, "vehicles": vehicles, "games": games}
            report(what="skyrelay", **numbers, agent_steps=speed, bytes_per_game=size)
            if (uavs, vehicles) == (3, 20):
                speed, size = agent_steps(replace(shape, outlook=True), domain, games, options.devices, options.repeats)
                report(what="skyrelay outlook", **numbers, agent_steps=speed, bytes_per_game=size)
        if not options.quick:
            shape, domain = Shape(8, 40, mobility="mixed"), varied((2, 8), (1, 40))
            speed, size = agent_steps(shape, domain, games, options.devices, options.repeats)
            numbers = {"n": 11, "uavs": 8, "vehicles": 40, "games": games}
            report(what="skyrelay mixed", **numbers, agent_steps=speed, bytes_per_game=size)
        for environment, library, task in PEERS if options.peers else ():
            measured = peer(environment, library, task, games, options.repeats)
            if measured:
                report(what=f"{library} {task}", uavs=3, games=games, agent_steps=measured)

    def best(what: str, n: int | None = None) -> float:
        speeds = (row["agent_steps"] for row in rows if row["what"] == what and row.get("n") == n and row["uavs"] == 3)
        return max(speeds, default=0.0)

    for name in (f"{library} {task}" for _, library, task in PEERS):
        if best(name):
            ratios = ", ".join(f"{best('skyrelay', n) / best(name):.2f} at n = {n}" for n in (11, 19))
            print(f"skyrelay over {name}, the best of each: {ratios}")
    machine = {"device": jax.devices()[0].device_kind, "devices": options.devices, "python": sys.version.split()[0]}
    print(json.dumps({**machine, "rows": rows}))


if __name__ == "__main__":
    main()
