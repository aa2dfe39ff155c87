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
    hosts: Annotated[
        Path | None,
        typer.Option("--hosts", metavar="FILE", help="Write each host's folder, start nothing.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a consortium network of validators on this machine, until Ctrl-C; or found one on several hosts.

    Keys, genesis and configuration are written to the folder; the next start goes on from the last block. With --hosts
    nothing starts: hosts/NAME is what goes to each host (key, genesis, configuration with all peers, start.sh, a
    systemd unit). The file is TOML: chain_id, period, and a [[host]] for each with name, address, p2p_port, rpc_port,
    and public_key where the host keeps its own node key.

    For example:

      skyrelay chain devnet --validators 4 --dir devnet

      skyrelay chain devnet --hosts hosts.toml --dir network

      skyrelay run --set chain.url=http://127.0.0.1:8545
    """
    if hosts is not None:
        given = {"--validators": validators, "--consensus": consensus, "--period": period, "--rpc-port": rpc_port}
        _found(hosts, directory, [option for option, value in given.items() if value is not None], as_json)
        return
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


def _found(hosts: Path, directory: Path, doubled: list[str], as_json: bool) -> None:
    from skyrelay.chain.node.hosts import write_hosts
    from skyrelay.core.errors import UsageError

    if doubled:
        raise UsageError(doubled[0], None, f"what {hosts} says: number, ports and period stand there, and it is QBFT")
    founded = write_hosts(directory, hosts)
    validators = {name: node.address for name, node in founded.validators.items()}
    if as_json:
        told = {
            "chain_id": founded.chain_id,
            "hosts": {name: str(directory / "hosts" / name) for name in validators},
            "validators": validators,
            "keyless": list(founded.keyless),
            "operator_keystore": str(directory / "accounts" / "operator.json"),
        }
        typer.echo(json.dumps(told))
        return
    for name, address in validators.items():
        key = "; put its own geth/nodekey in" if name in founded.keyless else ""
        typer.echo(f"{directory}/hosts/{name}  validator {address}: goes to {name}, start.sh starts it{key}")
    typer.echo(f"Chain {founded.chain_id}; pin its validators: --validators {','.join(validators.values())}")
    typer.echo(f"Operator's keystore: {directory}/accounts/operator.json (password in operator.password beside it)")


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
