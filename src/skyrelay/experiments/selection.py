"""The paper's four selection panels: vehicles per UAV, UAVs selected, mean QoU and mean QoV over the number of UAVs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from skyrelay.core.files import atomic_path
from skyrelay.core.scenario import load_scenario
from skyrelay.core.statistics import Interval, interval
from skyrelay.experiments.claims import Finding, Verdict
from skyrelay.experiments.figures import FigureSpec, Rendered, Scale
from skyrelay.experiments.plotting import COLORS, line, panels, save
from skyrelay.experiments.runner import Experiment, Row, Task
from skyrelay.selection.instances import draw_instance
from skyrelay.selection.methods import evaluate, select

VEHICLES = 200
PAPER_SEEDS = 5
"""Seeds 1 to 5 are the paper's five iterations; the others narrow the interval."""

OPTIMALITY_GAP = 1e-3
"""Of the MILP: a time limit would make results depend on the machine."""

METHODS: Mapping[str, Mapping[str, Any]] = {
    "two-sided": {"method": "two-sided", "rounds": 1},
    "nnm": {"method": "nnm"},
    "two-sided, all rounds": {"method": "two-sided", "rounds": "full"},
    "optimal (QoU)": {"method": "optimal", "objective": "qou", "gap": OPTIMALITY_GAP},
    "optimal (served)": {"method": "optimal", "objective": "served", "gap": OPTIMALITY_GAP},
    "nearest": {"method": "nearest"},
    "random": {"method": "random"},
}
PANELS = (
    ("vehicles_per_uav", "vehicles per selected UAV"),
    ("uavs_selected_percent", "UAVs selected [%]"),
    ("mean_qou", "mean QoU"),
    ("mean_qov", "mean QoV"),
)
RULES = {"range": "the zone's UAVs within max distance", "zone": "all UAVs of the zone"}
SIMILAR, MUCH_SMALLER = 0.1, 0.8
"""What we take "similar" (a ratio so close to 1) and "much smaller" (a ratio below) to mean."""

_SCALES: Mapping[Scale, tuple[Sequence[int], int]] = {
    "smoke": ((20, 80, 160), 5),
    "fast": (range(20, 161, 20), 20),
    "paper": (range(20, 161, 20), 100),
}


def compare(
    overrides: Sequence[str], vehicles: int, uavs: int, seed: int, methods: Sequence[str], labels: Mapping[str, Any]
) -> list[Row]:
    """Select on one drawn instance by several methods; a row each.

    Args:
        overrides: of the paper's scenario.
        methods: keys of `METHODS`.
        labels: columns that go in front of each row.
    """
    scenario = load_scenario("paper", overrides)
    tables = draw_instance(vehicles, uavs, seed, scenario)
    rows = []
    for name in methods:
        options = dict(METHODS[name])
        chosen = select(*tables, options.pop("method"), settings=scenario.selection, seed=seed, **options)
        metrics = asdict(evaluate(*tables, chosen, scenario.selection))
        rows.append({**labels, "seed": seed, "method": name, **metrics, "gap": chosen.gap})
    return rows


def experiment(scale: Scale) -> Experiment:
    """Every candidate rule, number of UAVs and seed: one task each."""
    counts, seeds = _SCALES[scale]
    tasks = [
        Task(
            f"{rule}-{uavs}-{seed}",
            {
                "overrides": [f"selection.candidates={rule}"],
                "vehicles": VEHICLES,
                "uavs": uavs,
                "seed": seed,
                "methods": list(METHODS),
                "labels": {"candidates": rule},
            },
        )
        for rule in RULES
        for uavs in counts
        for seed in range(1, seeds + 1)
    ]
    return Experiment("selection", f"{__name__}:compare", tasks)


