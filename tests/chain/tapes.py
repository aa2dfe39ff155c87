"""Answers of real validators, recorded, so that audits of their chains are tested without them.

    python tests/chain/tapes.py

records them anew, which every change of the contract asks for: a small world on GoQuorum (QBFT, IBFT) and on
go-ethereum (Clique), which `make nodes` builds. With the word ``votes`` behind it, it records the headers of chains
whose validators vote another one in and out again, which do not depend on the contract.
"""

from __future__ import annotations

import gzip
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import rlp
from chain_rounds import World

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.node import devnet
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.node.devnet import Devnet
from skyrelay.chain.node.rpc import Endpoints
from skyrelay.chain.proof.audit import audit_node

FOLDER = Path(__file__).parent / "tapes"
CONSENSUS = ("qbft", "ibft", "clique")


class RecordingChain(NodeChain):
    """A node's chain that keeps every answer."""

    tape: dict[str, Any]

    def _post(self, requests_: Sequence[tuple[str, list[Any]]], patience: float) -> list[dict[str, Any]]:
        replies = super()._post(requests_, patience)
        self.__dict__.setdefault("tape", {}).update(
            (json.dumps(request), reply["result"]) for request, reply in zip(requests_, replies, strict=True)
        )
        return replies


class PlayedChain(NodeChain):
    """A node's chain from a tape; what is not on it is not known to the node."""

    def __init__(self, tape: dict[str, Any], confirmations: int = 0) -> None:
        self.tape = tape
        super().__init__("https://tape", Keyring.ephemeral(), confirmations=confirmations)

    def _post(self, requests_: Sequence[tuple[str, list[Any]]], patience: float) -> list[dict[str, Any]]:
        return [{"result": self._played(method, params)} for method, params in requests_]

    def _played(self, method: str, params: list[Any]) -> Any:
        if method == "eth_getTransactionByBlockNumberAndIndex":  # it stands in the block
            block = self.tape.get(json.dumps(("eth_getBlockByNumber", [params[0], True])))
            return block and block["transactions"][int(params[1], 16)]
        return self.tape.get(json.dumps((method, params)))


def read(consensus: str) -> dict[str, Any]:
    """``contract``: its address; ``answers``: by request; ``confirmations``: that the chain was read with."""
    return json.loads(gzip.decompress((FOLDER / f"{consensus}.json.gz").read_bytes()))


def ibft(consensus: Literal["qbft", "clique"], addresses: Sequence[str], chain_id: int, period: int) -> dict[str, Any]:
    """GoQuorum's genesis for IBFT, of that for QBFT."""
    genesis = qbft(consensus, addresses, chain_id, period)
    del genesis["config"]["qbft"]
    genesis["config"]["istanbul"] = {"epoch": 30_000, "policy": 0, "ceil2Nby3Block": 0}
    accounts = [bytes.fromhex(address[2:]) for address in addresses]
    return genesis | {"extraData": "0x" + (bytes(32) + rlp.encode([accounts, b"", []])).hex()}


def record(consensus: str) -> None:
    """Play a period and audit it, with a tape running."""
    with (
        tempfile.TemporaryDirectory() as folder,
        Devnet.create(Path(folder) / "net", consensus="clique" if consensus == "clique" else "qbft") as network,
    ):
        confirmations = 3 if consensus == "clique" else 0
        keyring = Keyring.ephemeral()
        world = World(NodeChain(network.endpoints[0], keyring), uavs=4, vehicles=12, keyring=keyring)
        world.found()
        world.propose(1.0)
        world.propose_signed()
        world.allocate(100)
        network.wait_for_blocks(confirmations)
        recorder = RecordingChain(network.endpoints[3], Keyring.ephemeral(), confirmations=confirmations)
        report = audit_node(recorder, world.client.address)
        if not report.agrees:
            raise SystemExit(f"{consensus}: {report.differences[0]}")
        tape = {"contract": world.client.address, "confirmations": confirmations, "answers": recorder.tape}
        FOLDER.mkdir(exist_ok=True)
        (FOLDER / f"{consensus}.json.gz").write_bytes(gzip.compress(json.dumps(tape).encode(), mtime=0))
        print(consensus, dict(report.checked), report.given)


NEWCOMER = "0x" + "5e" * 20
"""Who is voted in and out: an account without a node, so that the four others must seal."""


def record_votes(consensus: str) -> None:
    """Three of four vote a newcomer in and out again: every header of that chain."""
    with tempfile.TemporaryDirectory() as folder, Devnet.create(Path(folder) / "net", consensus="qbft") as network:
        chain = NodeChain(network.endpoints[0], Keyring.ephemeral())
        for admit in (True, False):
            for url in network.endpoints[:3]:
                Endpoints([url], None, None).ask([("istanbul_propose", [NEWCOMER, admit])], 10.0)
            network.wait_for_blocks(9)
        headers = chain.blocks(range(chain.block_number + 1))
    (FOLDER / f"votes-{consensus}.json.gz").write_bytes(gzip.compress(json.dumps(headers).encode(), mtime=0))
    print(consensus, len(headers), "headers")


if __name__ == "__main__":
    qbft = devnet.genesis_of
    votes = sys.argv[1:] == ["votes"]
    for kind in ("qbft", "ibft") if votes else CONSENSUS:
        devnet.genesis_of = ibft if kind == "ibft" else qbft
        (record_votes if votes else record)(kind)
