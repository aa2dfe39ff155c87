"""The game by PettingZoo's interface: any library that takes a parallel environment takes this one.

pip install ".[train]"
python examples/pettingzoo_loop.py
"""

from __future__ import annotations

import argparse

import numpy as np

import skyrelay as sr


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=50, help="of an episode")
    arguments = parser.parse_args()
    for name in ("random", "hovering"):
        env = sr.make("paper", uavs=3, vehicles=10, steps=arguments.steps)
        observations, _ = env.reset(seed=1)  # a dict: maps by agent
        for agent in env.agents:
            env.action_space(agent).seed(1)
        total, steps = 0.0, 0
        while env.agents:
            stay = name == "hovering"
            actions = {agent: 0 if stay else int(env.action_space(agent).sample()) for agent in env.agents}
            _, rewards, _, _, _ = env.step(actions)
            total, steps = total + float(np.mean(list(rewards.values()))), steps + 1
        print(f"{name:<9} return {total:7.2f} in {steps} steps; maps {observations['uav_0'].shape}")


if __name__ == "__main__":
    main()
