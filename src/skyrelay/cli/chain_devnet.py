"""``skyrelay chain devnet``."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from types import FrameType
from typing import Annotated, Literal

import typer

from skyrelay.cli.options import Json


def command(
    validators: Annotated[
        int | None, typer.Option("--validators", metavar="N", help="How many validators.", show_default="4")
    ] = None,
    directory: Annotated[
        Path, typer.Option("--dir", metavar="DIR", help="The network's folder; one that is there goes on.")
    ] = Path("devnet"),
    consensus: Annotated[
        Literal["qbft", "clique"] | None,
        typer.Option("--consensus", help="qbft runs on GoQuorum, clique on go-ethereum.", show_default="qbft"),
    ] = None,
    period: Annotated[
        int | None, typer.Option("--period", metavar="S", help="Time between blocks [s].", show_default="1")
    ] = None,
    rpc_port: Annotated[
        int | None,
        typer.Option("--rpc-port", metavar="PORT", help="Of the first validator.", show_default="8545"),
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a consortium network of validators on this machine, until Ctrl-C.

    Keys, genesis and configuration are written to the folder; the next start goes on from the last block.

    For example:

      skyrelay chain devnet --validators 4 --dir devnet

      skyrelay run --set chain.url=http://127.0.0.1:8545
    """
    from skyrelay.chain.node.devnet import Devnet
    from skyrelay.core.errors import UsageError

    if (directory / "devnet.json").exists():
        network = Devnet.open(directory)
        for option, wanted, found in (
            ("--validators", validators, len(network.validators)),
            ("--consensus", consensus, network.consensus),
            ("--period", period, network.period),
            ("--rpc-port", rpc_port, network.validators[0].rpc_port),
        ):
            if wanted is not None and wanted != found:
                raise UsageError(option, wanted, f"{found}, as the network in {directory} has it (or another --dir)")
    else:
        network = Devnet.create(
            directory,
            validators=4 if validators is None else validators,
            consensus=consensus or "qbft",
            period=1 if period is None else period,
            rpc_port=8545 if rpc_port is None else rpc_port,
        )
    signal.signal(signal.SIGTERM, _interrupt)
    if not as_json:
        typer.echo(
            f"Starting {len(network.validators)} validators ({network.consensus}); logs in {directory}/validators/*"
        )
    with network:
        keystore, password = network.operator
        if as_json:
            told = {
                "consensus": network.consensus,
                "chain_id": network.chain_id,
                "endpoints": network.endpoints,
                "operator_keystore": str(keystore),
                "operator_password_file": str(password),
            }
            typer.echo(json.dumps(told))
        else:
            typer.echo(f"Blocks are being made. Chain {network.chain_id} answers at")
            for url in network.endpoints:
                typer.echo(f"  {url}")
            typer.echo(f"Operator's keystore: {keystore} (password in {password.name} beside it)\nCtrl-C stops all.")
        try:
            while True:
                network.supervise()
        except KeyboardInterrupt:
            if not as_json:
                typer.echo("\nStopping; the same command goes on from here.")


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
