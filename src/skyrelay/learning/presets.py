"""Named trainings: networks, hyperparameters, games."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from skyrelay.coordination.settings import Domain, Shape, physical, varied
from skyrelay.core.errors import UsageError
from skyrelay.learning.networks import FAST, PAPER
from skyrelay.learning.ppo import Hyperparameters

PresetName = Literal["fast", "paper"]
GamesName = Literal["paper", "varied"]


@dataclass(frozen=True)
class Training:
    """One training, whole: the same value gives the same weights on the same machine.

    Attributes:
        preset: its name.
        hyperparameters: networks and algorithm.
        shape: compiled sizes of the games.
        domain: the games trained on.
        steps: of a team, over all games side by side; rounded up to whole updates.
        seed: of everything random.
        test_every: steps between two greedy tests.
        test_episodes: episodes of a greedy test (40 of 100 steps are the paper's 4,000).
    """

    preset: str
    hyperparameters: Hyperparameters
    shape: Shape
    domain: Domain
    steps: int
    seed: int
    test_every: int = 40_000
    test_episodes: int = 40

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise UsageError("training.steps", self.steps, "at least 1")
        if self.hyperparameters.horizon > self.shape.steps:
            raise UsageError("training.horizon", self.hyperparameters.horizon, "at most the steps of an episode")

    @property
    def updates(self) -> int:
        """Of the whole training."""
        return -(-self.steps // self.hyperparameters.steps_per_update)


def games_of(
    games: GamesName, uavs: tuple[int, int], vehicles: tuple[int, int], n: int, zoom: int = 2
) -> tuple[Domain, Shape]:
    """The games called "paper" (one scale) or "varied" (many scales, speeds and kinds of traffic), for some sizes."""
    if games == "varied":
        return varied(uavs, vehicles), Shape(uavs[1], vehicles[1], n=n, zoom=zoom, mobility="mixed")
    return physical(uavs, vehicles), Shape(uavs[1], vehicles[1], n=n, zoom=zoom)


_FAST = Hyperparameters(
    actor=FAST,
    critic=FAST,
    games=64,
    horizon=16,
    epochs=4,
    minibatches=4,
    learning_rate=1e-3,
    anneal=True,
    gamma=0.95,
    decay=0.9,
    entropy=0.01,
    own_credit=True,
    shaping=True,
    symmetries=True,
)
# The table's values; what it leaves open (games side by side, minibatches of 500 decisions) is set here.
_PAPER = Hyperparameters(
    actor=PAPER, critic=PAPER, games=40, horizon=100, epochs=20, minibatches=24, learning_rate=3e-4, anneal=False
)


def training(
    preset: PresetName,
    uavs: tuple[int, int],
    vehicles: tuple[int, int],
    *,
    steps: int | None = None,
    seed: int = 0,
    games: GamesName = "paper",
) -> Training:
    """A training by the name of its preset.

    Args:
        preset: "fast" (a CPU learns it in seconds) or "paper" (the paper's network and table).
        uavs, vehicles: smallest and largest numbers; each game draws its own.
        steps: of a team; None for the preset's own.
        games: "paper" (one scale) or "varied" (many scales, speeds and kinds of traffic).
    Raises:
        UsageError: a number does not fit.
    """
    base = {"fast": _FAST, "paper": _PAPER}[preset]
    n = base.actor.n
    domain, shape = games_of(games, uavs, vehicles, n)
    if preset == "paper":
        # The table's horizon counts steps of a team; minibatches stay near 500 decisions whatever the team's size.
        base = replace(base, minibatches=8 * uavs[1])
    default = {"fast": 200_000, "paper": 1_000_000}[preset]
    return Training(preset, base, shape, domain, steps if steps is not None else default, seed)
