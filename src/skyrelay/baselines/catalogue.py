"""The baselines by name."""

from __future__ import annotations

import difflib
from typing import Any

import jax

from skyrelay.baselines.centroid import Centroid
from skyrelay.baselines.placement import Placement
from skyrelay.baselines.planner import Planner
from skyrelay.baselines.player import Player, Random, Static, play
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.errors import UsageError
from skyrelay.learning.evaluation import UNSEEN, summary

BASELINES: dict[str, Player] = {
    "static": Static(),
    "random": Random(),
    "centroid": Centroid(),
    "centroid-linked": Centroid(linked=True),
    "pso-placed": Placement(placed=True),
    "pso": Placement(),
    "pso-10": Placement(period=10),
    "planner": Planner(),
    "clairvoyant": Planner(foresight=True),
}
"""Each as the figures and the command line know it."""


def baseline(name: str) -> Player:
    """The baseline of a name.

    Raises:
        UsageError: there is none; the closest name is suggested.
    """
    if name not in BASELINES:
        close = difflib.get_close_matches(name, BASELINES, n=1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise UsageError("baseline", name, f"one of {', '.join(BASELINES)}{hint}")
    return BASELINES[name]


def evaluate_baseline(
    name: str, uavs: tuple[int, int], vehicles: tuple[int, int], episodes: int, seed: int
) -> dict[str, Any]:
    """`summary` of a baseline over the episodes that `evaluate_policy` flies for the same numbers and seed."""
    key = jax.random.fold_in(jax.random.key(seed), UNSEEN)
    played = play(baseline(name), key, episodes, Shape(uavs[1], vehicles[1]), physical(uavs, vehicles))
    return summary(played.measures)
