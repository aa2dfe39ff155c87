"""Named trainings: networks, hyperparameters, games."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from skyrelay.coordination.energy import Batteries
from skyrelay.coordination.obstacles import Cities
from skyrelay.coordination.settings import Domain, Shape, physical, varied
from skyrelay.core import plugins
from skyrelay.core.errors import TrainingError, UsageError
from skyrelay.core.names import WITH_ENERGY, GamesName, PresetName
from skyrelay.learning.networks import FAST, GENERALIST, GENERALIST_CRITIC, PAPER, Architecture
from skyrelay.learning.ppo import Hyperparameters


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
    games: GamesName, uavs: tuple[int, int], vehicles: tuple[int, int], n: int, zoom: int = 2, outlook: bool = False
) -> tuple[Domain, Shape]:
    """The games of a name, for some sizes.

    Args:
        games: "paper" (one scale), "varied" (many scales, speeds and kinds of traffic, drop-outs), "obstacles" (of one
            scale, with buildings that block the sight), "energy" (of one scale, with batteries and a charging point) or
            "rotary-wing" (likewise, moves costing what a rotary-wing UAV's do at 5 to 30 m/s).
        n, zoom, outlook: as in `Shape`.
    """
    shape = Shape(uavs[1], vehicles[1], n=n, zoom=zoom, outlook=outlook)
    if games == "obstacles":
        cities = Cities()
        return replace(physical(uavs, vehicles), cities=cities), replace(shape, walls=cities.walls)
    if games in WITH_ENERGY:
        batteries = Batteries(speeds=(5.0, 30.0)) if games == "rotary-wing" else Batteries()
        return replace(physical(uavs, vehicles), batteries=batteries), replace(shape, energy=True)
    if games == "varied":
        return varied(uavs, vehicles), replace(shape, mobility="mixed", drop_outs=True, tells_range=True)
    return physical(uavs, vehicles), shape


_FAST = Hyperparameters(
    actor=FAST,
    critic=FAST,
    games=128,
    horizon=16,
    epochs=3,
    minibatches=4,
    learning_rate=1e-3,
    anneal=True,
    gamma=0.95,
    decay=0.9,
    # Less than this, and the policy settles on noise: the greedy return falls again after its first peak.
    entropy=0.1,
    own_credit=True,
    shaping=0.5,
    symmetries=True,
)
# Many scales ask for a finer map and a wider network, many sizes for credit of one size, and wide zones for links with
# something to spare; eight UAVs a game fill the minibatches.
_GENERALIST = replace(
    _FAST, actor=GENERALIST, critic=GENERALIST_CRITIC, minibatches=8, even_credit=True, link_margin=0.4
)
# The table's values; what it leaves open (games side by side, minibatches of 500 decisions) is set here.
_PAPER = Hyperparameters(
    actor=PAPER, critic=PAPER, games=40, horizon=100, epochs=20, minibatches=24, learning_rate=3e-4, anneal=False
)
# As the public code of the paper's authors has it for another problem (docs/assumptions.md); it bounds no gradient.
_AUTHORS = replace(_PAPER, minibatches=1, critic_rate=1e-3, time_limit_ends=True, per_agent=True, max_gradient=1e9)


def with_network(config: Training, name: str, change: Callable[[Architecture], Architecture]) -> Training:
    """The training with networks of one's own: what ``change`` makes of the preset's architectures.

    Raises:
        TrainingError: it raises, makes no architecture, or one that looks at other maps.
    """
    place, made = f"network {name}", []
    for before in (config.hyperparameters.actor, config.hyperparameters.critic):
        try:
            after = change(before)
        except Exception as error:  # own code may raise anything
            raise TrainingError(place, None, f"an Architecture ({plugins.fault(error)})") from error
        if not isinstance(after, Architecture):
            raise TrainingError(place, type(after).__name__, "an Architecture")
        if (after.n, after.maps) != (before.n, before.maps):
            raise TrainingError(place, f"n = {after.n} and {len(after.maps)} maps", "the games' own n and maps")
        made.append(after)
    actor, critic = made
    return replace(config, hyperparameters=replace(config.hyperparameters, actor=actor, critic=critic))


def training(
    preset: PresetName,
    uavs: tuple[int, int],
    vehicles: tuple[int, int],
    *,
    steps: int | None = None,
    seed: int = 0,
    games: GamesName = "paper",
    paper_maps: bool = False,
) -> Training:
    """A training by the name of its preset.

    Args:
        preset: "fast" (a CPU learns it in seconds), "generalist" (for many sizes and scales), "paper" (the paper's
            network and table) or "authors" (the same as its authors' public code has it).
        uavs, vehicles: smallest and largest numbers; each game draws its own.
        steps: of a team; None for the preset's own.
        games: as in `games_of`.
        paper_maps: learn from the paper's six maps (and those of the games) alone, without the outlook and the moves
            that it rules out because they could break a link. Presets "paper" and "authors" always do, and games with
            energy do: a UAV that has to charge must be free to leave.
    Raises:
        UsageError: a number does not fit.
    """
    base = {"fast": _FAST, "generalist": _GENERALIST, "paper": _PAPER, "authors": _AUTHORS}[preset]
    ours = preset in ("fast", "generalist")
    n, zoom = base.actor.n, 3 if preset == "generalist" else 2
    outlook = ours and not paper_maps and games not in WITH_ENERGY
    domain, shape = games_of(games, uavs, vehicles, n, zoom, outlook)
    if preset == "paper":
        # The table's horizon counts steps of a team; minibatches stay near 500 decisions whatever the team's size.
        base = replace(base, minibatches=8 * uavs[1])
    if outlook:
        # No link is at stake: what is left to learn shows within a few steps, and is clear enough for larger strides.
        base = replace(base, gamma=0.85, learning_rate=3e-3)
    if games in WITH_ENERGY and ours:
        # What a step of charging is worth shows many steps later, and a UAV that explores hardly stays to be charged.
        base = replace(base, entropy=0.03, gamma=0.97, shaping=1.0)
    actor, critic = (replace(network, maps=shape.maps) for network in (base.actor, base.critic))
    base = replace(base, actor=actor, critic=critic)
    default = {"fast": 400_000, "generalist": 1_500_000, "paper": 1_000_000, "authors": 1_000_000}[preset]
    return Training(preset, base, shape, domain, steps if steps is not None else default, seed)
