"""The work behind the coordination figures: train one network, play one baseline, count one network.

Each function returns rows, told apart by the column ``kind``: "curve" (a greedy test while learning), "episode" (one
unseen episode of a finished player) and "network" (what a network weighs). All players of equal sizes play the same
episodes, so that they can be compared in pairs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import numpy as np

from skyrelay.baselines import centralized
from skyrelay.baselines.catalogue import baseline
from skyrelay.baselines.cost import centralized_cost, decentralized_cost
from skyrelay.baselines.player import RUN_ONCE, Episodes, Learned, Player, play
from skyrelay.coordination import game
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.errors import TrainingError
from skyrelay.experiments.runner import Row
from skyrelay.learning import ppo
from skyrelay.learning.evaluation import MEASURES, UNSEEN, policy_scores, starts, unseen_key
from skyrelay.learning.networks import FAST, PAPER, Network
from skyrelay.learning.ppo import Learner
from skyrelay.learning.presets import PresetName, Training, training
from skyrelay.policy import Policy

OURS, CENTRALIZED = "decentralised PPO", "centralised PPO"
EVALUATION_SEED = 0
"""Of the unseen episodes, the same for every player and training seed."""


def work(kind: str, **settings: Any) -> list[Row]:
    """One task: ``kind`` is "learn", "fly", "play" or "count"."""
    tasks: dict[str, Callable[..., list[Row]]] = {
        "learn": learn,
        "fly": fly_policy,
        "play": play_baseline,
        "count": count,
    }
    return tasks[kind](**settings)


def learn(
    method: str,
    preset: PresetName,
    uavs: int,
    vehicles: int,
    seed: int,
    steps: int,
    test_every: int,
    test_episodes: int,
    flown: list[int],
    episodes: int,
) -> list[Row]:
    """Train one network, testing it on the way, then fly it through unseen episodes.

    Args:
        method: `OURS` or `CENTRALIZED`.
        preset: network and hyperparameters, as of `skyrelay train`.
        uavs, vehicles: of the training's games.
        seed: of the training.
        steps: of a team.
        test_every: steps between two greedy tests.
        test_episodes: of 100 steps each, in a test.
        flown: numbers of vehicles of the unseen games.
        episodes: unseen, for each of those.
    Raises:
        TrainingError: a number was not finite.
    """
    config = dataclasses.replace(
        # What the paper's networks see: the figures ask how links are learned, which a guarded policy never has to.
        training(preset, (uavs, uavs), (vehicles, vehicles), steps=steps, seed=seed, paper_maps=True),
        test_every=test_every,
        test_episodes=test_episodes,
    )
    if method == CENTRALIZED and preset == "paper":
        # That preset cuts N decisions a step into 8 N pieces of 500; a team's one decision a step makes 8 of them.
        pieces = config.hyperparameters.minibatches // uavs
        config = dataclasses.replace(
            config, hyperparameters=dataclasses.replace(config.hyperparameters, minibatches=pieces)
        )
    labels: Row = {"method": method, "uavs": uavs, "seed": seed}
    actor, rows = train_network(method, config)
    player = _ALGORITHMS[method][1]
    rows = [{"kind": "curve", **labels, "vehicles": vehicles, **row} for row in rows]
    for number in flown:
        shape, domain = dataclasses.replace(config.shape, vehicles=number), physical((uavs, uavs), (number, number))
        played = play(player(actor=actor), unseen_key(EVALUATION_SEED), episodes, shape, domain)
        rows += _episode_rows(played, {**labels, "vehicles": number, "trained_vehicles": vehicles})
    return rows


def fly_policy(name: str, cid: str, uavs: int, vehicles: int, episodes: int) -> list[Row]:  # noqa: ARG001
    """Fly a shipped policy through the same unseen episodes.

    Args:
        name: of the policy.
        cid: its own; not used here, but another policy is then another task.
        uavs, vehicles: of every game.
        episodes: how many.
    """
    forget_programs()
    policy = Policy.builtin(name)
    shape = Shape(uavs, vehicles, n=policy.n, zoom=policy.zoom)
    games = starts(unseen_key(EVALUATION_SEED), episodes, shape, physical((uavs, uavs), (vehicles, vehicles)))
    played = Episodes(jax.vmap(game.measure)(games), policy_scores(policy, games))
    return _episode_rows(played, {"method": name, "uavs": uavs, "vehicles": vehicles})


def play_baseline(name: str, uavs: int, vehicles: int, episodes: int) -> list[Row]:
    """Play one baseline through the same unseen episodes."""
    forget_programs()
    shape, domain = Shape(uavs, vehicles), physical((uavs, uavs), (vehicles, vehicles))
    played = play(baseline(name), unseen_key(EVALUATION_SEED), episodes, shape, domain)
    return _episode_rows(played, {"method": name, "uavs": uavs, "vehicles": vehicles})


def count(uavs: list[int]) -> list[Row]:
    """Parameters and operations of both methods' networks, for each size of the team."""
    rows = []
    for preset, architecture in (("paper", PAPER), ("fast", FAST)):
        for number in uavs:
            for method, cost in (
                (OURS, decentralized_cost(architecture)),
                (CENTRALIZED, centralized_cost(architecture, number)),
            ):
                rows.append({"kind": "network", "method": method, "preset": preset, "uavs": number, **vars(cost)})
    return rows


