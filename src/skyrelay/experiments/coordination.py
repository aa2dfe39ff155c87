"""The paper's coordination figures: learning curves, centralised against decentralised, coverage and connectivity.

The scales: "smoke" shows that everything runs, with too few seeds and steps for a verdict to mean much; "fast" is the
whole set with the preset ``fast`` (200,000 steps, tested 25 times as the paper's million is); "paper" is the paper's
network, table and 1,000,000 steps, which wants a GPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter, MaxNLocator

from skyrelay.core.files import atomic_path
from skyrelay.core.statistics import Interval
from skyrelay.experiments.coordination_findings import findings
from skyrelay.experiments.coordination_results import Results
from skyrelay.experiments.coordination_tasks import CENTRALIZED, OURS
from skyrelay.experiments.figures import FigureSpec, Rendered, Scale
from skyrelay.experiments.plotting import line, panels, points, save
from skyrelay.experiments.runner import Experiment, Task
from skyrelay.store.cid import cid_of

BASELINES = (
    *("static", "random", "centroid", "centroid-linked", "cover"),
    *("pso-placed", "pso", "pso-10", "planner", "clairvoyant"),
)
GENERALIST = "generalist"
"""The shipped policy, which looks ahead; what is trained here sees what the paper's networks see."""
SHOWN = (OURS, GENERALIST, "pso-placed", "pso-10", "centroid-linked", "cover", "planner")
"""In the figure of coverage and connectivity; its CSV has all."""
COMPARED = (2, 3)
"""Team sizes at which the paper trains the centralised method, with 20 vehicles."""
PAPER_NETWORKS = {
    (OURS, 2): ("1.692M", "1 MFLOP"),
    (OURS, 5): ("1.692M", "1 MFLOP"),
    (CENTRALIZED, 2): ("1.692M", "1 MFLOP"),
    (CENTRALIZED, 5): ("9.31M", "41 MFLOP"),
}
"""What the paper says of its actors, by method and team size."""
MEASURES = (
    ("coverage", "coverage"),
    ("connectivity_neighbor", "connectivity: a neighbour each"),
    ("connectivity", "connectivity: a path between all"),
)


@dataclass(frozen=True)
class Size:
    """How much of everything there is at a scale."""

    preset: str
    uavs: Sequence[int]
    vehicles: Sequence[int]
    seeds: int
    steps: int
    test_every: int
    test_episodes: int
    episodes: int


_SCALES: dict[Scale, Size] = {
    "smoke": Size("fast", (2, 3), (5, 20), 2, 12_800, 3_200, 20, 20),
    "fast": Size("fast", (2, 3, 4, 5), (5, 10, 15, 20), 5, 200_000, 9_600, 40, 200),
    "paper": Size("paper", (2, 3, 4, 5), (5, 10, 15, 20), 5, 1_000_000, 40_000, 40, 200),
}


def experiment(scale: Scale) -> Experiment:
    """Every training and every baseline at every size: one task each, seeds of one training one after the other."""
    size = _SCALES[scale]
    most = max(size.vehicles)
    tasks = [Task("networks", {"kind": "count", "uavs": [2, 3, 4, 5]})]
    trainings = [(OURS, uavs, vehicles) for uavs in size.uavs for vehicles in size.vehicles]
    trainings += [(CENTRALIZED, uavs, most) for uavs in COMPARED]
    for method, uavs, vehicles in trainings:
        common = {
            "kind": "learn",
            "method": method,
            "preset": size.preset,
            "uavs": uavs,
            "vehicles": vehicles,
            "steps": size.steps,
            "test_every": size.test_every,
            "test_episodes": size.test_episodes,
            "flown": list(size.vehicles) if vehicles == most and uavs in COMPARED else [vehicles],
            "episodes": size.episodes,
        }
        name = f"{method.split()[0]}-u{uavs}-v{vehicles}"
        tasks += [Task(f"{name}-seed{seed}", {**common, "seed": seed}) for seed in range(size.seeds)]
    cid = str(cid_of((files("skyrelay.data") / "policies" / f"{GENERALIST}.onnx").read_bytes()))
    for uavs in size.uavs:
        for vehicles in size.vehicles:
            flown: dict[str, Any] = {"name": GENERALIST, "cid": cid, "uavs": uavs, "vehicles": vehicles}
            tasks.append(Task(f"{GENERALIST}-u{uavs}-v{vehicles}", {"kind": "fly", **flown, "episodes": size.episodes}))
            for baseline in BASELINES:
                settings: dict[str, Any] = {"name": baseline, "uavs": uavs, "vehicles": vehicles}
                tasks.append(
                    Task(f"{baseline}-u{uavs}-v{vehicles}", {"kind": "play", **settings, "episodes": size.episodes})
                )
    packages = ("numpy", "scipy", "jax", "jaxlib", "equinox", "optax", "onnxruntime")
    return Experiment("coordination", "skyrelay.experiments.coordination_tasks:work", tasks, packages)


