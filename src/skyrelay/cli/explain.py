"""``skyrelay explain``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.options import Json, print_result


def command(
    run_dir: Annotated[Path, typer.Argument(help="A folder that `skyrelay run` has left.", show_default=False)],
    vehicle: Annotated[str, typer.Option("--vehicle", metavar="ID", help="Which vehicle asks.", show_default=False)],
    period: Annotated[
        int | None,
        typer.Option("--period", min=0, help="Which selection; left out: its last unserved one.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Why was I not served? The QoU of each candidate, the UAV that was asked, and what took its bandwidth.

    \b
    Examples:
      skyrelay explain runs/bologna-1 --vehicle 1208
      skyrelay explain runs/bologna-1 --vehicle 1208 --period 0 --json
    """
    from skyrelay.selection.explain import explain, to_text

    told = explain(run_dir, vehicle, period)
    if as_json:
        print_result(asdict(told), as_json=True)
    else:
        typer.echo(to_text(told))