def forget_programs() -> None:
    """Drop what JAX has compiled for earlier tasks: hundreds of programs use up the memory maps a process may have."""
    jax.clear_caches()  # type: ignore[no-untyped-call]


def train_network(method: str, config: Training) -> tuple[Network, list[Row]]:
    """Train by `OURS` or `CENTRALIZED`.

    Returns: the actor, and one row for each greedy test.
    Raises:
        TrainingError: a number was not finite.
    """
    algorithm, player = _ALGORITHMS[method]
    start, turn = _compiled(algorithm, dataclasses.replace(config, seed=0))
    learner = start(jax.random.key(config.seed))
    test_key = jax.random.fold_in(jax.random.key(config.seed), UNSEEN - 1)
    tests = max(1, config.test_every // config.hyperparameters.steps_per_update)
    rows: list[Row] = []
    for done in range(1, config.updates + 1):
        learner, loss = turn(learner)
        if done % tests == 0 or done == config.updates:
            if not all(math.isfinite(value) for value in jax.device_get(loss).values()):
                raise TrainingError(f"{algorithm.__name__}, seed {config.seed}, update {done}", loss, "finite numbers")
            tested = play(player(actor=learner.actor), test_key, config.test_episodes, config.shape, config.domain)
            means = np.asarray(tested.measures).mean(axis=1)
            rows.append({"steps": done * config.hyperparameters.steps_per_update, **_named(means)})
    return learner.actor, rows


@lru_cache(maxsize=1)
def _compiled(
    algorithm: ModuleType, config: Training
) -> tuple[Callable[[jax.Array], Learner], Callable[[Learner], tuple[Learner, dict[str, jax.Array]]]]:
    """How a training begins and how it goes on, compiled once for all seeds (``config`` has none of its own)."""
    forget_programs()
    hyperparameters, domain, updates = config.hyperparameters, config.domain, config.updates

    def start(key: jax.Array) -> Learner:
        learner: Learner = algorithm.begin(key, hyperparameters, config.shape, domain, updates)
        return learner

    @eqx.filter_jit(donate="all")
    def turn(learner: Learner) -> tuple[Learner, dict[str, jax.Array]]:
        result: tuple[Learner, dict[str, jax.Array]] = algorithm.update(learner, hyperparameters, domain, updates)
        return result

    return jax.jit(start, compiler_options=RUN_ONCE), turn


def _episode_rows(played: Episodes, labels: Row) -> list[Row]:
    """One row an episode, with the first step at which the team was connected, and linked with all vehicles covered."""
    connected = played.first(played.joined("connectivity") == 1.0)
    linked = played.first((played.joined("connectivity_neighbor") == 1.0) & (played.joined("coverage") == 1.0))
    columns = np.asarray(played.measures).tolist()
    return [
        {"kind": "episode", **labels, "episode": number}
        | _named(measures)
        | {"connected_step": _or_none(first), "linked_and_covered_step": _or_none(both)}
        for number, (*measures, first, both) in enumerate(
            zip(*columns, np.asarray(connected).tolist(), np.asarray(linked).tolist(), strict=True)
        )
    ]


def _named(measures: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(MEASURES, measures, strict=True)}


def _or_none(step: float) -> int | None:
    return None if math.isnan(step) else int(step)


_ALGORITHMS: dict[str, tuple[ModuleType, Callable[..., Player]]] = {
    OURS: (ppo, Learned),
    CENTRALIZED: (centralized, centralized.Centralized),
}
