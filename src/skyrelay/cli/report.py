"""``skyrelay report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    run_dir: Annotated[Path, typer.Argument(help="A folder that `skyrelay run` has left.", show_default=False)],
) -> None:
    """Draw the figures and report.html of a run folder again: skyrelay report runs/bologna-1."""
    from skyrelay.report import write_figures, write_report

    for path in (*write_figures(run_dir), write_report(run_dir)):
        typer.echo(str(path))
