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
    folder = Path(path)
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

    chosen = {key: _name(value) for key, value in (("coordination.policy", policy), ("selection.method", method))}
    sets = dict(settings or {}) | {key: name for key, name in chosen.items() if name is not None}
    if isinstance(scenario, Scenario):
        if sets or seed is not None:
            raise UsageError("run", None, "a scenario's name or file beside seed, policy, method or settings")
        config = scenario
    else:
        config = load_scenario(scenario, [f"{key}={_toml(value)}" for key, value in sets.items()], seed)
    target = Path(out) if out is not None else Path("runs") / f"{config.name}-{config.seed}"

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
) -> dict[str, Any]:
    """Play unseen episodes and measure them, as `skyrelay evaluate` and `skyrelay baseline` do.

    Args:
        player: a shipped policy's name, an ONNX file, a `Policy`, a baseline's name, or a
            `skyrelay.baselines.player.Player`.
        uavs, vehicles: how many, or from and to.
        games, seed: the same give the same episodes to every player.
    Returns: ``{"return": {"mean": ..., "low": ..., "high": ...}, "coverage": ..., ...}``, 95 % intervals over episodes.
    Raises:
        SkyRelayError: naming what does not fit, or is not there.
    """
    from skyrelay.baselines.catalogue import BASELINES, baseline
    from skyrelay.baselines.player import play_from
    from skyrelay.coordination.settings import Shape
    from skyrelay.learning.evaluation import evaluate_policy, starts, summary, unseen_key
    from skyrelay.learning.presets import games_of

    _require_games(games)
    if not 1 <= episodes <= MOST_EPISODES:
        raise UsageError("episodes", episodes, f"1 to {MOST_EPISODES:,}")
    if isinstance(player, str):
        _name(player)
        known = player in BASELINES or (plugins.is_code(player) and not Path(player).exists())
        player = baseline(player) if known else Policy.named(player)
    n, zoom = (player.n, player.zoom) if isinstance(player, Policy) else (Shape.n, Shape.zoom)
    domain, shape = games_of(games, _bounds(uavs), _bounds(vehicles), n, zoom)  # type: ignore[arg-type]
    games_begun = starts(unseen_key(seed), episodes, shape, domain)
    if isinstance(player, Policy):
        return evaluate_policy(player, games_begun)
    return summary(play_from(player, unseen_key(seed), games_begun).measures)


def compare(runs: Sequence[str | Path], figure: str | Path | None = None) -> pa.Table:
    """Runs beside each other, as `skyrelay compare` does: means over seeds, paired differences, 95 % intervals.

    Args:
        runs: folders; the first one's group is what the others are held against.
        figure: also draw it there.
    """
    from skyrelay.report.compare import draw, groups_of, table

    groups = groups_of([Path(run) for run in runs], hovering=True)
    if figure is not None:
        draw(groups, Path(figure))
    rows = table(groups)
    columns = dict.fromkeys(key for row in rows for key in row)
    return pa.table({name: [row.get(name) for row in rows] for name in columns})


def policies() -> list[str]:
    """Names of the policies inside the package."""
    return builtin_policies()


def _require_games(name: str) -> None:
    if name not in GAMES:
        raise UsageError("games", name, f"one of {', '.join(GAMES)}")


def _bounds(value: int | tuple[int, int]) -> tuple[int, int]:
    return (value, value) if isinstance(value, int | np.integer) else (value[0], value[1])


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
