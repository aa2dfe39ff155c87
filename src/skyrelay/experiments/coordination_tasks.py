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
from typing import Any

import jax
import numpy as np

from skyrelay.baselines.catalogue import baseline
from skyrelay.baselines.centralized import Central
from skyrelay.baselines.cost import centralized_cost, decentralized_cost
from skyrelay.baselines.player import Episodes, Learned, play
from skyrelay.coordination import game
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.errors import TrainingError
from skyrelay.core.names import PresetName
from skyrelay.experiments.runner import Row
from skyrelay.learning.evaluation import MEASURES, named, policy_scores, starts, unseen_key
from skyrelay.learning.networks import FAST, PAPER, Network
from skyrelay.learning.ppo import EACH, Decider
from skyrelay.learning.presets import Training, training
from skyrelay.learning.training import Course
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
    player = Learned(actor=actor, decider=decider(method, uavs))
    rows = [{"kind": "curve", **labels, "vehicles": vehicles, **row} for row in rows]
    for number in flown:
        shape, domain = dataclasses.replace(config.shape, vehicles=number), physical((uavs, uavs), (number, number))
        played = play(player, unseen_key(EVALUATION_SEED), episodes, shape, domain)
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
    jax.clear_caches()


def train_network(method: str, config: Training) -> tuple[Network, list[Row]]:
    """Train by `OURS` or `CENTRALIZED`.

    Returns: the actor, and one row for each greedy test.
    Raises:
        TrainingError: a number was not finite.
    """
    _make_room(method, dataclasses.replace(config, seed=0))
    course = Course(config, [config.seed], decider(method, config.shape.uavs))
    rows: list[Row] = []
    while not course.finished:
        (row,) = course.turn()
        if course.test_is_due:
            if not all(math.isfinite(value) for value in row.values()):
                raise TrainingError(f"{method}, seed {config.seed}, update {course.done}", row, "finite numbers")
            course.test()
            rows.append({"steps": course.steps} | {name: row[f"test_{name}"] for name in MEASURES})
    return course.learner(0).actor, rows


@lru_cache(maxsize=1)
def _make_room(method: str, config: Training) -> None:  # noqa: ARG001 (what the cache tells trainings apart by)
    """Before a training of another kind than the last one: its programs are compiled anew."""
    forget_programs()


def decider(method: str, uavs: int) -> Decider:
    """Who decides by `OURS` and by `CENTRALIZED`."""
    return Central(uavs) if method == CENTRALIZED else EACH


def _episode_rows(played: Episodes, labels: Row) -> list[Row]:
    """One row an episode, with the first step at which the team was connected, and linked with all vehicles covered."""
    connected = played.first(played.joined("connectivity") == 1.0)
    linked = played.first((played.joined("connectivity_neighbor") == 1.0) & (played.joined("coverage") == 1.0))
    columns = np.asarray(played.measures).tolist()
    return [
        {"kind": "episode", **labels, "episode": number}
        | named(measures)
        | {"connected_step": _or_none(first), "linked_and_covered_step": _or_none(both)}
        for number, (*measures, first, both) in enumerate(
            zip(*columns, np.asarray(connected).tolist(), np.asarray(linked).tolist(), strict=True)
        )
    ]


def _or_none(step: float) -> int | None:
    return None if math.isnan(step) else int(step)
