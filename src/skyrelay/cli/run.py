"""``skyrelay run``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.options import Json, Override, Seed, print_result


def command(
    scenario: Annotated[str, typer.Argument(help="A built-in scenario or the path of a TOML file.")] = "bologna",
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Where the run folder goes.", show_default="runs/NAME-SEED"),
    ] = None,
    seed: Seed = None,
    override: Override = None,
    chain: Annotated[
        str | None, typer.Option("--chain", metavar="URL", help="Run on a node instead of the embedded chain.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a run folder that is already there.")] = False,
    as_json: Json = False,
) -> None:
    """Play a whole scenario: registration, selection on the chain, policies by CID, flight, and a report page.

    \b
    Examples:
      skyrelay run
      skyrelay run city.toml --out runs/city --seed 7
      skyrelay run --set mobility.trace=city.parquet --set fleet.uavs=60 --json
      skyrelay run --chain http://127.0.0.1:8545
    """
    from skyrelay.cli.progress import ShownProgress
    from skyrelay.core.scenario import load_scenario
    from skyrelay.report import write_figures, write_report
    from skyrelay.simulation import new_run_folder, play

    overrides = [*(override or ()), *([f"chain.url={chain}"] if chain else [])]
    config = load_scenario(scenario, overrides, seed)
    target = out or Path("runs") / f"{config.name}-{config.seed}"
    with ShownProgress() as progress, new_run_folder(target, replace=force) as folder:
        summary = play(config, folder, progress)
        progress.stage("Report", 2)
        write_figures(folder)
        progress.advance()
        write_report(folder)
    print_result(summary, as_json)
    if not as_json:
        typer.echo(f"\nOpen {target / 'report.html'} in a browser.")