def render(table: pa.Table, folder: Path) -> Rendered:
    """The figures, their numbers as CSV, and the claims."""
    results = Results(table.to_pylist())
    files = [
        _write(folder / "learning-curves.csv", _curve_rows(results)),
        _write(folder / "coverage-connectivity.csv", _measure_rows(results)),
        _write(folder / "steps-to-connectivity.csv", _step_rows(results)),
        _write(folder / "returns.csv", _return_rows(results)),
        _write(folder / "networks.csv", _network_rows(results)),
    ]
    files += _draw_curves(results, folder)
    files += _draw_centralized(results, folder)
    files += _draw_measures(results, folder)
    files += _draw_measures_compared(results, folder)
    files += _draw_steps(results, folder)
    return Rendered(files, findings(results))


def _draw_curves(results: Results, folder: Path) -> list[Path]:
    columns = min(2, len(results.uavs))
    figure, axes = panels(
        -(-len(results.uavs) // columns), columns, f"Greedy return while learning, {results.seeds} seeds"
    )
    for axis, uavs in zip(axes, results.uavs, strict=False):
        for style, vehicles in enumerate(results.vehicles):
            steps, curve = results.curve(OURS, uavs, vehicles)
            line(axis, steps, curve, f"{vehicles} vehicles", style)
        _finish_curves(axis, uavs)
    axes[0].legend(fontsize=8)
    return save(figure, folder, "learning-curves")


def _draw_centralized(results: Results, folder: Path) -> list[Path]:
    most = max(results.vehicles)
    figure, axes = panels(1, len(COMPARED), f"Greedy return while learning, {most} vehicles, {results.seeds} seeds")
    for axis, uavs in zip(axes, COMPARED, strict=True):
        for style, method in enumerate((OURS, CENTRALIZED)):
            steps, curve = results.curve(method, uavs, most)
            line(axis, steps, curve, method, style)
        _finish_curves(axis, uavs)
    axes[0].legend(fontsize=8)
    return save(figure, folder, "centralised")


def _draw_measures(results: Results, folder: Path) -> list[Path]:
    """Teams of random size, each network flown with the number of vehicles that it was trained for."""
    numbers = results.experiment_numbers
    sizes = f"{min(results.uavs)} to {max(results.uavs)}"
    figure, axes = panels(len(numbers), len(MEASURES), f"Teams of {sizes} UAVs at random; 95 % intervals to 1")
    cells = iter(axes)
    for number in numbers:
        for measure, label in MEASURES:
            axis = next(cells)
            for style, method in enumerate(SHOWN):
                values = [results.experiments(method, vehicles, measure, number) for vehicles in results.vehicles]
                points(axis, results.vehicles, values, method, style, _beside(style, len(SHOWN), results.vehicles))
            _fit(axis, top=1.005)
            axis.set_xticks(results.vehicles)
            axis.set_xlabel("vehicles")
            axis.set_ylabel(label)
            axis.set_title(f"{number} experiments a point", fontsize=9)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return save(figure, folder, "coverage-connectivity")


def _draw_measures_compared(results: Results, folder: Path) -> list[Path]:
    """Teams of 2 and 3: both methods trained with 20 vehicles, flown with each number."""
    number, most = max(results.experiment_numbers), max(results.vehicles)
    title = f"Teams of 2 and 3 UAVs, trained with {most} vehicles; {number} experiments a point, 95 % intervals to 1"
    figure, axes = panels(1, len(MEASURES), title)
    for axis, (measure, label) in zip(axes, MEASURES, strict=True):
        for style, method in enumerate((OURS, CENTRALIZED, "pso-placed", "pso-10")):
            values = [
                results.experiments(method, vehicles, measure, number, COMPARED, most) for vehicles in results.vehicles
            ]
            points(axis, results.vehicles, values, method, style, _beside(style, 4, results.vehicles))
        _fit(axis, top=1.005)
        axis.set_xticks(results.vehicles)
        axis.set_xlabel("vehicles")
        axis.set_ylabel(label)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return save(figure, folder, "coverage-connectivity-centralised")


def _beside(style: int, count: int, ticks: Sequence[float]) -> float:
    """How far from its tick the one of several methods is drawn: all of them together take a third of the way."""
    apart = min((b - a for a, b in pairwise(sorted(ticks))), default=1.0)
    return (style - (count - 1) / 2) * apart / (3 * max(count - 1, 1))


def _draw_steps(results: Results, folder: Path) -> list[Path]:
    titles = (
        ("connected_step", "step of a path between all"),
        ("linked_and_covered_step", "step of neighbours and full coverage"),
    )
    figure, axes = panels(
        1, 2, f"{OURS}, unseen episodes, {results.seeds} seeds; episodes that never get there left out"
    )
    for axis, (measure, label) in zip(axes, titles, strict=True):
        for style, uavs in enumerate(results.uavs):
            values = [results.over_seeds(OURS, uavs, vehicles, measure) for vehicles in results.vehicles]
            line(axis, results.vehicles, values, f"{uavs} UAVs", style)
        _fit(axis, bottom=0.0)
        axis.set_xticks(results.vehicles)
        axis.set_xlabel("vehicles")
        axis.set_ylabel(label)
    axes[0].legend(fontsize=8)
    return save(figure, folder, "steps-to-connectivity")


def _finish_curves(axis: Axes, uavs: int) -> None:
    axis.axhspan(-5.0, -4.0, color="grey", alpha=0.25, linewidth=0, label="the paper's level")
    _fit(axis, top=2.0)
    axis.set_title(f"{uavs} UAVs", fontsize=10)
    axis.set_xlabel("steps of the team")
    axis.xaxis.set_major_locator(MaxNLocator(5))
    axis.xaxis.set_major_formatter(EngFormatter())
    axis.set_ylabel("return of an episode")


def _fit(axis: Axes, *, bottom: float | None = None, top: float | None = None) -> None:
    """Show the means whole; an interval of two seeds may reach beyond the frame."""
    means = np.concatenate([np.asarray(drawn.get_ydata(), dtype=float) for drawn in axis.get_lines()])
    low, high = float(np.nanmin(means)), float(np.nanmax(means))
    room = 0.1 * (high - low) + 1e-3
    axis.set_ylim(low - room if bottom is None else bottom, high + room if top is None else top)


def _curve_rows(results: Results) -> list[dict[str, Any]]:
    return [
        {"method": method, "uavs": uavs, "vehicles": vehicles, "steps": step} | _spread(value)
        for method, uavs, vehicles in results.trainings
        for step, value in zip(*results.curve(method, uavs, vehicles), strict=True)
    ]


def _measure_rows(results: Results) -> list[dict[str, Any]]:
    most = max(results.vehicles)
    rows = []
    for number in results.experiment_numbers:
        for vehicles in results.vehicles:
            for measure, _ in MEASURES:
                for method in (OURS, GENERALIST, *BASELINES):
                    value = results.experiments(method, vehicles, measure, number)
                    row = {"teams": "all", "method": method, "vehicles": vehicles, "measure": measure}
                    rows.append({**row, "experiments": number} | _spread(value))
                for method in (OURS, CENTRALIZED, GENERALIST, *BASELINES):
                    value = results.experiments(method, vehicles, measure, number, COMPARED, most)
                    row = {"teams": "2 and 3", "method": method, "vehicles": vehicles, "measure": measure}
                    rows.append({**row, "experiments": number} | _spread(value))
    return rows


def _step_rows(results: Results) -> list[dict[str, Any]]:
    rows = []
    for method in (OURS, GENERALIST, *BASELINES):
        for uavs in results.uavs:
            for vehicles in results.vehicles:
                for measure in ("connected_step", "linked_and_covered_step"):
                    value = results.over_seeds(method, uavs, vehicles, measure)
                    reached = results.share_reached(method, uavs, vehicles, measure)
                    row = {"method": method, "uavs": uavs, "vehicles": vehicles, "measure": measure}
                    rows.append(row | _spread(value) | {"share_of_episodes_reached": reached})
    return rows


def _return_rows(results: Results) -> list[dict[str, Any]]:
    return [
        {"method": method, "uavs": uavs, "vehicles": vehicles} | _spread(results.over_episodes(method, uavs, vehicles))
        for method in (OURS, GENERALIST, *BASELINES)
        for uavs in results.uavs
        for vehicles in results.vehicles
    ]


def _network_rows(results: Results) -> list[dict[str, Any]]:
    rows = []
    for row in results.networks:
        parameters, operations = ("", "")
        if row["preset"] == "paper":
            parameters, operations = PAPER_NETWORKS.get((row["method"], row["uavs"]), ("", ""))
        rows.append(
            {key: row[key] for key in ("preset", "method", "uavs", "parameters", "operations")}
            | {"paper_parameters": parameters, "paper_operations": operations}
        )
    return rows


def _spread(value: Interval) -> dict[str, Any]:
    return {"mean": value.mean, "low_95": value.low, "high_95": value.high, "count": value.count}


def _write(path: Path, rows: list[dict[str, Any]]) -> Path:
    with atomic_path(path) as beside:
        pa_csv.write_csv(pa.Table.from_pylist(rows), beside)
    return path


FIGURE = FigureSpec(
    "coordination", "Learning curves, centralised learning, coverage and connectivity", experiment, render
)
