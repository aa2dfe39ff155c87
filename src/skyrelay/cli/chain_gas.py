"""``skyrelay chain gas``."""

from __future__ import annotations

import json

import typer

from skyrelay.cli.options import Json


def command(as_json: Json = False) -> None:
    """Measure what each function of the contract costs, beside the paper's table, and allocateZone over proposals.

    Takes about ten seconds on the embedded chain, whose gas is a node's.

    For example:

      skyrelay chain gas

      skyrelay chain gas --json > contracts/gas-snapshot.json
    """
    from rich.console import Console
    from rich.table import Table

    from skyrelay.chain.embedded.gas import measure

    report = measure()
    if as_json:
        typer.echo(json.dumps(report.as_json(), indent=1))
        return
    console = Console()
    table = Table(title="Gas of a transaction")
    for heading in ("function", "case"):
        table.add_column(heading)
    for heading in ("paper", "ours", "ratio"):
        table.add_column(heading, justify="right")
    for row in report.rows:
        paper = "" if row.paper is None else f"{row.paper:,}"
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        table.add_row(row.function, row.case, paper, f"{row.gas:,}", ratio)
    console.print(table)
    table = Table(title="allocateZone over the proposals of a zone")
    for heading in ("proposals", "20 UAVs", "each", "1 UAV", "each", "pieces of 60", "calls"):
        table.add_column(heading, justify="right")
    for point in report.curve:
        n = point.proposals
        table.add_row(
            f"{n:,}",
            f"{point.spread:,}",
            f"{point.spread // n:,}",
            f"{point.single:,}",
            f"{point.single // n:,}",
            f"{point.pieces:,}",
            f"{point.calls:,}",
        )
    console.print(table)
    table = Table(title="A vehicle's share where proposals are signed (submitSigned), positions included")
    for heading in ("vehicles", "handed in, each", "allocated, each"):
        table.add_column(heading, justify="right")
    for batch in report.batches:
        table.add_row(f"{batch.vehicles:,}", f"{batch.signed:,}", f"{batch.allocated:,}")
    console.print(table)
    table = Table(title="A vehicle's share where the round is claimed or proved (OptimisticSelection), all included")
    for heading in ("vehicles", "each", "for the bytes of the transaction", "each, checked at once"):
        table.add_column(heading, justify="right")
    for claim in report.claims:
        table.add_row(f"{claim.vehicles:,}", f"{claim.claimed:,}", f"{claim.calldata:,}", f"{claim.proved:,}")
    console.print(table)
