"""Does one policy do for all? The shipped generalist beside policies trained for one setting, and beside rules.

Not in the paper, which trains a network for each number of UAVs and vehicles. Four groups of unseen games: numbers of
UAVs and vehicles; zones of other sizes about the same range; vehicles of a real city; UAVs that drop out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pa_csv

from skyrelay.core.files import atomic_path
from skyrelay.core.statistics import Interval, interval
from skyrelay.experiments.figures import FigureSpec, Rendered, Scale
from skyrelay.experiments.generalization_tasks import SPECIALIST
from skyrelay.experiments.plotting import line, panels, save
from skyrelay.experiments.runner import Experiment, Row, Task
from skyrelay.store.cid import cid_of

GENERALIST = "generalist"
MEASURES = (("coverage", "coverage"), ("connectivity", "connectivity"))
RULES = ("static", "centroid-linked", "cover")
TRACE = "bologna"
DROP_OUT = 0.005
"""Per UAV and step: of six UAVs, two or three leave in an episode."""


@dataclass(frozen=True)
class Size:
    """How much of everything there is at a scale."""

    uavs: Sequence[int]
    vehicles: Sequence[int]
    ratios: Sequence[float]
    episodes: int
    steps: int


_SCALES: Mapping[Scale, Size] = {
    "smoke": Size((2,), (5,), (3.0,), 10, 12_800),
    "fast": Size((2, 8), (5, 40), (1.5, 3.0), 200, 200_000),
    "paper": Size((2, 3, 4, 5, 6, 7, 8), (5, 10, 20, 30, 40), (1.5, 1.75, 2.0, 2.25, 2.5, 2.75, 3.0), 1000, 400_000),
}
_RATIO_TEAM, _RATIO_VEHICLES = 4, 20


def experiment(scale: Scale) -> Experiment:
    """One task for each player and kind of games."""
    size = _SCALES[scale]
    cid = str(cid_of((files("skyrelay.data") / "policies" / f"{GENERALIST}.onnx").read_bytes()))
    tasks = []

    def add(group: str, players: Iterable[str], **games: Any) -> None:
        settings: dict[str, Any] = {
            "uavs": _RATIO_TEAM,
            "vehicles": _RATIO_VEHICLES,
            "ratio": 2.0,
            "drop_out": 0.0,
            "trace": None,
        }
        settings |= {"group": group, "episodes": size.episodes, "steps": size.steps} | games
        for player in players:
            name = f"{group}-u{settings['uavs']}-v{settings['vehicles']}-r{settings['ratio']:g}-{player}"
            own = {"player": player, "cid": cid if player == GENERALIST else None}
            tasks.append(Task(name, settings | own))

    for uavs in size.uavs:
        for vehicles in size.vehicles:
            add("sizes", (GENERALIST, SPECIALIST), uavs=uavs, vehicles=vehicles)
    for ratio in size.ratios:
        add("scales", (GENERALIST, SPECIALIST, *RULES), ratio=ratio)
    for uavs in size.uavs:
        add("trace", (GENERALIST, *RULES), uavs=uavs, trace=TRACE)
        add("drop-outs", (GENERALIST, *RULES), uavs=uavs, drop_out=DROP_OUT)
    packages = ("numpy", "jax", "jaxlib", "equinox", "optax", "onnxruntime")
    return Experiment("generalization", "skyrelay.experiments.generalization_tasks:fly", tasks, packages)


def render(table: pa.Table, folder: Path) -> Rendered:
    """The figure, and every mean and paired difference as CSV."""
    rows: list[Row] = table.to_pylist()
    return Rendered([*_summary(rows, folder), *_draw(rows, folder)])


def differences(rows: Sequence[Row], group: str, uavs: int, vehicles: int, ratio: float, measure: str) -> Interval:
    """Generalist minus specialist over the same episodes, in percentage points."""
    ours = _values(rows, group, GENERALIST, uavs, vehicles, ratio, measure)
    theirs = _values(rows, group, SPECIALIST, uavs, vehicles, ratio, measure)
    return interval([100.0 * (a - b) for a, b in zip(ours, theirs, strict=True)])


def _values(
    rows: Sequence[Row], group: str, player: str, uavs: int, vehicles: int, ratio: float, measure: str
) -> list[float]:
    """[episodes] in their order."""
    wanted = (group, player, uavs, vehicles, ratio)
    return [
        row[measure]
        for row in rows
        if (row["group"], row["player"], row["uavs"], row["vehicles"], row["ratio"]) == wanted
    ]


def _settings(rows: Sequence[Row], group: str) -> list[tuple[int, int, float]]:
    """Numbers of UAVs and vehicles, and ratio, of a group's games."""
    return list(dict.fromkeys((r["uavs"], r["vehicles"], r["ratio"]) for r in rows if r["group"] == group))


