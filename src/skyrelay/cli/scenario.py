"""``skyrelay scenario``."""

from __future__ import annotations

from typing import Annotated

import typer

from skyrelay.cli.options import Override
from skyrelay.core.scenario import load_scenario, to_commented_toml


def command(
    scenario: Annotated[str, typer.Argument(help="A built-in scenario or the path of a TOML file.")] = "bologna",
    override: Override = None,
) -> None:
    """Print a scenario with every key, its value, meaning and unit: the start of your own.

    \b
    Example:
      skyrelay scenario bologna --set mobility.trace=city.parquet > city.toml
    """
    typer.echo(to_commented_toml(load_scenario(scenario, override or ())), nl=False)
