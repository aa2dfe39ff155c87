"""The baselines by name."""

from __future__ import annotations

from typing import Any

from skyrelay.baselines.centroid import Centroid
from skyrelay.baselines.cover import Cover
from skyrelay.baselines.placement import Placement
from skyrelay.baselines.planner import Planner
from skyrelay.baselines.player import Player, Random, Static, play_from
from skyrelay.baselines.recharge import Recharge
from skyrelay.coordination import game
from skyrelay.core import plugins
from skyrelay.core.errors import UsageError
from skyrelay.learning.evaluation import summary, unseen_key

BASELINES: dict[str, Player] = {
    "static": Static(),
    "random": Random(),
    "centroid": Centroid(),
    "centroid-linked": Centroid(linked=True),
    "cover": Cover(),
    "pso-placed": Placement(placed=True),
    "pso": Placement(),
    "pso-10": Placement(period=10),
    "planner": Planner(),
    "clairvoyant": Planner(foresight=True),
    "recharge": Recharge(),
}
"""Each as the figures and the command line know it."""
GROUP = "skyrelay.baselines"
"""Of entry points."""


def baseline(name: str) -> Player:
    """The baseline of a name: a shipped one's, an entry point's, or ``module:Player`` that the user has named.

    Raises:
        UsageError: there is none, the closest name is suggested; or it is no player.
    """
    if name in BASELINES:
        return BASELINES[name]
    found = plugins.load(GROUP, name, {}, "baseline", list(BASELINES))
    player = found() if isinstance(found, type) and issubclass(found, Player) else found
    if not isinstance(player, Player):
        raise UsageError("baseline", name, "a class or an object of skyrelay.baselines.player.Player")
    return player


def evaluate_baseline(name: str, seed: int, games: game.State, traces: game.Trace | None = None) -> dict[str, Any]:
    """`summary` of a baseline over whole episodes from these starts, as `evaluate_policy` flies them.

    Raises:
        UsageError: there is no such baseline, or it cannot play replayed vehicles.
    """
    player = baseline(name)
    if traces is not None and isinstance(player, Planner):
        raise UsageError("baseline", name, "another one for a trace: a planner looks ahead by the synthetic models")
    return summary(play_from(player, unseen_key(seed), games, traces).measures)
