"""``skyrelay record``: a trace from a SUMO simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.options import Json, print_result


def command(
    config: Annotated[Path, typer.Argument(metavar="SIMULATION.sumocfg", help="SUMO's configuration.")],
    out: Annotated[Path, typer.Option("--out", help="The trace to write, a .parquet file.")],
    seconds: Annotated[
        float | None,
        typer.Option("--seconds", help="Simulate at most so long; left out: to its own end.", show_default=False),
    ] = None,
    step_length: Annotated[
        float | None,
        typer.Option("--step-length", help="Seconds of a step; left out: the configuration's.", show_default=False),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option("--seed", min=0, help="Of the simulation; left out: the configuration's.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Record where the vehicles of a SUMO simulation drive, as a trace for `mobility.trace`.

    \b
    Needs libsumo (pip install 'skyrelay[sumo]').
    Examples:
      skyrelay record city.sumocfg --out city.parquet --seconds 600
      skyrelay run bologna --set mobility.trace=city.parquet
    """
    from skyrelay.cli.progress import ShownProgress
    from skyrelay.mobility.recording import record

    with ShownProgress() as progress:
        recording = record(config, out, seconds=seconds, step_length=step_length, seed=seed, progress=progress)
    result = {
        "trace": str(recording.path),
        "vehicles": recording.vehicles,
        "samples": recording.samples,
        "begin_seconds": recording.begin,
        "end_seconds": recording.end,
    }
    print_result(result, as_json)
