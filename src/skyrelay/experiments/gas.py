"""The paper's table "Implementation Cost" beside this contract's gas, and what the table leaves out: allocateZone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from skyrelay.chain.embedded import gas
from skyrelay.core.files import atomic_path
from skyrelay.experiments.claims import Finding
from skyrelay.experiments.figures import FigureSpec, Rendered, Scale
from skyrelay.experiments.plotting import COLORS, panels, save
from skyrelay.experiments.runner import Experiment, Row, Task

EXTENSION = "deployment of the extension"
"""The second part of the contract: models, ratings, views. The paper's table knows one part."""
SETTING = "embedded chain (London), worst and best case of each function"


def measure(curve: Sequence[int]) -> list[Row]:
    """The one task: every function on a fresh chain. Gas does not depend on a seed or a machine.

    Args:
        curve: numbers of proposals for allocateZone.
    """
    report = gas.measure(curve)
    rows: list[Row] = [
        {"kind": "function", "function": row.function, "case": row.case, "gas": row.gas, "paper": row.paper}
        for row in report.rows
    ]
    for point in report.curve:
        for case, value in (("20 UAVs", point.spread), ("1 UAV", point.single), ("pieces of 60", point.pieces)):
            labels = {"kind": "curve", "function": "allocateZone", "case": case}
            rows.append({**labels, "gas": value, "proposals": point.proposals})
    return rows


def experiment(scale: Scale) -> Experiment:
    """The same at every scale, but for the length of the curve."""
    curve = gas.CURVE[:3] if scale == "smoke" else gas.CURVE
    return Experiment("gas", f"{__name__}:measure", [Task("contract", {"curve": list(curve)})], ("eth-abi",))


def render(table: pa.Table, folder: Path) -> Rendered:
    """The table as CSV, the figure, and for each function of the paper's table whether ours stays within it."""
    rows: list[Row] = table.to_pylist()
    compared = [row for row in rows if row["paper"] is not None]
    costs: dict[str, list[Row]] = {}
    for row in compared:
        costs.setdefault(row["function"], []).append(row)
    path = folder / "gas.csv"
    with atomic_path(path) as beside:
        pa_csv.write_csv(pa.Table.from_pylist([_ratio(row) for row in rows]), beside)
    apart = {row["function"]: row["gas"] for row in rows if row["function"] == EXTENSION}
    findings = [_finding(function, cases, apart) for function, cases in costs.items()]
    return Rendered([path, *_draw(costs, [row for row in rows if row["kind"] == "curve"], folder)], findings)


def _ratio(row: Row) -> dict[str, Any]:
    return {**row, "ratio": None if row["paper"] is None else round(row["gas"] / row["paper"], 4)}


def _finding(function: str, cases: Sequence[Row], apart: Mapping[str, int]) -> Finding:
    """The dearest case decides; what else a deployment needs is told beside it."""
    low, high = min(row["gas"] for row in cases), max(row["gas"] for row in cases)
    paper = cases[0]["paper"]
    text = f"{high:,}, {high / paper:.2f} of it"
    if low < high:
        text = f"{low:,} to {high:,}, {low / paper:.2f} to {high / paper:.2f} of it"
    if function == "deployment":
        text += "".join(f"; {name} {value:,} more" for name, value in apart.items())
    return Finding(f"gas.{function}", SETTING, text, "holds" if high <= paper else "does not hold")


def _draw(costs: dict[str, list[Row]], curve: Sequence[Row], folder: Path) -> list[Path]:
    figure, (bars, line) = panels(1, 2, "Gas of a transaction; allocateZone, which the paper's table leaves out")
    place = np.arange(len(costs))
    paper = [cases[0]["paper"] for cases in costs.values()]
    worst, best = ([pick(row["gas"] for row in cases) for cases in costs.values()] for pick in (max, min))
    for offset, values, label, color in (
        (-0.27, paper, "paper", "grey"),
        (0.0, worst, "ours, dearest case", COLORS[0]),
    ):
        bars.barh(place + offset, values, height=0.25, color=color, label=label)
    bars.barh(place + 0.27, best, height=0.25, color=COLORS[2], label="ours, cheapest case")
    bars.set_yticks(place, list(costs), fontsize=8)
    bars.invert_yaxis()
    bars.set_xscale("log")
    bars.set_xlabel("gas")
    bars.legend(fontsize=7)
    for style, case in enumerate(dict.fromkeys(row["case"] for row in curve)):
        points = [row for row in curve if row["case"] == case]
        line.plot(
            [row["proposals"] for row in points],
            [row["gas"] / 1e6 for row in points],
            color=COLORS[style],
            marker="o",
            markersize=3,
            label=case,
        )
    line.set_xlabel("proposals in the zone")
    line.set_ylabel("allocateZone [million gas]")
    line.legend(fontsize=7)
    return save(figure, folder, "gas")


FIGURE = FigureSpec("gas", "Table of the contract's costs, and allocateZone over proposals", experiment, render)
