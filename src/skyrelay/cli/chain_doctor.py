"""``skyrelay chain doctor``."""

from __future__ import annotations

import dataclasses
import json
from typing import Annotated

import typer

from skyrelay.cli.options import Json


def command(
    urls: Annotated[list[str], typer.Argument(metavar="URL...", help="The nodes' JSON-RPC endpoints.")],
    watch: Annotated[
        float, typer.Option("--watch", metavar="S", min=0.5, max=600, help="How long to wait for a block [s].")
    ] = 5.0,
    as_json: Json = False,
) -> int:
    """Say why a network stands still: quorum, forks, clocks, peers, pool.

    For example:

      skyrelay chain doctor http://127.0.0.1:8545 http://127.0.0.1:8546

    Exit status: 0 blocks are being made and nothing is amiss, 1 something was found.
    """
    from skyrelay.chain.node.doctor import diagnose

    found = diagnose(urls, watch)
    if as_json:
        shown = ("name", "fault", "chain_id", "genesis", "height", "timestamp", "peers", "pending", "queued", "clock")
        nodes = [{name: getattr(node, name) for name in shown} for node in found.nodes]
        typer.echo(json.dumps({"moves": found.moves, "findings": found.findings, "nodes": nodes}, indent=2))
    else:
        for node in found.nodes:
            told = ", ".join(
                f"{name} {value}"
                for name, value in dataclasses.asdict(node).items()
                if name in ("height", "peers", "pending", "queued") and value is not None
            )
            typer.echo(f"{node.name}: {'no answer' if node.fault else told}")
        for finding in found.findings:
            typer.echo(f"FOUND  {finding}")
        typer.echo("Blocks are being made." if found.moves else "The network stands still.")
    return 1 if found.findings else 0
