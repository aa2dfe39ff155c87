"""And with other weights? Sweeps of what the paper's selection figures hold fixed, one command each.

Every sweep keeps the paper's set-up at 80 UAVs but for one thing, and shows what becomes of the paper's claims:
two-sided selection held against NNM on the same drawn instances.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pa_csv

from skyrelay.core.files import atomic_path
from skyrelay.core.scenario import LEAST_DEMAND
from skyrelay.core.statistics import Interval, interval
from skyrelay.experiments.figures import FigureSpec, Rendered, Scale
from skyrelay.experiments.plotting import line, panels, save
from skyrelay.experiments.runner import Experiment, Row, Task
from skyrelay.experiments.selection import RULES, VEHICLES, compare

UAVS = 80
_SEEDS: Mapping[Scale, int] = {"smoke": 3, "fast": 20, "paper": 100}
_METHODS = ("two-sided", "nnm")


@dataclass(frozen=True)
class Point:
    """One setting of a sweep.

    Attributes:
        series: the line that it is on.
        x: where on the line.
        overrides: of the paper's scenario.
    """

    series: str
    x: float
    overrides: Sequence[str]


@dataclass(frozen=True)
class Sweep:
    """One thing that is varied.

    Attributes:
        name: of the figure.
        title: one line.
        x_label: of the axis.
        points: at full scale; ``smoke`` takes the first and the last of each series.
    """

    name: str
    title: str
    x_label: str
    points: Sequence[Point]

    def figure(self) -> FigureSpec:
        """For the command line."""
        return FigureSpec(self.name, self.title, partial(_experiment, self), partial(_render, self))


_Difference = Callable[[float, float], float]
_PANELS: Sequence[tuple[str, str, _Difference]] = (
    ("mean_qou", "QoU above NNM [%]", lambda ours, theirs: 100.0 * (ours / theirs - 1.0)),
    ("mean_qov", "QoV above NNM [%]", lambda ours, theirs: 100.0 * (ours / theirs - 1.0)),
    ("vehicles_per_uav", "vehicles per UAV above NNM [%]", lambda ours, theirs: 100.0 * (ours / theirs - 1.0)),
    ("uavs_selected_percent", "UAVs selected less than NNM [points]", lambda ours, theirs: theirs - ours),
)


def _experiment(sweep: Sweep, scale: Scale) -> Experiment:
    points = sweep.points if scale != "smoke" else _ends(sweep.points)
    tasks = [
        Task(
            f"{rule}-{point.series}-{point.x:g}-{seed}",
            {
                "overrides": [f"selection.candidates={rule}", *point.overrides],
                "vehicles": VEHICLES,
                "uavs": UAVS,
                "seed": seed,
                "methods": list(_METHODS),
                "labels": {"candidates": rule, "series": point.series, "x": point.x},
            },
        )
        for rule in RULES
        for point in points
        for seed in range(1, _SEEDS[scale] + 1)
    ]
    return Experiment(sweep.name, f"{compare.__module__}:{compare.__name__}", tasks)


def _ends(points: Sequence[Point]) -> list[Point]:
    series = dict.fromkeys(point.series for point in points)
    lines = [[point for point in points if point.series == name] for name in series]
    return [end for points_of_line in lines for end in (points_of_line[0], points_of_line[-1])]


def _render(sweep: Sweep, table: pa.Table, folder: Path) -> Rendered:
    rows: list[Row] = table.to_pylist()
    of = {(row["candidates"], row["series"], row["x"], row["method"], row["seed"]): row for row in rows}
    seeds = sorted({row["seed"] for row in rows})
    series = list(dict.fromkeys(row["series"] for row in rows))

    def difference(rule: str, name: str, x: float, metric: str, compared: _Difference) -> Interval:
        pairs = [tuple(of[rule, name, x, method, seed][metric] for method in _METHODS) for seed in seeds]
        return interval([compared(ours, theirs) for ours, theirs in pairs if ours is not None and theirs])

    summary, files = [], []
    for rule, meaning in RULES.items():
        title = f"{sweep.title}\nCandidates: {meaning}; {UAVS} UAVs, {VEHICLES} vehicles, {len(seeds)} seeds"
        figure, axes = panels(2, 2, title)
        for axis, (metric, label, compared) in zip(axes, _PANELS, strict=True):
            axis.axhline(0.0, color="grey", linewidth=0.8)
            for style, name in enumerate(series):
                xs = sorted({row["x"] for row in rows if row["series"] == name})
                values = [difference(rule, name, x, metric, compared) for x in xs]
                line(axis, xs, values, name, style)
                summary += [
                    {
                        "candidates": rule,
                        "series": name,
                        "x": x,
                        "measure": label,
                        "mean": value.mean,
                        "low_95": value.low,
                        "high_95": value.high,
                        "seeds": value.count,
                    }
                    for x, value in zip(xs, values, strict=True)
                ]
            axis.set_xlabel(sweep.x_label)
            axis.set_ylabel(label)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
        files += save(figure, folder, f"{sweep.name}-{rule}")
    path = folder / "summary.csv"
    with atomic_path(path) as beside:
        pa_csv.write_csv(pa.Table.from_pylist(summary), beside)
    return Rendered([path, *files])


def _weights(varied: int, weight: float) -> str:
    """Four weights, one as given, the others sharing what is left."""
    rest = (1.0 - weight) / 3.0
    return str([weight if number == varied else rest for number in range(4)])


_ATTRIBUTES = ("bandwidth / demand", "battery / payment", "reputation", "closeness")

WEIGHTS = Sweep(
    "selection-weights",
    "One weight of QoU and QoV varied, the others equal",
    "weight",
    [
        Point(
            name,
            weight,
            [f"selection.qou_weights={_weights(number, weight)}", f"selection.qov_weights={_weights(number, weight)}"],
        )
        for number, name in enumerate(_ATTRIBUTES)
        for weight in (0.0, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
    ],
).figure()

DISTANCE = Sweep(
    "selection-distance",
    "Max distance varied",
    "max distance [km]",
    [
        Point("max distance", kilometres, [f"selection.max_distance={1000.0 * kilometres}"])
        for kilometres in (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 15.0)
    ],
).figure()


def _demand(low: float, high: float) -> list[str]:
    return [f"demand.bandwidth=[{max(low, LEAST_DEMAND)}, {high}]", f"selection.max_demand={high}"]


DEMAND = Sweep(
    "selection-demand",
    "Demand distribution varied (uniform)",
    "mean demand [Mbit/s]",
    [
        Point(name, mean, _demand(mean * (1.0 - spread), mean * (1.0 + spread)))
        for name, spread in (
            ("equal", 0.0),
            ("mean +- 30 %", 0.3),
            ("mean +- 60 % (as the paper's)", 0.6),
            ("0...2 means", 1.0),
        )
        for mean in (0.5, 1.0, 1.75, 2.5, 3.5, 5.0, 7.0)
    ],
).figure()

ZONES = Sweep(
    "selection-zones",
    "Number of zones varied",
    "side of a zone [km]",
    [
        Point("zones", round(50.0 / columns, 3), [f"zones.columns={columns}", f"zones.rows={columns}"])
        for columns in (1, 2, 3, 4, 5, 6, 8, 10, 13, 17)
    ],
).figure()
