"""``skyrelay agent``."""

from __future__ import annotations

import logging
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.ending import one_line_for_the_unforeseen, until_terminated
from skyrelay.core.errors import UsageError


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
    policy: Annotated[
        str | None,
        typer.Option("--policy", metavar="MODULE:FUNCTION", help="Own code that the scenario names."),
    ] = None,
    autopilot: Annotated[
        str | None,
        typer.Option("--autopilot", metavar="URL", help="What flies the one UAV by MAVLink; docs/how-to/autopilot.md."),
    ] = None,
    gpsd: Annotated[
        str | None, typer.Option("--gpsd", metavar="HOST:PORT", help="Where the one vehicle's receiver is asked.")
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(
            "--origin", metavar="LAT,LON", help="Where the scenario's x = y = 0 is [degrees]; for --autopilot."
        ),
    ] = None,
    metrics: Annotated[
        str | None, typer.Option("--metrics", metavar="HOST:PORT", help="Answer Prometheus at /metrics there.")
    ] = None,
    log_json: Annotated[bool, typer.Option("--log-json", help="Say everything as JSON, an object a line.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Say also where in the program a fault came up.")] = False,
) -> None:
    """Host agents of one kind, each with its own key, until the world stops.

    \b
    Examples:
      skyrelay agent uav --config uavs.toml
      skyrelay agent vehicle --config vehicles.toml --members v017,v018
      skyrelay agent uav --config uavs.toml --members u03 --autopilot udp://127.0.0.1:14540 --origin 44.49,11.34
    """
    from skyrelay.core import plugins
    from skyrelay.pilot.agents import run_agents
    from skyrelay.pilot.config import load_config
    from skyrelay.pilot.geodesy import Frame
    from skyrelay.pilot.logs import configure

    level = logging.DEBUG if debug else logging.INFO
    configure("agent", log_json, level=level)
    wanted = [name.strip() for name in members.split(",") if name.strip()]
    if (autopilot is None and gpsd is None) != (origin is None):
        raise UsageError("--origin", origin, "with --autopilot or --gpsd, and only with them")
    frame = None if origin is None else Frame.parse(origin, "--origin")
    if policy is not None:
        plugins.allow(policy)
    host = load_config(config, wanted)
    logger = configure(host.name, log_json, level=level)
    with until_terminated(), one_line_for_the_unforeseen(f"host {host.name}", logger):
        airframe = None if autopilot is None or frame is None else (autopilot, frame)
        receiver = None if gpsd is None or frame is None else (gpsd, frame)
        run_agents(kind.value, host, logger.info, airframe=airframe, receiver=receiver, metrics=metrics)
