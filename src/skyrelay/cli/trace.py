"""``skyrelay trace``: what is in a file of vehicle positions, and the same as Parquet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.cli.options import Json, help_alone, print_result

app = typer.Typer(
    help="Vehicle traces: look at a file, or bring it into Parquet.", callback=help_alone, invoke_without_command=True
)

File = Annotated[str, typer.Argument(metavar="FILE", help="A trace file, or a built-in trace's name.")]
Units = Annotated[str, typer.Option("--units", help="Of positions: auto, m, km, ft or degrees.")]
TimeUnit = Annotated[str, typer.Option("--time-unit", help="Of times that are numbers: s, ms, us or ns.")]
MaxGap = Annotated[float, typer.Option("--max-gap", help="Seconds between samples beyond which a vehicle is absent.")]
LostFixes = Annotated[str, typer.Option("--lost-fixes", help="Samples at places out of reach: refuse or drop.")]


@app.command("inspect")
def inspect(
    file: File,
    units: Units = "auto",
    time_unit: TimeUnit = "s",
    max_gap: MaxGap = 30.0,
    lost_fixes: LostFixes = "refuse",
    as_json: Json = False,
) -> None:
    """Say what a trace holds: extent, times, rates, vehicles, and what would be left out and why.

    \b
    Examples:
      skyrelay trace inspect bologna
      skyrelay trace inspect city.csv --time-unit ms --json
    """
    from skyrelay.mobility.tracks import open_trace

    trace, place = open_trace(file, _options(units, time_unit, max_gap, lost_fixes))
    print_result({"trace": place} | trace.facts(), as_json)


@app.command("convert")
def convert(
    file: File,
    out: Annotated[Path, typer.Option("--out", help="The Parquet file to write.")],
    units: Units = "auto",
    time_unit: TimeUnit = "s",
    max_gap: MaxGap = 30.0,
    lost_fixes: LostFixes = "refuse",
    as_json: Json = False,
) -> None:
    """Write a trace as Parquet in metres and seconds, with what was made of it in the file's metadata.

    \b
    Examples:
      skyrelay trace convert tracks.gpx --out tracks.parquet
      skyrelay run bologna --set mobility.trace=tracks.parquet
    """
    from skyrelay.mobility.trace import write_parquet
    from skyrelay.mobility.tracks import open_trace

    trace, _ = open_trace(file, _options(units, time_unit, max_gap, lost_fixes))
    write_parquet(trace, out)
    print_result({"trace": str(out)} | trace.facts(), as_json)


def _options(units: str, time_unit: str, max_gap: float, lost_fixes: str) -> Any:
    from skyrelay.core.scenario import validate

    tree = {"units": units, "time_unit": time_unit, "max_gap": max_gap, "lost_fixes": lost_fixes}
    return validate({"mobility": tree}, "trace").mobility
