"""What decides without a network: a shipped rule, another package's, or own code. Its card is on the chain like a
policy's, so that the record says by CID who decided; its code is never fetched: a host flies only what it has itself.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from typing import Any, TypeAlias

from skyrelay.airspace.charging import RECHARGE, Habit
from skyrelay.airspace.flight import ACTIONS, STAY
from skyrelay.airspace.maps import PAPER_MAPS
from skyrelay.airspace.sight import Sight
from skyrelay.core import plugins
from skyrelay.core.errors import ModelError, SkyRelayError
from skyrelay.core.scenario import UINT16
from skyrelay.policy import Policy

GROUP = "skyrelay.policies"
"""Of entry points."""
FLOWN = "skyrelay.baselines.flown"
"""The rules that need JAX; loaded by name, since a run without them needs none."""
RULES = {
    "hovering": "skyrelay.protocol.rule:hover",
    "random": f"{FLOWN}:random",
    "centroid": f"{FLOWN}:centroid",
    "centroid-linked": f"{FLOWN}:centroid_linked",
    "cover": f"{FLOWN}:cover",
    "pso": f"{FLOWN}:pso",
    "pso-10": f"{FLOWN}:pso_10",
    "planner": f"{FLOWN}:planner",
    "recharge": f"{FLOWN}:recharge",
    "serve": "skyrelay.airspace.serve:serve",
}
"""Each rule that can fly a run, and where it is; those of `FLOWN` are made with the run's seed."""
SEEKING = frozenset({"serve"})
"""Those that also fly a UAV that no vehicle has selected, to where it may be."""
HABITS: dict[str, Habit] = {"recharge": RECHARGE}
"""Those that have a say in when a UAV is charged."""
MARK = b'{"rule": '
"""How a rule's card begins."""

Flies = Callable[[Sight], int]
"""From what one UAV sees to its action, 0 to 8."""


@dataclass(frozen=True)
class RuleCard:
    """What the contract has to know of a rule: it flies teams of every size, and looks at positions, not at maps."""

    name: str
    n: int = 11
    maps: tuple[str, ...] = PAPER_MAPS
    uavs: tuple[int, int] = (1, UINT16)
    vehicles: tuple[int, int] = (1, UINT16)
    evaluation: tuple[Any, ...] = ()


class Rule:
    """A rule as every UAV has it.

    Args:
        name: of the rule, or ``module:attribute``.
        flies: decides for one UAV.

    Attributes:
        seeks: whether it also flies a UAV that no vehicle has selected.
        habit: when a UAV that flies by it goes to a charging place; None: it has no say in that.
        card: for the contract.
        content: what the store keeps and the CID is of: the name, and which version of the code decides.
    """

    def __init__(self, name: str, flies: Flies) -> None:
        self.card = RuleCard(name)
        self.flies = flies
        self.seeks = name in SEEKING
        self.habit = HABITS.get(name)
        told = {"rule": name, "skyrelay": version("skyrelay"), "sha256": plugins.fingerprint(flies)}
        self.content = json.dumps(told).encode()

    @classmethod
    def named(cls, name: str, seed: int, others: Sequence[str] = ()) -> Rule:
        """A shipped rule, another package's, or code that the user has named.

        Args:
            seed: of what a rule draws.
            others: names that are no rules but fit in the same place; for suggestions.
        Raises:
            UsageError: there is none of that name, or it cannot be loaded.
            ModelError: it is nothing that can decide.
        """
        found = plugins.load(GROUP, name, RULES, "coordination.policy", others)
        if RULES.get(name, "").startswith(FLOWN):
            return cls(name, found(seed))
        if hasattr(found, "begin") and hasattr(found, "act"):  # a `skyrelay.baselines.player.Player`
            adapt = plugins.load(GROUP, "player", {"player": f"{FLOWN}:flown"}, "coordination.policy")
            return cls(name, adapt(found, seed))
        if not callable(found):
            raise ModelError(f"policy {name}", type(found).__name__, "a function from a Sight to an action, 0 to 8")
        return cls(name, found)

    def decide(self, sights: Sequence[Sight]) -> list[int]:
        """An action for each sight.

        Raises:
            ModelError: the rule raises, or answers with something else than an action.
        """
        return [self._checked(partial(self.flies, sight)) for sight in sights]

    def _checked(self, decide: Callable[[], Any]) -> int:
        try:
            action = decide()
        except SkyRelayError:
            raise
        except Exception as error:  # own code may raise anything
            raise ModelError(
                f"policy {self.card.name}", None, f"a rule that decides ({plugins.fault(error)})"
            ) from error
        if isinstance(action, bool) or not hasattr(action, "__index__") or not 0 <= action.__index__() < ACTIONS:
            raise ModelError(f"policy {self.card.name}: action", action, f"a whole number from 0 to {ACTIONS - 1}")
        return int(action.__index__())


Decider: TypeAlias = Policy | Rule
"""What a UAV flies by."""


def hover(sight: Sight) -> int:  # noqa: ARG001 (it looks at nothing)
    """Stay."""
    return STAY