def _players(rows: Sequence[Row], group: str) -> list[str]:
    return list(dict.fromkeys(row["player"] for row in rows if row["group"] == group))


def _summary(rows: Sequence[Row], folder: Path) -> list[Path]:
    means, against = [], []
    for group in dict.fromkeys(row["group"] for row in rows):
        for uavs, vehicles, ratio in _settings(rows, group):
            place = {"games": group, "uavs": uavs, "vehicles": vehicles, "ratio": ratio}
            for measure in ("return", "coverage", "connectivity", "connectivity_neighbor"):
                for player in _players(rows, group):
                    value = interval(_values(rows, group, player, uavs, vehicles, ratio, measure))
                    means.append(place | {"player": player, "measure": measure} | _columns(value))
            if SPECIALIST in _players(rows, group):
                for measure, _ in MEASURES:
                    value = differences(rows, group, uavs, vehicles, ratio, measure)
                    against.append(place | {"measure": measure} | _columns(value))
    return [_write(folder / "summary.csv", means), _write(folder / "against-specialists.csv", against)]


def _draw(rows: Sequence[Row], folder: Path) -> list[Path]:
    episodes = 1 + max(row["episode"] for row in rows)
    title = f"One policy for all: the generalist on unseen games, {episodes} episodes a point, 95 % intervals"
    figure, axes = panels(4, 2, title)
    cells = iter(axes)
    sizes = _settings(rows, "sizes")
    for measure, label in MEASURES:
        axis = next(cells)
        axis.axhspan(-1.0, 1.0, color="grey", alpha=0.2, linewidth=0, label="within 1 point")
        for style, vehicles in enumerate(sorted({size[1] for size in sizes})):
            uavs = sorted({size[0] for size in sizes})
            values = [differences(rows, "sizes", number, vehicles, 2.0, measure) for number in uavs]
            line(axis, uavs, values, f"{vehicles} vehicles", style)
        axis.set_xticks(uavs)
        axis.set_xlabel("UAVs")
        axis.set_ylabel(f"{label}: generalist\nminus specialist [points]")
        axis.legend(fontsize=7)
    for group, x_label, which, heading in (
        ("scales", "zone side / range", 2, f"{_RATIO_TEAM} UAVs, {_RATIO_VEHICLES} vehicles"),
        ("trace", "UAVs", 0, f"Vehicles of the trace {TRACE}"),
        ("drop-outs", "UAVs at the start", 0, f"Each UAV leaves with {100 * DROP_OUT:g} % a step"),
    ):
        settings = _settings(rows, group)
        for measure, label in MEASURES:
            axis = next(cells)
            for style, player in enumerate((GENERALIST, SPECIALIST, *RULES)):
                if player in _players(rows, group):
                    values = [interval(_values(rows, group, player, *setting, measure)) for setting in settings]
                    line(axis, [setting[which] for setting in settings], values, player, style, faint=style > 1)
            axis.set_xticks([setting[which] for setting in settings])
            axis.set_title(heading, fontsize=9)
            axis.set_xlabel(x_label)
            axis.set_ylabel(label)
            axis.set_ylim(top=1.01)
            axis.legend(fontsize=7)
    return save(figure, folder, "generalization")


def _columns(value: Interval) -> dict[str, Any]:
    return {"mean": value.mean, "low_95": value.low, "high_95": value.high, "episodes": value.count}


def _write(path: Path, rows: Sequence[Row]) -> Path:
    with atomic_path(path) as beside:
        pa_csv.write_csv(pa.Table.from_pylist(list(rows)), beside)
    return path


FIGURE = FigureSpec("generalization", "One policy for every size, scale and trace", experiment, render)
