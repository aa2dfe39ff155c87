"""Options and output that several commands share."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.core.errors import UsageError

ScenarioName = Annotated[str, typer.Argument(help="A built-in scenario or the path of a TOML file.")]
Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Where the run folder goes.", show_default="runs/NAME-SEED"),
]
Force = Annotated[bool, typer.Option("--force", help="Replace a run folder that is already there.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]
Seed = Annotated[int | None, typer.Option("--seed", min=0, help="Replaces the scenario's seed.", show_default=False)]
Override = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Replaces a key of the scenario, e.g. --set fleet.uavs=20."),
]
Policy = Annotated[
    str | None,
    typer.Option(
        "--policy",
        metavar="NAME",
        help="Who decides: a shipped policy (generalist) or rule (cover, hovering), an ONNX file, module:function.",
        show_default="the scenario's",
    ),
]


Method = Annotated[
    str | None,
    typer.Option(
        "--method",
        metavar="NAME",
        help="Who selects: two-sided (the contract), nnm, optimal, nearest, random, or module:function.",
        show_default="the scenario's",
    ),
]


def named_code(policy: str | None, method: str | None = None) -> list[str]:
    """The overrides that ``--policy`` and ``--method`` stand for; own code that they name may be loaded."""
    from skyrelay.core import plugins

    keys = {"coordination.policy": policy, "selection.method": method}
    for name in keys.values():
        if name is not None:
            plugins.allow(name)
    return [f"{key}={json.dumps(name)}" for key, name in keys.items() if name is not None]


def help_alone(context: typer.Context) -> None:
    """A group of commands that is called without one prints its help."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit


def span(option: str, text: str, largest: int) -> tuple[int, int]:
    """Two numbers from ``"3"`` or ``"2-5"``.

    Raises:
        UsageError: it is neither, or not between 1 and ``largest``.
    """
    low, dash, high = text.partition("-")
    try:
        bounds = int(low), int(high) if dash else int(low)
    except ValueError:
        bounds = (0, 0)
    if not 1 <= bounds[0] <= bounds[1] <= largest:
        raise UsageError(option, text, f"a number from 1 to {largest}, or a range such as 2-5")
    return bounds


def print_result(result: Mapping[str, Any], as_json: bool) -> None:
    """A mapping as JSON, or as aligned lines for people."""
    if as_json:
        typer.echo(json.dumps(result, indent=2))
        return
    width = max(map(len, result))
    for key, value in result.items():
        typer.echo(f"{key:<{width}}  {_text(value)}")


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:,.4g}" if abs(value) < 1000 else f"{value:,.0f}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    if isinstance(value, list | tuple):
        return ", ".join(_text(item) for item in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items())
    return str(value)
