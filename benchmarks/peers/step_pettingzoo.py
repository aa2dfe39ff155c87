"""Steps a second of one game through PettingZoo's interface, random actions; run by benchmarks/pettingzoo_steps.py.

    step_pettingzoo.py skyrelay|mpe2 STEPS

Prints one number.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np


def main() -> None:
    """Play and print."""
    library, steps = sys.argv[1], int(sys.argv[2])
    env: Any
    if library == "skyrelay":
        import skyrelay as sr

        env = sr.make("paper", uavs=3, vehicles=20)
    else:
        from mpe2 import simple_spread_v3

        env = simple_spread_v3.parallel_env(N=3, max_cycles=100)
    env.reset(seed=1)
    actions = np.random.default_rng(0).integers(0, env.action_space(env.agents[0]).n, (steps + 50, 3))
    for number, row in enumerate(actions.tolist()):
        if number == 50:  # what is compiled is compiled
            begin = time.perf_counter()
        if not env.agents:
            env.reset()
        env.step(dict(zip(env.agents, row, strict=True)))
    print(steps / (time.perf_counter() - begin))


if __name__ == "__main__":
    main()
