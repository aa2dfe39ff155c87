"""``skyrelay run``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyrelay.cli.options import Force, Json, Out, Override, Policy, ScenarioName, Seed, flown_by, print_result

if TYPE_CHECKING:
    from skyrelay.core.scenario import Mobility


def command(
    scenario: ScenarioName = "bologna",
    out: Out = None,
    seed: Seed = None,
    override: Override = None,
    policy: Policy = None,
    chain: Annotated[
        str | None, typer.Option("--chain", metavar="URL", help="Run on a node instead of the embedded chain.")
    ] = None,
    chain_id: Annotated[
        int | None, typer.Option("--chain-id", help="What the node's chain id must be.", show_default=False)
    ] = None,
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
      skyrelay run --chain http://127.0.0.1:8545
      skyrelay run --resume runs/bologna-1
    """
    from skyrelay.cli.progress import ShownProgress
    from skyrelay.core.scenario import load_scenario
    from skyrelay.report import write_figures, write_report
    from skyrelay.runfolder import new_run_folder
    from skyrelay.simulation import play
    from skyrelay.simulation.resume import killed_run

    overrides = [*(override or ()), *([f"chain.url={chain}"] if chain else []), *flown_by(policy)]
    if chain_id is not None:
        overrides.append(f"chain.chain_id={chain_id}")
    killed = None if resume is None else killed_run(resume)
    config = load_scenario(scenario, overrides, seed) if killed is None else killed.scenario
    target = resume or out or Path("runs") / f"{config.name}-{config.seed}"

    def draw(folder: Path) -> None:
        if killed is not None:
            killed.check(folder)
        progress.stage("Report", 2)
        write_figures(folder)
        progress.advance()
        write_report(folder)

    with ShownProgress() as progress, new_run_folder(target, replace=force) as folder:
        summary = play(config, folder, progress, draw)
    if as_json:
        print_result(summary, as_json)
    else:
        for name, line in lines(summary, target, config.mobility):
            typer.echo(f"{name:<13} {line}")


def lines(s: Mapping[str, Any], folder: Path, mobility: Mobility) -> Iterator[tuple[str, str]]:
    """The summary for people."""
    # Said, since a scenario that another trace is put into has a share that was meant for its own.
    share = f" (mobility.penetration: {mobility.penetration:.3g} of the trace's)" if mobility.source == "trace" else ""
    yield "Vehicles", f"{s['vehicles']:,} connected{share}, {s['vehicles_per_period']:,.0f} at a time"
    for note in s["trace_notes"]:
        yield "Trace", note
    yield "UAVs", f"{s['uavs']:,} over {s['zones']} zones; {s['uavs_retired']} left with an empty battery"
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
    yield "Chain", f"{s['transactions']:,} transactions, {s['gas_used']:,} gas, {s['blocks']} blocks"
    flown = zip(s["decided_by"], s["model_cids"], strict=True)
    yield "Decided by", ", ".join(f"the {who} ({cid})" for who, cid in flown) or "nobody: no UAV was selected"
    yield "Time", f"{s['wall_seconds']:.1f} s, {s['chain_seconds']:.1f} s of it on the chain"
    yield "Report", f"{folder / 'report.html'}: open it in a browser"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"


def _count(value: float | None) -> str:
    return "-" if value is None else f"{value:,.0f}"
