"""The work behind the generalisation figure: one player through one kind of unseen games."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Any

import numpy as np

from skyrelay.baselines.catalogue import baseline
from skyrelay.baselines.player import Learned, play_from
from skyrelay.coordination import game
from skyrelay.coordination.replay import Setting, replayed_games
from skyrelay.coordination.settings import Domain, Shape, physical
from skyrelay.experiments.coordination_tasks import EVALUATION_SEED, OURS, forget_programs, train_network
from skyrelay.experiments.runner import Row
from skyrelay.learning.evaluation import named, policy_episodes, starts, unseen_key
from skyrelay.learning.networks import Network
from skyrelay.learning.presets import training
from skyrelay.mobility.tracks import open_trace
from skyrelay.policy import Policy

SPECIALIST = "specialist"
REACH = 3000.0
"""Range of the preset ``paper`` [m]: other ratios are zones of other sizes about it."""


def fly(
    player: str,
    group: str,
    uavs: int,
    vehicles: int,
    ratio: float,
    drop_out: float,
    trace: str | None,
    episodes: int,
    steps: int,
    cid: str | None,
) -> list[Row]:
    """Fly unseen episodes: the same for every player of the same games.

    Args:
        player: a shipped policy, `SPECIALIST` (trained for these sizes and this ratio), or a baseline.
        group: of the figure; a label.
        uavs, vehicles: of every game.
        ratio: zone side over range.
        drop_out: probability that a UAV leaves, per step.
        trace: name of the trace whose vehicles are replayed; None for the synthetic model.
        episodes: how many.
        steps: that a specialist trains for; of a team.
        cid: of the shipped policy: another policy is another task.
    Returns: one row an episode.
    """
    forget_programs()
    if player == SPECIALIST:
        config = training("fast", (uavs, uavs), (vehicles, vehicles), steps=steps)
        actor = _trained(dataclasses.replace(config, domain=_domain(uavs, vehicles, ratio)))
        games, traces = _games(config.shape, uavs, vehicles, ratio, drop_out, trace, episodes)
        measures = play_from(Learned(actor=actor), unseen_key(EVALUATION_SEED), games, traces).measures
    elif cid is not None:
        policy = Policy.builtin(player)
        shape = Shape(uavs, vehicles, n=policy.n, zoom=policy.zoom)
        games, traces = _games(shape, uavs, vehicles, ratio, drop_out, trace, episodes)
        measures = policy_episodes(policy, games, traces)
    else:
        games, traces = _games(Shape(uavs, vehicles), uavs, vehicles, ratio, drop_out, trace, episodes)
        measures = play_from(baseline(player), unseen_key(EVALUATION_SEED), games, traces).measures
    labels: Row = {"player": player, "group": group, "uavs": uavs, "vehicles": vehicles, "ratio": ratio}
    labels |= {"drop_out": drop_out, "trace": trace or ""}
    return [labels | {"episode": number} | named(values) for number, values in enumerate(np.asarray(measures).T)]


def _games(
    shape: Shape, uavs: int, vehicles: int, ratio: float, drop_out: float, trace: str | None, episodes: int
) -> tuple[game.State, game.Trace | None]:
    key = unseen_key(EVALUATION_SEED)
    team, traffic = (uavs, uavs), (vehicles, vehicles)
    if trace is not None:
        return replayed_games(key, open_trace(trace)[0], episodes, shape, Setting(team, traffic, ratio=ratio))
    domain = dataclasses.replace(_domain(uavs, vehicles, ratio), drop_out=(drop_out, drop_out))
    return starts(key, episodes, dataclasses.replace(shape, drop_outs=drop_out > 0), domain), None


def _domain(uavs: int, vehicles: int, ratio: float) -> Domain:
    return physical((uavs, uavs), (vehicles, vehicles), zone_side=ratio * REACH)


@lru_cache(maxsize=1)
def _trained(config: Any) -> Network:
    """Kept for the next task: one specialist flies several kinds of games."""
    actor, _ = train_network(OURS, dataclasses.replace(config, test_every=config.steps))
    return actor
