"""``skyrelay agent``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.ending import until_terminated


class Kind(StrEnum):
    """What an agent can be."""

    vehicle = "vehicle"
    uav = "uav"
    coordinator = "coordinator"


def command(
    kind: Annotated[Kind, typer.Argument(help="What to host.")],
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="Of this host; docs/how-to/pilot.md.")],
    members: Annotated[
        str, typer.Option("--members", metavar="NAMES", help="Of those in the file, by comma.", show_default="all")
    ] = "",
) -> None:
    """Host agents of one kind, each with its own key, until the world stops.

    \b
    Examples:
      skyrelay agent uav --config uavs.toml
      skyrelay agent vehicle --config vehicles.toml --members v017,v018
    """
    from skyrelay.pilot.agents import run_agents
    from skyrelay.pilot.config import load_config

    wanted = [name.strip() for name in members.split(",") if name.strip()]
    with until_terminated():
        run_agents(kind.value, load_config(config, wanted), lambda line: typer.echo(line, err=True))
