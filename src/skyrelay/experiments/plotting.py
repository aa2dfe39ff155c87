"""Lines with 95 % bands, written as PDF and PNG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skyrelay.core.files import atomic_path
from skyrelay.core.statistics import Interval

# Okabe and Ito's palette: told apart by people who see no red or green, and in print.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "v", "D", "P", "X")


def panels(rows: int, columns: int, title: str) -> tuple[Figure, list[Axes]]:
    """A figure of ``rows`` x ``columns`` axes, in reading order."""
    figure = Figure(figsize=(4.6 * columns, 3.4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    figure.suptitle(title, fontsize=11)
    for axis in axes.flat:
        axis.grid(alpha=0.25, linewidth=0.6)
        axis.spines[["top", "right"]].set_visible(False)
    return figure, list(axes.flat)


def line(axis: Axes, x: Sequence[float], y: Sequence[Interval], label: str, style: int, *, faint: bool = False) -> None:
    """A line of means over a band of their intervals; ``style`` picks colour and marker."""
    color = COLORS[style % len(COLORS)]
    axis.plot(
        x,
        [value.mean for value in y],
        color=color,
        marker=MARKERS[style % len(MARKERS)],
        markersize=4,
        linewidth=1.0 if faint else 1.8,
        linestyle="--" if faint else "-",
        label=label,
    )
    axis.fill_between(x, [value.low for value in y], [value.high for value in y], color=color, alpha=0.15, linewidth=0)


def points(axis: Axes, x: Sequence[float], y: Sequence[Interval], label: str, style: int, shift: float) -> None:
    """Means of shares with a bar each for their intervals, beside those of other labels.

    A share is no more than 1: Student's intervals of shares near 1 are cut off there.

    Args:
        shift: along the axis, so that equal values do not hide each other.
    """
    low = [value.mean - max(value.low, 0.0) for value in y]
    high = [min(value.high, 1.0) - value.mean for value in y]
    axis.errorbar(
        [at + shift for at in x],
        [value.mean for value in y],
        yerr=[low, high],
        color=COLORS[style % len(COLORS)],
        marker=MARKERS[style % len(MARKERS)],
        markersize=4,
        linewidth=0.8,
        elinewidth=1.4,
        capsize=2,
        label=label,
    )


def save(figure: Figure, folder: Path, stem: str) -> list[Path]:
    """Write ``stem.pdf`` and ``stem.png``; equal figures give equal files."""
    written = []
    for suffix, options in ((".pdf", {"metadata": {"CreationDate": None}}), (".png", {"dpi": 130})):
        path = folder / f"{stem}{suffix}"
        with atomic_path(path) as beside:
            figure.savefig(beside, **options)
        written.append(path)
    return written
