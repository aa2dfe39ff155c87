"""``skyrelay chain serve``."""

from __future__ import annotations

import json
import os
import signal
import threading
from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.options import Json

TOKEN = "SKYRELAY_CHAIN_TOKEN"  # noqa: S105  (the variable's name)


def command(
    listen: Annotated[str, typer.Option("--listen", metavar="HOST:PORT", help="Where it answers.")] = "127.0.0.1:8545",
    state: Annotated[
        Path, typer.Option("--state", metavar="DIR", help="The chain's folder; one that is there goes on.")
    ] = Path("chain"),
    chain_id: Annotated[
        int | None, typer.Option("--chain-id", min=1, help="Of a new chain.", show_default="31337")
    ] = None,
    as_json: Json = False,
) -> None:
    """Serve the embedded chain by JSON-RPC to many processes, until Ctrl-C.

    Transactions are signed by those who send them. What a client was told is taken is on the disk and survives
    whatever becomes of this process. One party keeps this chain: where owners do not trust each other, use a
    consortium's (chain devnet, or nodes of their own). Elsewhere than on loopback, every request needs the token that
    the variable SKYRELAY_CHAIN_TOKEN names: in the URL, http://skyrelay:TOKEN@HOST:PORT, or as a bearer.

    For example:

      skyrelay chain serve --state out/chain

      skyrelay run --set chain.url=http://127.0.0.1:8545
    """
    from skyrelay.pilot.chain_server import ChainServer
    from skyrelay.pilot.signed_chain import SignedChain

    chain = SignedChain(state, chain_id)
    try:
        server = ChainServer(chain, listen, os.environ.get(TOKEN) or None)
        for kind in (signal.SIGINT, signal.SIGTERM):
            signal.signal(kind, lambda *_: threading.Thread(target=server.stop).start())
        known = {"url": server.url, "chain_id": chain.chain.chain_id, "block": chain.chain.block_number}
        line = f"Chain {known['chain_id']}, at block {known['block']}, answers at {known['url']}; Ctrl-C stops it."
        typer.echo(json.dumps(known) if as_json else line)
        server.serve()
    finally:
        chain.close()
