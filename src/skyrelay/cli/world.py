"""``skyrelay world``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.cli.ending import one_line_for_the_unforeseen, until_terminated


class _Told:
    """Progress for the process that has started this one: an object a line on standard output."""

    def stage(self, name: str, total: int) -> None:
        """A stage begins."""
        tell(stage=name, total=total)

    def advance(self, steps: int = 1) -> None:
        """Some steps of it are done."""
        tell(advance=steps)


def tell(**what: Any) -> None:
    """One line to whoever has started this process."""
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def command(
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="As `skyrelay up` writes it: world.toml.")],
) -> None:
    """Be the world of a run: where everybody is, the clock, and the record. `skyrelay up` starts it.

    What it is at goes to standard output, a JSON object a line.

    \b
    Example:
      skyrelay world --config out/up/hosts/world.toml
    """
    from skyrelay.pilot.config import load_world
    from skyrelay.pilot.logs import configure
    from skyrelay.pilot.world import NAME, run_world

    logger = configure(NAME, as_json=False)
    with until_terminated(), one_line_for_the_unforeseen(NAME, logger):
        run_world(load_world(config), lambda line: tell(say=line), _Told())
