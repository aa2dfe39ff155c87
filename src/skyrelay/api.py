"""What `import skyrelay as sr` offers: the whole of it by a few calls; see docs/reference/python.md."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from skyrelay.core import plugins
from skyrelay.core.errors import UsageError
from skyrelay.core.names import GAMES, GamesName
from skyrelay.core.progress import Progress, Silent
from skyrelay.core.scenario import Scenario, load_scenario
from skyrelay.policy import Policy, builtin_policies
from skyrelay.runfolder import new_run_folder
from skyrelay.runfolder.reader import read_scenario, read_summary, read_table, require_folder
from skyrelay.runfolder.schema import SCHEMAS, Summary

if TYPE_CHECKING:
    from skyrelay.coordination.pettingzoo import UavCoordination
    from skyrelay.coordination.vector import UavVector

MOST_EPISODES = 100_000
"""Of one evaluation, as on the command line."""


@dataclass(frozen=True)
class RunFolder:
    """A run's record; each table is read, and checked, when it is first asked for.

    Attributes:
        path: of the folder.
    """

    path: Path

    @cached_property
    def summary(self) -> Summary:
        """The figures of the whole run."""
        return read_summary(self.path)

    @cached_property
    def scenario(self) -> Scenario:
        """As resolved when the run was made."""
        return read_scenario(self.path)

    @cached_property
    def vehicles(self) -> pa.Table:
        """Where every vehicle was at each step, by whom it was served, and whether it was in range."""
        return self.table("vehicles")

    @cached_property
    def uavs(self) -> pa.Table:
        """Where every UAV was at each step, its battery, its zone and its move."""
        return self.table("uavs")

    @cached_property
    def metrics(self) -> pa.Table:
        """Coverage, connectivity, bandwidth and energy at each step, by zone; zone 0 is the whole area."""
        return self.table("metrics")

    @cached_property
    def proposals(self) -> pa.Table:
        """Who proposed to whom in which period, and what became of it."""
        return self.table("proposals")

    def table(self, name: str) -> pa.Table:
        """A table of docs/reference/run-folder.md by its name, as an Arrow table: pandas, Polars and DuckDB take it.

        Raises:
            UsageError: there is none of that name.
            RunFolderError: it is not there, cannot be read, or a column or value does not fit.
        """
        if name not in SCHEMAS:
            raise UsageError("table", name, f"one of {', '.join(SCHEMAS)}")
        return pa.table(dict(read_table(self.path, name)))


def load_run(path: str | Path) -> RunFolder:
    """A run folder's record.

    Raises:
        RunFolderError: the folder is none of a run's.
    """
    folder = _path("load_run", path)
    require_folder(folder)
    run = RunFolder(folder)
    _ = run.summary
    return run


def run(
    scenario: str | Path | Scenario = "bologna",
    *,
    out: str | Path | None = None,
    seed: int | None = None,
    policy: str | Callable[..., Any] | None = None,
    method: str | Callable[..., Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    force: bool = False,
    report: bool = True,
    progress: Progress | None = None,
) -> RunFolder:
    """Play a scenario and leave its record, as `skyrelay run` does.

    Args:
        scenario: a built-in one's name, a file, or a `Scenario`, which takes no ``seed`` or ``settings``.
        out: the folder; left out: ``runs/NAME-SEED``.
        seed: replaces the scenario's.
        policy: who decides: a name as `skyrelay run --policy` takes it, or a function from a `Sight` to an action.
        method: who selects: a name as `skyrelay run --method` takes it, or a function of vehicles, UAVs and settings.
        settings: keys of the scenario and their values, e.g. ``{"fleet.uavs": 20}``.
        force: replace a run folder that is already there.
        report: also draw charts and the page.
        progress: is told how far it is.
    Raises:
        SkyRelayError: naming what does not fit, or is not there.
    """
    from skyrelay.report import write_figures, write_report
    from skyrelay.simulation import play

    if not isinstance(scenario, Scenario):
        _path("run: scenario", scenario)
    if seed is not None:
        _require_whole("run", seed=seed)
    if settings is not None and not isinstance(settings, Mapping):
        raise UsageError("run: settings", settings, 'keys and values, such as {"fleet.uavs": 20}')
    chosen = {key: _name(value) for key, value in (("coordination.policy", policy), ("selection.method", method))}
    sets = dict(settings or {}) | {key: name for key, name in chosen.items() if name is not None}
    if isinstance(scenario, Scenario):
        if sets or seed is not None:
            raise UsageError("run", None, "a scenario's name or file beside seed, policy, method or settings")
        config = scenario
    else:
        config = load_scenario(scenario, [f"{key}={_toml(value)}" for key, value in sets.items()], seed)
    target = _path("run: out", out) if out is not None else Path("runs") / f"{config.name}-{config.seed}"

    def finish(folder: Path) -> None:
        if report:
            write_figures(folder)
            write_report(folder)

    with new_run_folder(target, replace=force) as folder:
        play(config, folder, progress or Silent(), finish)
    return load_run(target)


def make(
    name: GamesName = "paper",
    *,
    uavs: int = 3,
    vehicles: int = 20,
    steps: int = 100,
    n: int = 11,
    render_mode: str | None = None,
) -> UavCoordination:
    """The game of coordination as a PettingZoo environment.

    Args:
        name: of the games: one scale, many scales, buildings, or batteries.
        uavs, vehicles: how many.
        steps: of an episode.
        n: side of the maps [cells], odd.
        render_mode: ``"rgb_array"``: `render()` draws.
    Raises:
        UsageError: there are no such games, or a number does not fit.
    """
    from dataclasses import replace

    from skyrelay.coordination.pettingzoo import UavCoordination
    from skyrelay.learning.presets import games_of

    _require_games(name)
    _require_whole("make", uavs=uavs, vehicles=vehicles, steps=steps, n=n)
    domain, shape = games_of(name, (uavs, uavs), (vehicles, vehicles), n)
    return UavCoordination(replace(shape, steps=steps), domain, render_mode=render_mode)


def make_vec(
    name: GamesName = "paper", *, games: int = 64, uavs: int = 3, vehicles: int = 20, steps: int = 100, n: int = 11
) -> UavVector:
    """Many games side by side as one Gymnasium vector environment, each UAV of each game a row of its own.

    Args:
        name: of the games: paper, obstacles or energy.
        games: side by side.
        uavs, vehicles, steps, n: as `make`.
    Raises:
        UsageError: there are no such games, or a number does not fit.
    """
    from dataclasses import replace

    from skyrelay.coordination.vector import UavVector
    from skyrelay.learning.presets import games_of

    _require_games(name)
    _require_whole("make_vec", games=games, uavs=uavs, vehicles=vehicles, steps=steps, n=n)
    domain, shape = games_of(name, (uavs, uavs), (vehicles, vehicles), n)
    return UavVector(replace(shape, steps=steps), domain, games)


def evaluate(
    player: str | Policy | Any = "generalist",
    *,
    uavs: int | tuple[int, int] = 3,
    vehicles: int | tuple[int, int] = 20,
    games: str = "paper",
    episodes: int = 200,
    seed: int = 0,
    trace: str | Path | None = None,
) -> dict[str, Any]:
    """Play unseen episodes and measure them, as `skyrelay evaluate` and `skyrelay baseline` do.

    Args:
        player: a shipped policy's name, an ONNX file, a `Policy`, a baseline's name, or a
            `skyrelay.baselines.player.Player`.
        uavs, vehicles: how many, or from and to.
        games, seed: the same give the same episodes to every player.
        trace: a name or a file: its vehicles are replayed, in squares of its area, each two ranges wide.
    Returns: ``{"return": {"mean": ..., "low": ..., "high": ...}, "coverage": ..., ...}``, 95 % intervals over episodes.
    Raises:
        SkyRelayError: naming what does not fit, or is not there.
    """
    from skyrelay.baselines.catalogue import BASELINES, baseline
    from skyrelay.baselines.player import Player, play_from
    from skyrelay.coordination.replay import Setting, replayed_games
    from skyrelay.coordination.settings import Shape
    from skyrelay.learning.evaluation import evaluate_policy, starts, summary, unseen_key
    from skyrelay.learning.presets import games_of
    from skyrelay.mobility.tracks import open_trace

    _require_games(games)
    _require_whole("evaluate", episodes=episodes, seed=seed)
    team, traffic = _bounds("uavs", uavs), _bounds("vehicles", vehicles)
    if not 1 <= episodes <= MOST_EPISODES:
        raise UsageError("episodes", episodes, f"1 to {MOST_EPISODES:,}")
    if isinstance(player, str):
        _name(player)
        known = player in BASELINES or (plugins.is_code(player) and not Path(player).exists())
        player = baseline(player) if known else Policy.named(player)
    if not isinstance(player, Policy | Player):
        raise UsageError("evaluate: player", player, "a name, a file, a Policy or a skyrelay.baselines.player.Player")
    n, zoom = (player.n, player.zoom) if isinstance(player, Policy) else (Shape.n, Shape.zoom)
    domain, shape = games_of(games, team, traffic, n, zoom)  # type: ignore[arg-type]
    vehicles_of: Any = None
    if trace is None:
        games_begun = starts(unseen_key(seed), episodes, shape, domain)
    elif shape.walls or shape.energy:
        raise UsageError("evaluate: games", games, "paper or varied beside a trace")
    else:
        replayed = open_trace(str(_path("evaluate: trace", trace)))[0]
        games_begun, vehicles_of = replayed_games(unseen_key(seed), replayed, episodes, shape, Setting(team, traffic))
    if isinstance(player, Policy):
        return evaluate_policy(player, games_begun, vehicles_of)
    return summary(play_from(player, unseen_key(seed), games_begun, vehicles_of).measures)


def compare(runs: Sequence[str | Path], figure: str | Path | None = None) -> pa.Table:
    """Runs beside each other, as `skyrelay compare` does: means over seeds, paired differences, 95 % intervals.

    Args:
        runs: folders; the first one's group is what the others are held against.
        figure: also draw it there.
    """
    from skyrelay.report.compare import draw, groups_of, table

    if isinstance(runs, str) or not isinstance(runs, Sequence):
        raise UsageError("compare: runs", runs, "a list of run folders")
    groups = groups_of([_path("compare: runs", run) for run in runs], hovering=True)
    if figure is not None:
        draw(groups, _path("compare: figure", figure))
    rows = table(groups)
    columns = dict.fromkeys(key for row in rows for key in row)
    return pa.table({name: [row.get(name) for row in rows] for name in columns})


def policies() -> list[str]:
    """Names of the policies inside the package."""
    return builtin_policies()


def _require_games(name: str) -> None:
    if name not in GAMES:
        raise UsageError("games", name, f"one of {', '.join(GAMES)}")


def _require_whole(call: str, **numbers: object) -> None:
    for name, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise UsageError(f"{call}: {name}", value, "a whole number")


def _bounds(name: str, value: object) -> tuple[int, int]:
    """From and to."""
    both = value if isinstance(value, tuple | list) else (value, value)
    if len(both) != 2:
        raise UsageError(f"evaluate: {name}", value, "a whole number, or two: from and to")
    _require_whole("evaluate", **{name: both[0]})
    _require_whole("evaluate", **{name: both[1]})
    return int(both[0]), int(both[1])


def _path(place: str, value: object) -> Path:
    if not isinstance(value, str | Path):
        raise UsageError(place, value, "a path or a name, as text or a Path")
    return Path(value)


def _name(value: str | Callable[..., Any] | None) -> str | None:
    """A name for the scenario; who names or hands over code in a call wants it loaded."""
    if value is None or isinstance(value, str):
        if value is not None:
            plugins.allow(value)
        return value
    return plugins.given(value)


def _toml(value: Any) -> str:
    """A value as TOML on one line: JSON is, for text, numbers and lists of them."""
    return json.dumps(value)
