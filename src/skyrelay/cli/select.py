"""``skyrelay select``: one selection of drawn vehicles and UAVs, by any method."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.cli.options import Json, Override, named_code, print_result
from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.errors import UsageError
from skyrelay.core.scenario import Scenario
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.methods import METHODS, OBJECTIVES, Selection, evaluate, select


def command(
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help=f"One of: {', '.join(METHODS)}; or module:function.",
            show_default="the scenario's",
        ),
    ] = None,
    vehicles: Annotated[
        int | None,
        typer.Option("--vehicles", min=0, max=1_000_000, help="How many vehicles to draw.", show_default="200"),
    ] = None,
    uavs: Annotated[
        int | None, typer.Option("--uavs", min=0, max=65_535, help="How many UAVs to draw.", show_default="160")
    ] = None,
    trace: Annotated[
        str | None,
        typer.Option(
            "--trace",
            metavar="NAME|FILE",
            help="Vehicles of a trace at mobility.start, and the fleet that a run would deploy over them.",
        ),
    ] = None,
    run: Annotated[
        Path | None,
        typer.Option("--run", metavar="RUN", help="Vehicles and UAVs of a run's period, as the contract had them."),
    ] = None,
    period: Annotated[int, typer.Option("--period", min=0, help="With --run.")] = 0,
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
            help="two-sided, load-aware: how often a refused vehicle may ask; full: deferred acceptance. "
            "Default: the scenario's.",
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
    """Select for drawn vehicles and UAVs, a trace's or a run's; print the measures (with --json each vehicle's UAV).

    \b
    Examples:
      skyrelay select --vehicles 200 --uavs 160
      skyrelay select --rounds full --set selection.candidates=zone --json
      skyrelay select --trace bologna --method nnm
      skyrelay select --run runs/bologna-1 --period 2 --method optimal
      skyrelay select --method optimal --objective served --time-limit 30
    """
    from skyrelay.cli.quiet import stdout_kept_clean
    from skyrelay.core.scenario import load_scenario

    if method is not None:
        named_code(None, method)
    if run is not None and trace is not None:
        raise UsageError("select", None, "--trace or --run, not both")
    if run is not None or trace is not None:
        for option, value in (("--vehicles", vehicles), ("--uavs", uavs)):
            if value is not None:
                raise UsageError(option, value, "neither --trace nor --run beside it, whose own are taken")
    if run is not None:
        from skyrelay.simulation.instance import recorded_instance

        if scenario != "paper" or overrides:
            raise UsageError("--run", str(run), "neither --scenario nor --set beside it: the run's own are taken")
        instance = recorded_instance(run, period)
    elif trace is not None:
        from skyrelay.simulation.instance import first_instance

        sets = [f"mobility.trace={json.dumps(trace)}", 'mobility.source="trace"', *(overrides or [])]
        instance = first_instance(load_scenario(scenario, sets, seed))
    else:
        instance = _drawn(vehicles, uavs, seed, load_scenario(scenario, overrides or []))
    tables, settings = instance[:2], instance[2]
    with stdout_kept_clean():
        selection = select(
            *tables,
            method,
            settings=settings,
            rounds=_rounds(rounds),
            objective=objective,
            time_limit=time_limit,
            seed=seed,
        )
    result: dict[str, Any] = {"method": selection.method, "seed": seed, "candidates": settings.candidates}
    result |= _of_the_method(selection)
    result |= asdict(evaluate(*tables, selection, settings))
    if as_json:
        names = tables[1].ids
        result["assignment"] = {
            vehicle: names[uav] if uav >= 0 else None
            for vehicle, uav in zip(tables[0].ids, selection.assignment.tolist(), strict=True)
        }
    print_result(result, as_json)


def _drawn(
    vehicles: int | None, uavs: int | None, seed: int, scenario: Scenario
) -> tuple[VehicleTable, UavTable, Settings]:
    """Drawn by a scenario's distributions; said where that scenario has positions of its own."""
    from skyrelay.mobility.tracks import require_trace
    from skyrelay.selection.instances import draw_instance

    mobility = scenario.mobility
    if mobility.source == "trace":
        require_trace(mobility.trace)
        typer.echo(
            f"skyrelay: points are drawn uniformly over {mobility.area:g} x {mobility.area:g} m (mobility.area); of "
            f"the trace {mobility.trace!r} no position is taken (--trace takes them)",
            err=True,
        )
    drawn = draw_instance(200 if vehicles is None else vehicles, 160 if uavs is None else uavs, seed, scenario)
    return *drawn, scenario.selection


def _rounds(text: str | None) -> Any:
    """A number or ``full``; `select` checks it."""
    if text is None or text == "full":
        return text
    try:
        return int(text)
    except ValueError:
        raise UsageError("--rounds", text, "a whole number from 1, or 'full'") from None


def _of_the_method(selection: Selection) -> dict[str, Any]:
    if selection.method in ("two-sided", "load-aware"):
        return {"rounds": len(selection.rounds)}
    if selection.objective is not None and selection.gap is not None:
        name, total = selection.objective
        gap = selection.gap if selection.gap < float("inf") else None
        return {"objective": name, "total": total, "gap": gap}
    return {}
