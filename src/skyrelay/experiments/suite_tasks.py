"""The tasks of the suites (`skyrelay.data/suites`), and the work behind them: one method through one task.

All methods play the same episodes of a task. Run number k plays those of seed k; where a method is several trainings of
one kind, its k-th training flies run k.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from skyrelay.airspace.network import Network
from skyrelay.airspace.radio import air
from skyrelay.baselines.catalogue import baseline
from skyrelay.baselines.planner import Planner
from skyrelay.baselines.player import play_from
from skyrelay.baselines.recharge import Recharge
from skyrelay.coordination import game
from skyrelay.coordination.replay import Setting, replayed_games
from skyrelay.coordination.service import serve
from skyrelay.coordination.settings import Shape
from skyrelay.core.errors import UsageError
from skyrelay.core.names import WITH_ENERGY, GamesName
from skyrelay.core.scenario import Gateway, Radio
from skyrelay.experiments.coordination_tasks import forget_programs
from skyrelay.experiments.runner import Row
from skyrelay.learning.evaluation import Also, flown, named, per_episode, starts, unseen_key
from skyrelay.learning.presets import games_of
from skyrelay.mobility.tracks import open_trace
from skyrelay.policy import Policy

SIDE = 6000.0
"""Of the zone where there is a radio [m]: that of the preset ``paper`` (docs/assumptions.md)."""
ALTITUDE = 100.0
DEMANDS = (1000.0, 4000.0)
"""What vehicles ask for where there is a radio, from the first row to the last [kbit/s]."""
BANDWIDTH = 50_000.0
"""Of each UAV [kbit/s]."""
GATEWAY = Gateway(name="middle", kind="base-station", x=SIDE / 2, y=SIDE / 2, height=30.0, capacity=200.0)


@dataclass(frozen=True)
class GameTask:
    """One kind of unseen games.

    Attributes:
        name: in its version.
        uavs, vehicles: of every game; of a trace, at most so many vehicles.
        games: as in `skyrelay.learning.presets.games_of`.
        trace: whose vehicles are replayed; None for synthetic ones.
        radio: the model of `skyrelay.core.scenario.Radio` by which traffic is carried; None where none is counted.
        gateway: what counts is what reaches a gateway in the middle of the zone.
        hovering, best: what the measure is, on average, of UAVs that hover and of the best rule.
        best_by: that rule's name.
    """

    name: str
    uavs: int
    vehicles: int
    games: GamesName = "paper"
    trace: str | None = None
    radio: Literal["air-to-ground", "tr36777"] | None = None
    gateway: bool = False
    hovering: float = 0.0
    best: float = 1.0
    best_by: str = ""

    @property
    def measure(self) -> str:
        """What is scored: the return of Eq. 3, or the share of what vehicles ask for that is carried or delivered."""
        if self.radio is None:
            return "return"
        return "delivered" if self.gateway else "carried"

    @property
    def settings(self) -> dict[str, Any]:
        """What a row depends on: all but what scores are made with."""
        names = ("uavs", "vehicles", "games", "trace", "radio", "gateway")
        return {"game": self.name} | {name: getattr(self, name) for name in names}

    def score(self, values: Any) -> Any:
        """0 where UAVs hover, 1 where the best rule is; linear, and not cut off at either."""
        return (values - self.hovering) / (self.best - self.hovering)


@dataclass(frozen=True)
class Suite:
    """A fixed set of tasks.

    Attributes:
        name: with its version, such as ``sizes-v1``.
        title: one line.
        tasks: in order.
        runs: of each method; run k plays the episodes of seed k.
        episodes: of each task in a run.
        rules: those that play; None for all.
    """

    name: str
    title: str
    tasks: tuple[GameTask, ...]
    runs: int
    episodes: int
    rules: tuple[str, ...] | None = None


@lru_cache(maxsize=1)
def suites() -> Mapping[str, Suite]:
    """All suites of all versions by their names."""
    found = {}
    for file in sorted((files("skyrelay.data") / "suites").iterdir(), key=lambda item: item.name):
        text = tomllib.loads(file.read_text("utf-8"))
        tasks = {name: GameTask(name, **settings) for name, settings in text["tasks"].items()}
        for name, told in text["suites"].items():
            rules = tuple(told["rules"]) if "rules" in told else None
            chosen = tuple(tasks[task] for task in told["tasks"])
            found[name] = Suite(name, told["title"], chosen, told["runs"], told["episodes"], rules)
    return found


def suite_of(name: str) -> Suite:
    """The suite of a name; without a version, the newest of that name.

    Raises:
        UsageError: there is none.
    """
    known = suites()
    if name in known:
        return known[name]
    versions = [suite for full, suite in known.items() if full.rpartition("-v")[0] == name]
    if versions:
        return max(versions, key=lambda suite: int(suite.name.rpartition("-v")[2]))
    raise UsageError("--suite", name, "one of: " + ", ".join(known))


def plays(rule: str, task: GameTask) -> bool:
    """Whether a rule is for a task: a planner looks ahead by the open synthetic games, `recharge` has to charge."""
    player = baseline(rule)
    if isinstance(player, Planner):
        return task.trace is None and task.radio is None and task.games != "obstacles"
    return not isinstance(player, Recharge) or task.games in WITH_ENERGY


def play(
    method: str,
    files: Sequence[str],
    cids: Sequence[str],  # noqa: ARG001 (another policy in the same file is another task)
    runs: int,
    episodes: int,
    game: str,
    uavs: int,
    vehicles: int,
    games: GamesName,
    trace: str | None,
    radio: Literal["air-to-ground", "tr36777"] | None,
    gateway: bool,
) -> list[Row]:
    """Play one task by one method.

    Args:
        method: its name; of a rule the rule's.
        files: of the policies that fly (or names of shipped ones): one for all runs, or one for each; none for a rule.
        cids: theirs.
        runs, episodes: as in `Suite`.
        game: the task's name.
        uavs, vehicles, games, trace, radio, gateway: as in `GameTask`.
    Returns: one row an episode.
    Raises:
        UsageError, ModelError: a rule cannot play it, or policies do not fit together.
    """
    forget_programs()
    task = GameTask(game, uavs, vehicles, games, trace, radio, gateway)
    also = _service(task)
    if files:
        policies = [Policy.named(file) for file in files]
        begun, traces = games_of_runs(task, runs, episodes, policies[0].n, policies[0].zoom)
        scores, further = flown(policies, begun, traces, also)
    else:
        begun, traces = games_of_runs(task, runs, episodes, Shape.n, Shape.zoom)
        played = play_from(baseline(method), unseen_key(0), begun, traces, also)
        scores, further = played.steps, played.also
    measured = np.asarray(per_episode(scores)).T
    shares = None if further is None else np.asarray(further).mean(0)  # [episodes, 2]
    rows: list[Row] = []
    for number, values in enumerate(measured):
        run, episode = divmod(number, episodes)
        row: Row = {"task": game, "method": method, "run": run, "episode": episode} | named(values)
        if shares is not None:
            row |= {"carried": float(shares[number, 0]), "delivered": float(shares[number, 1])}
        rows.append(row)
    return rows


def games_of_runs(
    task: GameTask, runs: int, episodes: int, n: int, zoom: int, first: int = 0
) -> tuple[game.State, game.Trace | None]:
    """The starts of all runs of a task behind each other, and their vehicles where a trace is replayed.

    Args:
        n, zoom: of the maps.
        first: seed of the first run.
    """
    team, traffic = (task.uavs, task.uavs), (task.vehicles, task.vehicles)
    domain, shape = games_of(task.games, team, traffic, n, zoom)
    keys = [unseen_key(first + run) for run in range(runs)]
    if task.trace is None:
        return _joined([starts(key, episodes, shape, domain) for key in keys]), None
    trace, _ = open_trace(task.trace)
    replayed = [replayed_games(key, trace, episodes, shape, Setting(team, traffic)) for key in keys]
    return _joined([state for state, _ in replayed]), _joined([vehicles for _, vehicles in replayed])


def _joined(parts: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def _service(task: GameTask) -> Also | None:
    """Of a state, the shares of what vehicles ask for that are carried and (at most) delivered."""
    if task.radio is None:
        return None
    law = air(Radio(model=task.radio), ALTITUDE, 1)
    network = Network(air=law, gateways=(GATEWAY,) if task.gateway else ())
    demand, available = jnp.linspace(*DEMANDS, task.vehicles), jnp.full(task.uavs, BANDWIDTH)

    def shares(state: game.State) -> Float[Array, " 2"]:
        carried, delivered = serve(state, network, SIDE, demand, available)
        asked = jnp.sum(jnp.where(state.present, demand, 0.0))
        return jnp.stack([carried.sum(), delivered]) / asked

    return shares
