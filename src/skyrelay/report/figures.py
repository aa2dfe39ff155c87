"""The run's time series and selections as figures for a paper or a slide: PNG and PDF."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from skyrelay.core.files import atomic_path
from skyrelay.runfolder.reader import Run, read_run

LEARNED, STATIC, GREY = "#0b66c3", "#b4590a", "#8b97a4"

_STYLE: dict[Any, Any] = {
    "font.size": 9,
    "font.family": "DejaVu Sans",  # it comes with matplotlib, so that every machine draws the same
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dde3ea",
    "legend.frameon": False,
    "pdf.fonttype": 42,
    "figure.constrained_layout.use": True,
}


def write_figures(run_dir: Path) -> list[Path]:
    """Draw ``figures/*.png`` and ``figures/*.pdf`` of a run folder. The same folder gives the same bytes.

    Returns: the files written: coverage, connectivity, bandwidth, energy and selection, each in both formats.
    Raises:
        RunFolderError: a file is missing or cannot be read, or a key, column or value is missing or does not fit.
    """
    run = read_run(run_dir)
    written: list[Path] = []
    for name, draw in _FIGURES.items():
        with mpl.rc_context(_STYLE):
            figure = Figure(figsize=(6.0, 3.2), dpi=160)
            draw(run, figure.subplots())
            # The formats' own dates and versions would make two runs differ.
            for suffix, metadata in ((".png", {"Software": None}), (".pdf", {"CreationDate": None, "Producer": None})):
                path = run_dir / "figures" / (name + suffix)
                with atomic_path(path) as beside:
                    figure.savefig(beside, metadata=metadata)
                written.append(path)
    return written


def _coverage(run: Run, axes: Axes) -> None:
    _lines(run, axes, [("coverage", "learned", LEARNED, "-"), ("static_coverage", "hovering", STATIC, "--")])
    axes.set_ylabel("vehicles in their UAV's range [%]")


def _connectivity(run: Run, axes: Axes) -> None:
    _lines(
        run,
        axes,
        [
            ("connectivity", "learned", LEARNED, "-"),
            ("connectivity_neighbor", "learned, a neighbour each", LEARNED, ":"),
            ("static_connectivity", "hovering", STATIC, "--"),
        ],
    )
    axes.set_ylabel("zones with a linked team [%]")


def _bandwidth(run: Run, axes: Axes) -> None:
    _lines(
        run,
        axes,
        [
            ("carried_mbps", "learned", LEARNED, "-"),
            ("delivered_mbps", "learned, delivered", LEARNED, ":"),
            ("static_carried_mbps", "hovering", STATIC, "--"),
        ],
        unit="Mbit/s",
    )
    axes.set_ylim(bottom=0)
    axes.set_ylabel("traffic carried [Mbit/s]")


def _energy(run: Run, axes: Axes) -> None:
    axes.plot(_time(run), run.metric("energy_percent"), color=LEARNED)
    axes.set_ylim(0, 100)
    axes.set_ylabel("mean battery of the UAVs in the air [%]")


def _selection(run: Run, axes: Axes) -> None:
    """Per period: vehicles that proposed, vehicles accepted, UAVs selected."""
    count = run.summary.periods
    period, accepted = run.proposals["period"], run.proposals["accepted"]
    asked, taken, chosen = (np.zeros(count, dtype=np.int64) for _ in range(3))
    for index in range(count):
        rows = period == index
        asked[index] = len(set(run.proposals["vehicle"][rows]))
        taken[index] = len(set(run.proposals["vehicle"][rows & accepted]))
        chosen[index] = len(set(run.proposals["uav"][rows & accepted]))
    at = np.arange(1, count + 1)
    for offset, values, label, colour in (
        (-0.27, asked, "vehicles that proposed", GREY),
        (0.0, taken, "vehicles accepted", LEARNED),
        (0.27, chosen, "UAVs selected", STATIC),
    ):
        axes.bar(at + offset, values, width=0.25, color=colour, label=label)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(visible=False, axis="x")
    axes.set_xlabel("selection period")
    axes.set_ylabel("vehicles or UAVs in a period")
    _legend(axes)


def _lines(run: Run, axes: Axes, lines: list[tuple[str, str, str, str]], unit: str = "%") -> None:
    """Metrics over time; the legend has the figures over the run that ``summary.json`` has."""
    scale = 100 if unit == "%" else 1
    for name, label, colour, style in lines:
        whole = getattr(run.summary, name)
        told = "" if whole is None else f" ({scale * whole:.1f} {unit} over the run)"
        axes.plot(_time(run), scale * run.metric(name), color=colour, linestyle=style, label=label + told)
    _legend(axes)


def _legend(axes: Axes) -> None:
    """Above the plot, where it hides no line."""
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2, handlelength=1.6)


def _time(run: Run) -> npt.NDArray[np.floating[Any]]:
    return np.arange(run.summary.steps + 1) * run.summary.step_seconds


def _over_time(draw: Callable[[Run, Axes], None]) -> Callable[[Run, Axes], None]:
    """``draw`` with the axis of time and the moments of selection."""

    def drawn(run: Run, axes: Axes) -> None:
        draw(run, axes)
        for step in range(0, run.summary.steps, run.summary.period_steps):
            axes.axvline(step * run.summary.step_seconds, color=GREY, linewidth=0.6, linestyle=(0, (1, 3)), zorder=0)
        axes.set_xlabel("time [s]")
        axes.margins(x=0.01)

    return drawn


_FIGURES: dict[str, Callable[[Run, Axes], None]] = {
    "coverage": _over_time(_coverage),
    "connectivity": _over_time(_connectivity),
    "bandwidth": _over_time(_bandwidth),
    "energy": _over_time(_energy),
    "selection": _selection,
}
