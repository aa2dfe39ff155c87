"""A conformance test for parallel environments, stricter than PettingZoo's own.

PettingZoo's seed test compares one step, so that an environment that is random from the second step on passes. This one
plays whole episodes twice, and checks every observation, reward and flag of every step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np


def check_parallel_env(make: Callable[[], Any], *, seed: int = 0, episodes: int = 2, max_steps: int = 10_000) -> int:
    """Check a PettingZoo ParallelEnv over whole episodes.

    - every observation is in its space, with its type and shape, and is no view of the last one;
    - rewards are finite numbers; terminations, truncations and infos are there for each live agent;
    - an agent that is terminated or truncated is gone from ``agents``, and nobody else is;
    - two environments with the same seed and actions are equal in everything, step by step, over all episodes, and so
      is one that is seeded again;
    - another seed gives another episode.

    Args:
        make: a new environment at each call.
        seed: of the episodes and the actions.
        episodes: to play.
        max_steps: after which an episode that does not end is a fault.
    Returns: steps played and compared.
    Raises: AssertionError, naming the episode, the step and the agent.
    """
    left, right, other = make(), make(), make()
    total = 0
    for episode in range(episodes):
        first = {"seed": seed} if episode == 0 else {}
        one, two = left.reset(**first), right.reset(**first)
        _same(f"episode {episode}, reset", one, two)
        _observations(left, f"episode {episode}, reset", one[0])
        random = np.random.default_rng([seed, episode])
        for step in range(max_steps):
            if not left.agents:
                break
            place = f"episode {episode}, step {step}"
            alive = list(left.agents)
            actions = {agent: _action(left.action_space(agent), random) for agent in alive}
            before = {agent: value.copy() for agent, value in one[0].items()}
            last = one[0]
            one, two = left.step(actions), right.step(dict(actions))
            for agent, value in last.items():
                assert np.array_equal(before[agent], value), f"{place}, {agent}: an old observation was overwritten"
            _same(place, one, two)
            _observations(left, place, one[0])
            _transition(left, place, alive, *one)
            total += 1
        assert not left.agents, f"episode {episode}: not over after {max_steps} steps"
    again = left.reset(seed=seed)
    _same("reset with the first seed again", again, right.reset(seed=seed))
    assert _differs(again[0], other.reset(seed=seed + 1)[0]), "two seeds gave the same first observation"
    return total


def _action(space: Any, random: np.random.Generator) -> Any:
    space.seed(int(random.integers(2**31)))
    return space.sample()


def _observations(env: Any, place: str, observations: Mapping[str, Any]) -> None:
    for agent, value in observations.items():
        space = env.observation_space(agent)
        assert value.dtype == space.dtype, f"{place}, {agent}: observation of type {value.dtype}, not {space.dtype}"
        assert value.shape == space.shape, f"{place}, {agent}: observation of shape {value.shape}, not {space.shape}"
        assert space.contains(value), f"{place}, {agent}: observation outside its space"


def _transition(
    env: Any,
    place: str,
    alive: list[str],
    observations: Mapping[str, Any],
    rewards: Mapping[str, float],
    terminations: Mapping[str, bool],
    truncations: Mapping[str, bool],
    infos: Mapping[str, Any],
) -> None:
    parts = {
        "observations": observations,
        "rewards": rewards,
        "terminations": terminations,
        "truncations": truncations,
        "infos": infos,
    }
    for name, part in parts.items():
        missing = set(alive) - set(part)
        assert not missing, f"{place}: {name} lack {sorted(missing)}"
    for agent in alive:
        assert np.isfinite(rewards[agent]), f"{place}, {agent}: reward {rewards[agent]}"
        over = terminations[agent] or truncations[agent]
        assert over != (agent in env.agents), f"{place}, {agent}: over is {over}, in agents is {agent in env.agents}"


def _same(place: str, one: Any, two: Any) -> None:
    """Equal to the last bit, through tuples and mappings."""
    if isinstance(one, Mapping):
        assert set(one) == set(two), f"{place}: keys {sorted(one)} and {sorted(two)}"
        for key in one:
            _same(f"{place}, {key}", one[key], two[key])
    elif isinstance(one, tuple | list):
        assert len(one) == len(two), f"{place}: lengths {len(one)} and {len(two)}"
        for index, (a, b) in enumerate(zip(one, two, strict=True)):
            _same(f"{place}[{index}]", a, b)
    else:
        assert np.array_equal(one, two, equal_nan=isinstance(one, float)), f"{place}: the same seed gave two results"


def _differs(one: Mapping[str, Any], two: Mapping[str, Any]) -> bool:
    return any(not np.array_equal(one[agent], two[agent]) for agent in one)
