"""``skyrelay report``: draw a run folder's page and figures again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skyrelay.report import write_figures, write_report


def report(
    run_dir: Annotated[Path, typer.Argument(help="A folder that `skyrelay run` has left.", show_default=False)],
) -> None:
    """Draw report.html and the figures of a run folder again."""
    for path in [*write_figures(run_dir), write_report(run_dir)]:
        typer.echo(str(path))
