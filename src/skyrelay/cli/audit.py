"""``skyrelay audit``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyrelay.cli.options import Json
from skyrelay.core.errors import UsageError

if TYPE_CHECKING:
    from skyrelay.runfolder.schema import Summary

SHOWN = 50
"""Differences printed for people; --json has all."""


def command(
    run_dir: Annotated[
        Path | None, typer.Argument(help="A folder that `skyrelay run` has left.", show_default=False)
    ] = None,
    chain: Annotated[
        list[str] | None,
        typer.Option(
            "--chain",
            "--node",
            metavar="URL",
            help="A node's JSON-RPC endpoint, in place of a folder or its node.",
            show_default=False,
        ),
    ] = None,
    contract: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="The contract on that node.", show_default=False)
    ] = None,
    chain_id: Annotated[int | None, typer.Option(help="What the node's chain id must be.", show_default=False)] = None,
    validators: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS,...", help="The node's validators, as you know them from elsewhere.", show_default=False
        ),
    ] = None,
    head: Annotated[
        str | None,
        typer.Option(
            metavar="HASH",
            help="A block that must be on the node's chain; of a folder, its record's last block.",
            show_default=False,
        ),
    ] = None,
    unsealed: Annotated[
        bool, typer.Option("--unsealed", help="Accept a node whose blocks nobody has sealed (a development node).")
    ] = False,
    epoch: Annotated[
        int, typer.Option(min=1, help="Blocks after which the node's network forgets votes on its validators.")
    ] = 30_000,
    as_json: Json = False,
) -> int:
    """Rebuild every selection from the chain alone and name what differs: skyrelay audit out/bologna.

    The folder of a run on a node is audited there, at the address, contract and chain id that the folder names; --node
    URL asks another node, --chain-id another chain.

    Exit status: 0 all agree, 1 something differs, 2 there is nothing to audit.
    """
    from skyrelay.audit import audit_folder, audit_node_folder
    from skyrelay.chain.accounts import Keyring
    from skyrelay.chain.node.chain import NodeChain
    from skyrelay.chain.proof.audit import audit_node
    from skyrelay.chain.proof.root import TrustRoot
    from skyrelay.net.http import public_address

    def progress(stage: str) -> None:
        typer.echo(f"{stage} ...", err=True)

    named = [] if validators is None else [address.strip() for address in validators.split(",")]
    root = TrustRoot.of(named, head, unsealed=unsealed, epoch=epoch)
    recorded = None if run_dir is None or contract is not None else _on_a_node(run_dir)
    if run_dir is not None and recorded is not None:
        urls = chain or [one.strip() for one in (recorded.chain_url or "").split(",")]
        pinned = recorded.chain_id if chain_id is None else chain_id
        node = NodeChain(urls, Keyring.ephemeral(), chain_id=pinned, root=root)
        typer.echo(
            f"The folder's contract {recorded.contract} on chain {node.chain_id}, asked at "
            f"{', '.join(map(public_address, urls))}",
            err=True,
        )
        report = audit_node_folder(run_dir, node, progress, root=root)
    elif run_dir is not None and not chain and contract is None:
        if chain_id is not None or named or unsealed:
            raise UsageError("audit", str(run_dir), "a folder without --chain-id, --validators or --unsealed")
        report = audit_folder(run_dir, progress, head=root.head)
    elif run_dir is None and chain and contract is not None:
        node = NodeChain(chain, Keyring.ephemeral(), chain_id=chain_id, root=root)
        report = audit_node(node, contract, progress, root=root)
    else:
        raise UsageError("audit", None, "a run's folder, or --chain URL with --contract ADDRESS")

    if as_json:
        differences = [{"place": d.place, "found": d.found, "expected": d.expected} for d in report.differences]
        result = {
            "subject": report.subject,
            "agrees": report.agrees,
            "checked": dict(report.checked),
            "differences": differences,
            "given": report.given,
            "unchecked": report.unchecked,
        }
        typer.echo(json.dumps(result, indent=2))
        return 0 if report.agrees else 1
    typer.echo(f"Checked of {report.subject}:")
    width = max(map(len, report.checked), default=0)
    for name, count in report.checked.items():
        typer.echo(f"  {name:<{width}}  {count:,}")
    for difference in report.differences[:SHOWN]:
        typer.echo(f"DIFFERENT  {difference}")
    if len(report.differences) > SHOWN:
        typer.echo(f"... and {len(report.differences) - SHOWN:,} more (all with --json)")
    if report.given:
        typer.echo("Compare with what you know from elsewhere:")
    for name, value in report.given.items():
        typer.echo(f"  {name}: {value}")
    if report.unchecked:
        typer.echo("Not checked, since nothing here gives it:")
        for what in report.unchecked:
            typer.echo(f"  {what}")
    typer.echo("All agree." if report.agrees else f"{len(report.differences):,} differences.")
    return 0 if report.agrees else 1


def _on_a_node(run_dir: Path) -> Summary | None:
    """The summary of a run on a node; None where the folder has the embedded chain's record."""
    from skyrelay.runfolder.folder import CHAIN, SUMMARY
    from skyrelay.runfolder.reader import read_summary

    if (run_dir / CHAIN).exists() or not (run_dir / SUMMARY).is_file():
        return None
    summary = read_summary(run_dir)
    return None if summary.chain_url is None else summary