def render(table: pa.Table, folder: Path) -> Rendered:
    """Summary as CSV, a figure for each candidate rule, and the claims."""
    results = Results(table.to_pylist())
    files = [_write_summary(results, folder)]
    for rule, meaning in RULES.items():
        figure, axes = panels(2, 2, f"Candidates: {meaning}. {VEHICLES} vehicles, 50 x 50 km, {results.seeds} seeds")
        for axis, (metric, label) in zip(axes, PANELS, strict=True):
            for style, method in enumerate(METHODS):
                values = [results.interval(rule, uavs, method, metric) for uavs in results.counts]
                line(axis, results.counts, values, method, style, faint=style > 1)
            for style, method in enumerate(("two-sided", "nnm")):
                five = [results.interval(rule, uavs, method, metric, PAPER_SEEDS).mean for uavs in results.counts]
                axis.plot(
                    results.counts,
                    five,
                    color=COLORS[style],
                    marker="+x"[style],
                    linestyle="",
                    label=f"{method}, 5 seeds",
                )
            axis.set_xlabel("UAVs")
            axis.set_ylabel(label)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
        files += save(figure, folder, f"selection-{rule}")
    return Rendered(files, [finding for rule in RULES for finding in findings(results, rule)])


class Results:
    """The rows of the experiment, by candidate rule, number of UAVs, method and seed."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self._rows = {(row["candidates"], row["uavs"], row["method"], row["seed"]): row for row in rows}
        self.counts = sorted({row["uavs"] for row in rows})
        self.seeds = max(row["seed"] for row in rows)

    def values(self, rule: str, uavs: int, method: str, metric: str, seeds: int | None = None) -> list[float | None]:
        """Of the first ``seeds`` seeds, or of all."""
        return [
            self._rows[rule, uavs, method, seed][metric] for seed in range(1, min(seeds or self.seeds, self.seeds) + 1)
        ]

    def interval(self, rule: str, uavs: int, method: str, metric: str, seeds: int | None = None) -> Interval:
        """Mean over seeds."""
        return interval(self.values(rule, uavs, method, metric, seeds))

    def ratio(self, rule: str, uavs: int, metric: str, seeds: int | None = None) -> Interval:
        """``two-sided`` over ``nnm`` on the same instance, mean over seeds."""
        pairs = zip(
            self.values(rule, uavs, "two-sided", metric, seeds),
            self.values(rule, uavs, "nnm", metric, seeds),
            strict=True,
        )
        return interval([ours / theirs if ours is not None and theirs else None for ours, theirs in pairs])

    def average_gain(self, rule: str, metric: str) -> Interval:
        """``two-sided`` above ``nnm`` [%], each seed's mean over the numbers of UAVs, mean over seeds."""
        ours, theirs = (
            np.array([self.values(rule, uavs, method, metric) for uavs in self.counts], dtype=float)
            for method in ("two-sided", "nnm")
        )
        gains: list[float | None] = (100.0 * (ours / theirs - 1.0)).mean(axis=0).tolist()
        return interval(gains)


