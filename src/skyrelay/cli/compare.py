"""``skyrelay compare``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.cli.options import Json


def command(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run folders; the first is held against.")],
    figure: Annotated[
        Path | None,
        typer.Option("--figure", metavar="FILE", help="Draw it there (png, pdf or svg).", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare runs: means over seeds and paired differences, with 95 % intervals.

    Runs that differ in their seed only count as one; of a single kind, it is held against the same fleet hovering.

    \b
    Examples:
      skyrelay compare runs/cover-1 runs/cover-2 runs/generalist-1 runs/generalist-2
      skyrelay compare runs/city-* --figure city.png --json
    """
    from skyrelay.report.compare import draw, groups_of, table

    groups = groups_of(runs, hovering=True)
    if figure is not None:
        draw(groups, figure)
    print_comparison(table(groups), as_json)


def print_comparison(rows: Sequence[Mapping[str, Any]], as_json: bool) -> None:
    """A table, or the same as JSON."""
    if as_json:
        typer.echo(json.dumps(rows, indent=2))
        return
    title = ""
    for row in rows:
        if row["title"] != title:
            title = row["title"]
            typer.echo(title)
        line = f"  {row['runs']:<40} {_with_interval(row, '')}"
        if "paired" in row:
            line += f"   difference {_with_interval(row, 'difference_', sign='+')}, {row['paired']} pairs"
        typer.echo(line.rstrip())


def _with_interval(row: Mapping[str, Any], prefix: str, sign: str = "") -> str:
    mean, low, high = (row[prefix + name] for name in ("mean", "low", "high"))
    if mean is None:
        return "-"
    digits = 0 if abs(mean) >= 1000 else 1 if abs(mean) >= 10 else 4

    def text(value: float) -> str:
        return f"{value:{sign},.{digits}f}"

    return text(mean) if low is None else f"{text(mean)} [{text(low)}, {text(high)}]"
