"""``skyrelay explain``."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyrelay.cli.options import Json, print_result
from skyrelay.core.errors import UsageError

if TYPE_CHECKING:
    from skyrelay.core.scenario import Selection as Settings
    from skyrelay.selection.explain import Explanation, Rows


def command(
    run_dir: Annotated[Path, typer.Argument(help="A folder that `skyrelay run` has left.", show_default=False)],
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", metavar="ID", help="Which vehicle asks.", show_default=False)
    ] = None,
    period: Annotated[
        int | None,
        typer.Option("--period", min=0, help="Which selection; left out: its last unserved one.", show_default=False),
    ] = None,
    listed: Annotated[
        bool, typer.Option("--list", help="Print the ids to ask for, and in how many periods each was served.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Why was I not served? The QoU of each candidate, the UAV that was asked, what took its bandwidth; what it had.

    \b
    Examples:
      skyrelay explain runs/bologna-1 --vehicle 1208
      skyrelay explain runs/bologna-1 --vehicle 1208 --period 0 --json
      skyrelay explain runs/bologna-1 --list
    """
    from skyrelay.runfolder.reader import read_rows, read_scenario, require_folder
    from skyrelay.selection.explain import explain

    require_folder(run_dir)
    if listed:
        print_ids(read_rows(run_dir, "members"), read_rows(run_dir, "proposals"), period, as_json)
        return
    if vehicle is None:
        raise UsageError("explain", None, "--vehicle ID, or --list for the ids of this run")
    scenario = read_scenario(run_dir)
    settings, period_steps = scenario.selection, scenario.coordination.period_steps
    tables: dict[str, Rows] = {
        name: read_rows(run_dir, name) for name in ("proposals", "candidates", "fleet", "members")
    }
    if scenario.reselections:
        tables["proposals"] = of_the_selection(tables["proposals"], read_rows(run_dir, "events"), scenario.reselections)
    steps = read_rows(run_dir, "vehicles", vehicle=vehicle)
    told = explain(**tables, steps=steps, vehicle=vehicle, period_steps=period_steps, period=period)
    served_by = told.served_by
    charging = read_rows(run_dir, "charging", uav=served_by) if served_by is not None else []
    away = sum((row["step"] - 1) // period_steps == told.period for row in charging)
    if as_json:
        print_result(asdict(told) | {"reason": reason(told, settings), "had": had(told, away)}, as_json=True)
    else:
        typer.echo(to_text(told, settings, away))


def of_the_selection(proposals: Rows, events: Rows, reselections: frozenset[int]) -> Rows:
    """The proposals that were made when a period began: what follows within it goes by other records."""
    made = [row["step"] for row in events if row["name"] == "VehSelectionSubmitted"]
    return [row for row in proposals if made[row["order"]] not in reselections]


def print_ids(members: Rows, proposals: Rows, period: int | None, as_json: bool) -> None:
    """The vehicles of a run (or of one of its selections): in how many periods each was there, and was served."""
    there: Counter[str] = Counter()
    served: Counter[str] = Counter()
    for row in members:
        if period is None or row["period"] == period:
            there[row["vehicle"]] += 1
    for row in proposals:
        if row["accepted"] and (period is None or row["period"] == period):
            served[row["vehicle"]] += 1
    counts = {vehicle: {"periods": there[vehicle], "served": served[vehicle]} for vehicle in sorted(there)}
    if as_json:
        print_result(counts, as_json)
        return
    for vehicle, count in counts.items():
        typer.echo(f"{vehicle}  served in {count['served']} of {_counted(count['periods'], 'period')}")


def to_text(told: Explanation, settings: Settings, away: int = 0) -> str:
    """An explanation for people, in lines; arguments as `had`."""
    lines = [
        f"Vehicle {told.vehicle}, period {told.period}, zone {told.zone}, asks {_mbps(told.demand)}",
        reason(told, settings),
        had(told, away),
        "",
        "Candidates by QoU:" if told.candidates else "No candidates.",
    ]
    lines += [
        f"  {candidate.rank:>3}. {candidate.uav:<12} QoU {candidate.qou:6.2f}"
        + (f"   asked in round {candidate.asked_in}" if candidate.asked_in is not None else "")
        for candidate in told.candidates
    ]
    for ask in told.asks:
        decided = f" in round {ask.decided_in}" if ask.outcome == "displaced" else ""
        lines += [
            "",
            f"Round {ask.round}: asked {ask.uav} ({_mbps(ask.bandwidth)}), {ask.outcome}{decided}; "
            f"place {ask.rank} of {ask.of} in its list",
        ]
        width = max((len(rival.vehicle) for rival in ask.taken_by), default=0)
        lines += [
            f"  {rival.vehicle:<{width}} {_mbps(rival.demand):>14}   before this vehicle" for rival in ask.taken_by
        ]
        lines.append(f"  left for {told.vehicle}: {_mbps(ask.left)} of the {_mbps(told.demand)} it asks")
    return "\n".join(lines)


def reason(told: Explanation, settings: Settings) -> str:
    """One sentence."""
    if told.served_by is not None:
        rank = next((candidate.rank for candidate in told.candidates if candidate.uav == told.served_by), None)
        choice = f", its choice number {rank} of {len(told.candidates)}" if rank else ""
        return f"Served by {told.served_by}{choice}."
    if not told.asks:
        return f"Not served: {_without_asking(told, settings)}."
    last = told.asks[-1]
    if told.demand > last.bandwidth:
        why = f"it asks {_mbps(told.demand)}, more than {last.uav} has at all ({_mbps(last.bandwidth)})"
    elif last.outcome == "displaced":
        why = f"in round {last.decided_in} vehicles before it in {last.uav}'s list took its bandwidth"
    elif last.outcome == "refused":
        why = (
            f"{_counted(len(last.taken_by), 'vehicle')} before it in {last.uav}'s list left {_mbps(last.left)} "
            f"of the {_mbps(told.demand)} it asks"
        )
    else:
        why = f"{last.uav} accepted it, but it was not served in the end (it left, or the UAV did)"
    unasked = len(told.candidates) - len(told.asks)
    more = (
        f"; never asked: {_counted(unasked, 'candidate')} (selection.rounds = {settings.rounds})" if unasked > 0 else ""
    )
    return f"Not served: {why}{more}."


def had(told: Explanation, away: int = 0) -> str:
    """One sentence of what the vehicle had over the period, and why.

    Args:
        away: steps of the period at which its UAV was away to be charged.
    """
    got = told.received
    if got is None:
        return "It was gone before the period's first step."
    if told.served_by is None:
        return "It had 0 Mbit/s, because no UAV served it."
    why = f"it was in range of {told.served_by} at {got.in_range} of {_counted(got.steps, 'step')}"
    if away:
        why += f", which left to be charged and was away at {away}"
    if got.crowded:
        why += f", whose radio held less than it asks for at {got.crowded} of them"
    if got.delivered < got.carried:
        why += f", and {_mbps(got.delivered)} of it reached a gateway"
    return f"It had {_mbps(got.carried)} of the {_mbps(told.demand)} it asks, on average, because {why}."


def _without_asking(told: Explanation, settings: Settings) -> str:
    """Why a vehicle made no proposal."""
    if any(candidate.qou > 0.0 for candidate in told.candidates):
        return "it had candidates and made no proposal (its transaction may have been refused: see events.parquet)"
    if told.candidates:
        return "all its candidates have a QoU of 0, and such a UAV is never asked"
    if told.nearest is None:
        return f"no UAV is in its zone ({told.zone})"
    away = f"{told.nearest_distance:,.0f} m away, beyond selection.max_distance ({settings.max_distance:,.0f} m)"
    return f"the nearest of {_counted(told.uavs_in_zone, 'UAV')} of its zone, {told.nearest}, is {away}"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _mbps(kbps: float) -> str:
    return f"{kbps / 1000:,.3f} Mbit/s"
