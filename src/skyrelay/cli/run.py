"""``skyrelay run``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyrelay.cli.options import (
    Force,
    Json,
    Method,
    Out,
    Override,
    Policy,
    ScenarioName,
    Seed,
    named_code,
    print_result,
)
from skyrelay.core.errors import UsageError

if TYPE_CHECKING:
    from skyrelay.core.scenario import Mobility, Scenario


def command(
    scenario: ScenarioName = "bologna",
    out: Out = None,
    seed: Seed = None,
    override: Override = None,
    policy: Policy = None,
    method: Method = None,
    chain: Annotated[
        str | None, typer.Option("--chain", metavar="URL", help="Run on a node instead of the embedded chain.")
    ] = None,
    chain_id: Annotated[
        int | None, typer.Option("--chain-id", help="What the node's chain id must be.", show_default=False)
    ] = None,
    seeds: Annotated[
        int,
        typer.Option("--seeds", min=1, max=1000, metavar="N", help="Run so many seeds, paired against hovering."),
    ] = 1,
    force: Force = False,
    resume: Annotated[
        Path | None,
        typer.Option("--resume", metavar="DIR", help="Go on with a run to this folder that was killed."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Play a whole scenario: registration, selection on the chain, policies by CID, flight, and a report page.

    \b
    Examples:
      skyrelay run
      skyrelay run city.toml --out runs/city --seed 7
      skyrelay run --set mobility.trace=city.parquet --set fleet.uavs=60 --json
      skyrelay run --policy cover --out runs/cover
      skyrelay run --seeds 10 --out runs/ten
      skyrelay run --method nnm --out runs/nnm
      skyrelay run --chain http://127.0.0.1:8545
      skyrelay run --resume runs/bologna-1
    """
    from skyrelay.core.scenario import load_scenario
    from skyrelay.simulation.resume import killed_run

    overrides = [*(override or ()), *([f"chain.url={chain}"] if chain else []), *named_code(policy, method)]
    if chain_id is not None:
        overrides.append(f"chain.chain_id={chain_id}")
    killed = None if resume is None else killed_run(resume)
    config = load_scenario(scenario, overrides, seed) if killed is None else killed.scenario
    if seeds > 1:
        if resume is not None:
            raise UsageError("--seeds", seeds, "without --resume, which goes on with one run")
        _play_seeds(config, out or Path("runs") / config.name, seeds, force, as_json)
        return
    target = resume or out or Path("runs") / f"{config.name}-{config.seed}"
    summary = _play(config, target, force, (lambda _: None) if killed is None else killed.check)
    if as_json:
        print_result(summary, as_json)
    else:
        for name, line in lines(summary, target, config.mobility):
            typer.echo(f"{name:<13} {line}")


def _play(
    config: Scenario, target: Path, force: bool, check: Callable[[Path], None] = lambda _: None
) -> dict[str, Any]:
    """Play a scenario, show how far it is, and leave its folder; ``check`` looks at the record."""
    from skyrelay.cli.progress import ShownProgress
    from skyrelay.report import write_figures, write_report
    from skyrelay.runfolder import new_run_folder
    from skyrelay.simulation import play

    def draw(folder: Path) -> None:
        check(folder)
        progress.stage("Report", 2)
        write_figures(folder)
        progress.advance()
        write_report(folder)

    with ShownProgress() as progress, new_run_folder(target, replace=force) as folder:
        return play(config, folder, progress, draw)


def _play_seeds(config: Scenario, beside: Path, seeds: int, force: bool, as_json: bool) -> None:
    """The same scenario with the seeds from its own on, a folder each, and all of them against hovering."""
    from skyrelay.cli.compare import print_comparison
    from skyrelay.report.compare import groups_of, table

    folders = []
    for number in range(config.seed, config.seed + seeds):
        target = beside.with_name(f"{beside.name}-{number}")
        typer.echo(f"seed {number}: {target}", err=True)
        _play(config.model_copy(update={"seed": number}), target, force)
        folders.append(target)
    print_comparison(table(groups_of(folders, hovering=True)), as_json)


def lines(s: Mapping[str, Any], folder: Path, mobility: Mobility) -> Iterator[tuple[str, str]]:
    """The summary for people."""
    # Said, since a scenario that another trace is put into has a share that was meant for its own.
    share = f" (mobility.penetration: {mobility.penetration:.3g} of the trace's)" if mobility.source == "trace" else ""
    yield "Vehicles", f"{s['vehicles']:,} connected{share}, {s['vehicles_per_period']:,.0f} at a time"
    for note in s["trace_notes"]:
        yield "Trace", note
    yield "UAVs", f"{s['uavs']:,} over {s['zones']} zones; {s['uavs_retired']} left with an empty battery"
    if s.get("charged_share") is not None:
        yield (
            "Charging",
            f"UAVs were away for {s['charged_share']:.1%} of the time and waited for a place for "
            f"{s['waiting_seconds'] or 0:,.0f} s on average; the lowest battery had {s['lowest_battery']:.1f} %",
        )
    if s["selected_by"] and not s["selected_by"].startswith("two-sided"):
        yield "Selected by", s["selected_by"]
    qualities = "" if s["mean_qou"] is None else f"; mean QoU {s['mean_qou']:.1f}, mean QoV {s['mean_qov']:.1f}"
    yield "Selection", f"{s['periods']} periods, {s['served_per_period']:,.0f} vehicles served at a time{qualities}"
    yield (
        "In range",
        f"{_count(s['in_range'])} of {_count(s['connected'])} connected vehicles at a time "
        f"({_count(s['static_in_range'])} if UAVs hovered)",
    )
    yield (
        "Coverage",
        f"{_share(s['coverage'])} of the served vehicles in range ({_share(s['static_coverage'])} of those served if "
        "UAVs hovered)",
    )
    yield (
        "Connectivity",
        f"{_share(s['connectivity'])} of the time a team is linked ({_share(s['static_connectivity'])}); "
        f"every UAV has a neighbour {_share(s['connectivity_neighbor'])}",
    )
    yield (
        "Carried",
        f"{_count(s['carried_mbps'])} Mbit/s, {_share(s['carried_share'])} of what all connected vehicles ask for "
        f"({_share(s['static_carried_share'])} if UAVs hovered); delivered {_count(s['delivered_mbps'])} Mbit/s "
        f"({_count(s['static_delivered_mbps'])})",
    )
    if s["fairness"] is not None:
        yield (
            "Service",
            f"Jain fairness {s['fairness']:.2f} ({s['static_fairness'] or 0:.2f}); {s['handovers']:,} hand-overs "
            f"({s['static_handovers']:,}); 19 of 20 outages at most {s['outage_p95_seconds']:,.0f} s "
            f"({s['static_outage_p95_seconds']:,.0f} s)",
        )
    share = s["vehicles_per_period"] * s["periods"]
    each = f", {s['gas_used'] / share:,.0f} a vehicle and period" if share else ""
    yield "Chain", f"{s['transactions']:,} transactions, {s['gas_used']:,} gas{each}, {s['blocks']} blocks"
    flown = zip(s["decided_by"], s["model_cids"], strict=True)
    yield "Decided by", ", ".join(f"the {who} ({cid})" for who, cid in flown) or "nobody: no UAV was selected"
    yield "Time", f"{s['wall_seconds']:.1f} s, {s['chain_seconds']:.1f} s of it on the chain"
    yield "Report", f"{folder / 'report.html'}: open it in a browser"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"


def _count(value: float | None) -> str:
    return "-" if value is None else f"{value:,.0f}"
