"""The figures that ``skyrelay reproduce`` knows, each imported only when it is wanted."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pyarrow as pa

from skyrelay.core.errors import UsageError
from skyrelay.core.progress import Progress
from skyrelay.experiments.claims import Finding, write_findings
from skyrelay.experiments.runner import Experiment, run

Scale = Literal["smoke", "fast", "paper"]
SCALES: tuple[Scale, ...] = ("smoke", "fast", "paper")


@dataclass(frozen=True)
class Rendered:
    """What came out of a figure's results.

    Attributes:
        files: written into the figure's folder.
        findings: about the paper's claims; none for a sweep.
    """

    files: Sequence[Path]
    findings: Sequence[Finding] = ()


@dataclass(frozen=True)
class FigureSpec:
    """One figure, table or sweep.

    Attributes:
        name: on the command line, and of its folder.
        title: one line.
        experiment: the tasks at a scale.
        render: writes CSV, PDF and PNG from the results into a folder.
    """

    name: str
    title: str
    experiment: Callable[[Scale], Experiment]
    render: Callable[[pa.Table, Path], Rendered]


_PLACES = {
    "selection": "skyrelay.experiments.selection:FIGURE",
    "selection-weights": "skyrelay.experiments.sensitivity:WEIGHTS",
    "selection-distance": "skyrelay.experiments.sensitivity:DISTANCE",
    "selection-demand": "skyrelay.experiments.sensitivity:DEMAND",
    "selection-zones": "skyrelay.experiments.sensitivity:ZONES",
    "coordination": "skyrelay.experiments.coordination:FIGURE",
    "gas": "skyrelay.experiments.gas:FIGURE",
    "generalization": "skyrelay.experiments.generalization:FIGURE",
}
"""Where each figure is."""

FIGURES = tuple(_PLACES)


def load_figure(name: str) -> FigureSpec:
    """The figure of a name.

    Raises:
        UsageError: there is none; the closest name is suggested.
    """
    if name not in _PLACES:
        close = difflib.get_close_matches(name, FIGURES, n=1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise UsageError("figure", name, f"one of {', '.join(FIGURES)}{hint}")
    module, _, attribute = _PLACES[name].partition(":")
    spec: FigureSpec = getattr(importlib.import_module(module), attribute)
    return spec


def check_scale(scale: str) -> Scale:
    """``scale``, if there is such a one.

    Raises:
        UsageError: there is not.
    """
    for known in SCALES:
        if scale == known:
            return known
    raise UsageError("--scale", scale, f"one of {', '.join(SCALES)}")


def reproduce(
    name: str, scale: Scale, folder: Path, *, ray: str | None = None, progress: Progress | None = None
) -> Rendered:
    """Run a figure's experiment (or what is left of it) into a folder, and draw it.

    Raises:
        UsageError: an unknown figure, or Ray cannot be reached.
        RunFolderError: the folder belongs to something else.
    """
    figure = load_figure(name)
    command = f"skyrelay reproduce {name} --scale {scale}"
    table = run(figure.experiment(scale), folder, ray=ray, progress=progress, command=command)
    rendered = figure.render(table, folder)
    if not rendered.findings:
        return rendered
    return Rendered([*rendered.files, write_findings(folder, rendered.findings)], rendered.findings)
