"""``skyrelay select``: one selection of drawn vehicles and UAVs, by any method."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

import typer

from skyrelay.cli.options import Json, Override, print_result
from skyrelay.core.errors import UsageError
from skyrelay.selection.methods import METHODS, OBJECTIVES, Selection, evaluate, select


def command(
    method: Annotated[str, typer.Option("--method", help=f"One of: {', '.join(METHODS)}.")] = "two-sided",
    vehicles: Annotated[int, typer.Option("--vehicles", min=0, max=1_000_000, help="How many vehicles to draw.")] = 200,
    uavs: Annotated[int, typer.Option("--uavs", min=0, max=65_535, help="How many UAVs to draw.")] = 160,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the draw, and of the method 'random'.")] = 1,
    scenario: Annotated[
        str,
        typer.Option(
            "--scenario",
            metavar="FILE",
            help="Whose area, zones, distributions and weights; 'paper' is the paper's set-up.",
        ),
    ] = "paper",
    rounds: Annotated[
        str | None,
        typer.Option(
            "--rounds",
            metavar="N|full",
            help="two-sided: how often a refused vehicle may ask; full: deferred acceptance. Default: the scenario's.",
            show_default=False,
        ),
    ] = None,
    objective: Annotated[
        str, typer.Option("--objective", help=f"optimal: what to maximise, one of: {', '.join(OBJECTIVES)}.")
    ] = "qou",
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time-limit",
            min=0.0,
            max=1e6,
            metavar="SECONDS",
            help="optimal: stop then, and report the gap.",
            show_default=False,
        ),
    ] = None,
    overrides: Override = None,
    as_json: Json = False,
) -> None:
    """Draw vehicles and UAVs, select, and print the measures (with --json also each vehicle's UAV).

    \b
    Examples:
      skyrelay select --vehicles 200 --uavs 160
      skyrelay select --rounds full --set selection.candidates=zone --json
      skyrelay select --method optimal --objective served --time-limit 30
    """
    from skyrelay.cli.quiet import stdout_kept_clean
    from skyrelay.core.scenario import load_scenario
    from skyrelay.mobility.tracks import require_trace
    from skyrelay.selection.instances import draw_instance

    chosen = load_scenario(scenario, overrides or [])
    if chosen.mobility.source == "trace":
        require_trace(chosen.mobility.trace)
        typer.echo(
            f"skyrelay: points are drawn uniformly over {chosen.mobility.area:g} x {chosen.mobility.area:g} m "
            f"(mobility.area); of the trace {chosen.mobility.trace!r} no position is taken",
            err=True,
        )
    tables = draw_instance(vehicles, uavs, seed, chosen)
    with stdout_kept_clean():
        selection = select(
            *tables,
            method,
            settings=chosen.selection,
            rounds=_rounds(rounds),
            objective=objective,  # type: ignore[arg-type]  # `select` checks it and suggests
            time_limit=time_limit,
            seed=seed,
        )
    result: dict[str, Any] = {"method": method, "seed": seed, "candidates": chosen.selection.candidates}
    result |= _of_the_method(selection)
    result |= asdict(evaluate(*tables, selection, chosen.selection))
    if as_json:
        names = tables[1].ids
        result["assignment"] = {
            vehicle: names[uav] if uav >= 0 else None
            for vehicle, uav in zip(tables[0].ids, selection.assignment.tolist(), strict=True)
        }
    print_result(result, as_json)


def _rounds(text: str | None) -> Any:
    """A number or ``full``; `select` checks it."""
    if text is None or text == "full":
        return text
    try:
        return int(text)
    except ValueError:
        raise UsageError("--rounds", text, "a whole number from 1, or 'full'") from None


def _of_the_method(selection: Selection) -> dict[str, Any]:
    if selection.method == "two-sided":
        return {"rounds": len(selection.rounds)}
    if selection.objective is not None and selection.gap is not None:
        name, total = selection.objective
        gap = selection.gap if selection.gap < float("inf") else None
        return {"objective": name, "total": total, "gap": gap}
    return {}
