"""How fast games are played with a radio: agent-steps a second, with all maps, and what each vehicle has at every step.

The disc alone is the game without asking; the others work out what is carried and delivered (two gateways) after
every step, with interference of the UAVs on a channel. Every core is a device of JAX's.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import Any

cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
# Before JAX starts; it concerns CPUs only.
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={cores}"

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
from shared.timing import fastest  # noqa: E402

from skyrelay.airspace.network import Network  # noqa: E402
from skyrelay.airspace.radio import air  # noqa: E402
from skyrelay.coordination import game  # noqa: E402
from skyrelay.coordination.service import serve  # noqa: E402
from skyrelay.coordination.settings import Shape, physical  # noqa: E402
from skyrelay.core.scenario import Gateway, Radio  # noqa: E402

STEPS = 50
SIDE = 2000.0
GATEWAYS = (Gateway(name="a", x=400.0, y=400.0), Gateway(name="b", x=1500.0, y=1500.0))
CASES = {
    "disc alone": None,
    "disc": Radio(),
    "air-to-ground": Radio(model="air-to-ground", channels=1),
    "air-to-ground, shadowed": Radio(model="air-to-ground", channels=1, shadowing=4.0),
    "tr36777": Radio(model="tr36777", channels=1),
}


def agent_steps(shape: Shape, radio: Radio | None, games: int, repeats: int) -> float:
    """Agent-steps a second under random actions."""
    devices, domain = len(jax.devices()), physical((shape.uavs, shape.uavs), (shape.vehicles, shape.vehicles))
    own = games // devices
    network = None if radio is None else Network(air=air(radio, 100.0, 1), gateways=GATEWAYS)
    demand, available = jnp.full(shape.vehicles, 2500.0), jnp.full(shape.uavs, 20_000.0)

    def play(state: game.State, key: jax.Array) -> Any:
        def step(carry: tuple[game.State, jax.Array], key: jax.Array) -> Any:
            actions = jax.random.randint(key, (own, shape.uavs), 0, 9)
            state, transition = jax.vmap(game.step)(carry[0], actions)
            got: Any = transition.score.reward
            if network is not None:
                got = got, jax.vmap(lambda one: serve(one, network, SIDE, demand, available))(state)
            return (state, transition.observation), got

        return jax.lax.scan(step, (state, jax.vmap(game.observe)(state)), jax.random.split(key, STEPS))

    new = jax.vmap(lambda key: game.reset(key, shape, domain.draw(key)))
    state = jax.pmap(new)(jax.random.split(jax.random.key(0), (devices, own)))
    keys, on_each = jax.random.split(jax.random.key(1), devices), jax.pmap(play)
    took: float = fastest(lambda: on_each(state, keys), repeats)
    return own * devices * shape.uavs * STEPS / took


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--games", type=int, default=256)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    speeds = {
        name: agent_steps(Shape(3, 20, n=11), radio, options.games, options.repeats) for name, radio in CASES.items()
    }
    machine = {"device": jax.devices()[0].device_kind, "devices": len(jax.devices()), "python": sys.version.split()[0]}
    print(json.dumps({**machine, "n": 11, "uavs": 3, "vehicles": 20, "games": options.games, "agent_steps": speeds}))


if __name__ == "__main__":
    main()