def findings(results: Results, rule: str) -> list[Finding]:
    """What the results say about the paper's claims under one candidate rule."""
    counts, many = results.counts, [count for count in results.counts if count > 20]
    least, most = counts[0], counts[-1]
    setting = f"candidates: {rule}, {results.seeds} seeds"

    def finding(claim: str, measured: str, verdict: Verdict) -> Finding:
        return Finding(f"selection.{claim}", setting, measured, verdict)

    found = []
    for claim, metric, at_least in (("qou", "mean_qou", 13.0), ("qov", "mean_qov", 10.0)):
        gains = {uavs: _percent(results.ratio(rule, uavs, metric)) for uavs in counts}
        reached = [gain.mean >= at_least for gain in gains.values()]
        measured = ", ".join(f"{gain.text(1, ' %')} at {uavs}" for uavs, gain in gains.items())
        found.append(finding(claim, measured, _share(reached)))
    average = results.average_gain(rule, "mean_qov")
    found.append(finding("qov-average", average.text(1, " %"), "holds" if average.high >= 10.0 else "does not hold"))

    ours = [results.interval(rule, uavs, "two-sided", "mean_qou") for uavs in counts]
    rising = [later.mean > earlier.mean for earlier, later in pairwise(ours)]
    text = f"{ours[0].text()} at {least}, {ours[-1].text()} at {most}; rises in {sum(rising)} of {len(rising)} steps"
    found.append(finding("qou-rises", text, _share(rising) if ours[-1].low > ours[0].high else "does not hold"))
    theirs = [results.interval(rule, uavs, "nnm", "mean_qou") for uavs in counts]
    spread = max(value.mean for value in theirs) - min(value.mean for value in theirs)
    text = f"{theirs[0].text()} at {least}, {theirs[-1].text()} at {most}; the curve spans {spread:.1f} points"
    # "Stable" beside a curve that rises: at most a third of that rise.
    flat = spread <= abs(ours[-1].mean - ours[0].mean) / 3
    found.append(finding("nnm-stable", text, "holds" if flat else "does not hold"))

    few = results.ratio(rule, least, "vehicles_per_uav")
    text = f"{few.text(2)} times NNM's at {least} UAVs (similar: within {SIMILAR:.0%})"
    found.append(finding("few-uavs", text, "holds" if abs(few.mean - 1.0) <= SIMILAR else "does not hold"))
    more = {uavs: results.ratio(rule, uavs, "vehicles_per_uav") for uavs in many}
    held = [ratio.low > 1.0 for ratio in more.values()]
    found.append(finding("vehicles-per-uav", f"times NNM's: {_at(more)}", _share(held)))
    fewer = {uavs: results.ratio(rule, uavs, "uavs_selected_percent") for uavs in many}
    held = [ratio.high < MUCH_SMALLER for ratio in fewer.values()]
    text = f"times NNM's: {_at(fewer)} (much smaller: below {MUCH_SMALLER:g})"
    found.append(finding("fewer-uavs", text, _share(held)))

    blocking = {uavs: results.interval(rule, uavs, "two-sided", "blocking_pairs") for uavs in counts}
    measured = ", ".join(f"{value.mean:.1f} at {uavs}" for uavs, value in blocking.items())
    full = max(results.interval(rule, uavs, "two-sided, all rounds", "blocking_pairs").mean for uavs in counts)
    text = f"blocking pairs: {measured}; with all rounds at most {full:.1f}"
    found.append(finding("stable", text, _share([value.mean == 0.0 for value in blocking.values()])))
    return found


def _percent(ratio: Interval) -> Interval:
    """A ratio as the percentage above 1."""
    return Interval(100.0 * (ratio.mean - 1.0), 100.0 * (ratio.low - 1.0), 100.0 * (ratio.high - 1.0), ratio.count)


def _at(ratios: Mapping[int, Interval]) -> str:
    return ", ".join(f"{ratio.text(2)} at {uavs}" for uavs, ratio in ratios.items())


def _share(held: Sequence[bool]) -> Verdict:
    return "holds" if all(held) else "holds in part" if any(held) else "does not hold"


def _write_summary(results: Results, folder: Path) -> Path:
    """Mean and interval of every panel's metric, and the blocking pairs."""
    rows = []
    for rule in RULES:
        for uavs in results.counts:
            for method in METHODS:
                for metric in (*(name for name, _ in PANELS), "served", "used_bandwidth_percent", "blocking_pairs"):
                    value = results.interval(rule, uavs, method, metric)
                    five = results.interval(rule, uavs, method, metric, PAPER_SEEDS)
                    rows.append(
                        {
                            "candidates": rule,
                            "uavs": uavs,
                            "method": method,
                            "metric": metric,
                            "mean": value.mean,
                            "low_95": value.low,
                            "high_95": value.high,
                            "seeds": value.count,
                            "mean_of_5": five.mean,
                        }
                    )
    path = folder / "summary.csv"
    with atomic_path(path) as beside:
        pa_csv.write_csv(pa.Table.from_pylist(rows), beside)
    return path


FIGURE = FigureSpec("selection", "The paper's four selection panels", experiment, render)
