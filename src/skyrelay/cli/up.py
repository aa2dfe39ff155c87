"""``skyrelay up``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.agent import Kind
from skyrelay.cli.ending import until_terminated
from skyrelay.cli.options import Force, Json, Out, Override, Policy, ScenarioName, Seed, named_code, print_result
from skyrelay.cli.run import lines


def command(
    scenario: ScenarioName = "bologna",
    out: Out = None,
    hosts: Annotated[
        Path | None,
        typer.Option("--hosts", metavar="DIR", help="Of the hosts' files and logs.", show_default="beside the run's"),
    ] = None,
    seed: Seed = None,
    override: Override = None,
    policy: Policy = None,
    chain: Annotated[
        str | None, typer.Option("--chain", metavar="URL", help="Use a node instead of a chain server of its own.")
    ] = None,
    validators: Annotated[
        int,
        typer.Option(
            "--validators", min=0, max=32, metavar="N", help="Use a chain of N GoQuorum validators.", show_default=False
        ),
    ] = 0,
    kubo: Annotated[bool, typer.Option("--kubo", help="Use a Kubo node as the store.")] = False,
    address: Annotated[
        str, typer.Option("--address", metavar="IP", help="Of this machine, where chain and bus are reached.")
    ] = "127.0.0.1",
    bus_tls: Annotated[
        Path | None,
        typer.Option(
            "--bus-tls",
            metavar="DIR",
            help="Encrypt the bus, with ca.pem, host.pem and host-key.pem of this folder.",
            show_default=False,
        ),
    ] = None,
    elsewhere: Annotated[
        list[Kind] | None,
        typer.Option("--elsewhere", help="A kind of host that is started by hand, on this machine or another."),
    ] = None,
    uav_hosts: Annotated[
        int, typer.Option("--uav-hosts", min=1, metavar="N", help="How many processes share the UAVs.")
    ] = 1,
    coordinators: Annotated[
        int,
        typer.Option("--coordinators", min=1, max=9, metavar="N", help="Hosts that coordinate; all but one stand by."),
    ] = 1,
    standby: Annotated[
        float,
        typer.Option(
            "--standby", min=0.1, max=300.0, metavar="S", help="How long a coordinator leaves the one before [s]."
        ),
    ] = 5.0,
    wait: Annotated[
        float, typer.Option("--wait", min=0.0, metavar="S", help="How long the world stands still for a lost host [s].")
    ] = 30.0,
    speed: Annotated[
        float | None,
        typer.Option(
            "--speed",
            min=0.001,
            metavar="X",
            help="Seconds of the world to one of the wall's: 1 is real time.",
            show_default="as fast as it goes",
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live/--no-live", help="Show the fleet as it flies, on a page at loopback.")
    ] = True,
    free_running: Annotated[
        bool, typer.Option("--free-running", help="Every host goes by its own clock; --speed 1 unless given.")
    ] = False,
    slot: Annotated[
        float,
        typer.Option("--slot", min=0.05, max=600.0, metavar="S", help="Free-running: of a phase of the selection [s]."),
    ] = 2.0,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Play a scenario with every agent in a process: chain, store, bus, vehicles, UAVs, coordinator and world.

    One line a process; Ctrl-C ends them all. What comes out is what `skyrelay run` gives.

    \b
    Examples:
      skyrelay up
      skyrelay up bologna --set coordination.steps=40
      skyrelay up --validators 4 --kubo
    """
    from skyrelay.cli.progress import ShownProgress
    from skyrelay.core.scenario import load_scenario
    from skyrelay.pilot.config import ClockConfig
    from skyrelay.pilot.up import Nodes, a_port, new_hosts_folder, up
    from skyrelay.report import write_figures, write_report
    from skyrelay.runfolder import new_run_folder

    overrides = [*(override or ()), *([f"chain.url={chain}"] if chain else []), *named_code(policy)]
    config = load_scenario(scenario, overrides, seed)
    target = out or Path("runs") / f"{config.name}-{config.seed}"
    beside = hosts or target.with_name(f"{target.name}-hosts")

    clock = None
    if free_running:
        clock = ClockConfig(slot=slot, step=config.coordination.step_seconds / (speed or 1.0))

    def draw(folder: Path) -> None:
        progress.stage("Report", 2)
        write_figures(folder)
        progress.advance()
        write_report(folder)

    with (
        until_terminated(),
        ShownProgress() as progress,
        new_run_folder(target, replace=force) as folder,
        new_hosts_folder(beside) as place,
    ):
        summary = up(
            config,
            folder,
            place,
            lambda line: typer.echo(line, err=True),
            progress,
            draw,
            address=address,
            elsewhere=[kind.value for kind in elsewhere or ()],
            uav_hosts=uav_hosts,
            coordinators=coordinators,
            standby=standby,
            wait=wait,
            speed=speed,
            clock=clock,
            nodes=Nodes(validators, target.with_name(f"{target.name}-devnet"), force, kubo),
            live=a_port(8765) if live else None,
            tls=bus_tls,
        )
    if as_json:
        print_result(summary, as_json)
    else:
        for name, line in lines(summary, target, config.mobility):
            typer.echo(f"{name:<13} {line}")
