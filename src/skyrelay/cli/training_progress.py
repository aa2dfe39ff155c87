"""How a training is shown: stage, bar, time since its start, time left, the newest greedy test."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from skyrelay.learning.training import Report


class TrainingProgress:
    """A bar on standard error; call it with each `Report`."""

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("updates,"),
            TimeElapsedColumn(),
            TextColumn("since the start, left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=self._console,
        )
        self._task = self._bar.add_task("compiling", total=None, note="")
        self._first: float | None = None

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def promise(self, seconds: float) -> None:
        """Say before it begins how long a training will take."""
        self._console.print(f"about {_duration(seconds)} of training on this machine; Ctrl-C leaves a checkpoint")

    def __call__(self, report: Report) -> None:
        """Show a report."""
        self._bar.update(self._task, description=report.stage, completed=report.update, total=report.updates)
        if report.row is None:
            return
        if self._first is None:
            self._first = report.seconds
            left = report.seconds * (report.updates - report.update)
            self._console.print(
                f"about {_duration(left)} of training for {report.updates - report.update} more updates"
            )
        note = f"reward {report.row['reward']:.3f}"
        if "test_return" in report.row:
            row = report.row
            self._console.print(
                f"{report.steps:>9,} steps {report.seconds:7.1f} s  return {row['test_return']:7.2f}"
                f"  coverage {row['test_coverage']:.3f}  connectivity {row['test_connectivity']:.3f}"
            )
        self._bar.update(self._task, note=note)


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
