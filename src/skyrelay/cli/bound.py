"""``skyrelay bound``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.options import Json, print_result


def command(
    run_dir: Annotated[Path, typer.Argument(help="A folder that `skyrelay run` has left.", show_default=False)],
    every: Annotated[int, typer.Option("--every", min=1, help="Look at every so many steps only: faster.")] = 1,
    as_json: Json = False,
) -> None:
    """Say what the fleet could have carried at most, and which share of that it did.

    Three certified bounds: with any UAV for any vehicle at any time; with the run's selection periods; and with its
    zones, too.

    \b
    Examples:
      skyrelay bound runs/bologna-1
      skyrelay bound runs/bologna-1 --every 10 --json
    """
    from skyrelay.report.bound import bound

    levels = bound(run_dir, every)
    if as_json:
        print_result({level.level: asdict(level) for level in levels}, as_json=True)
        return
    limits = {"free": "at any time", "periods": "in its periods", "zones": "and zones"}
    for level in levels:
        share = "" if level.share is None else f", of which the run carried {level.share:.1%}"
        typer.echo(f"At most {level.mbps:,.0f} Mbit/s carried {limits[level.level]}{share}")
    asked, had = levels[0].demand, levels[0].capacity
    typer.echo(f"Asked for: {asked:,.0f} Mbit/s; UAVs whose battery can have lasted: {had:,.0f} Mbit/s")
