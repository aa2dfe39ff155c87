"""What the doctor says of nodes that are there, are another network's, or are none."""

from __future__ import annotations

import json
import socket

from typer.testing import CliRunner

from skyrelay.chain.node.doctor import NodeHealth, _findings, diagnose
from skyrelay.chain.proof.headers import Seal
from skyrelay.cli.main import app


def test_a_node_that_does_not_answer_is_named_without_its_credentials() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    found = diagnose([f"http://me:secret@127.0.0.1:{port}/key", "ftp://me:secret@host"], 0.1)
    assert not found.moves
    assert [finding.split(":")[0] for finding in found.findings] == ["http", "an address does not answer"]
    assert "secret" not in str(found)


def test_the_command_tells_and_counts() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = ["chain", "doctor", f"http://127.0.0.1:{port}", "--watch", "0.5", "--json"]
    told = CliRunner().invoke(app, command, standalone_mode=False)
    assert told.return_value == 1
    assert json.loads(told.output)["moves"] is False


VALIDATORS = frozenset(f"0x{i:040x}" for i in range(4))


def healthy(name: str, **changes: object) -> NodeHealth:
    seal = Seal(VALIDATORS, VALIDATORS)
    node = NodeHealth(
        name, chain_id="0x1", genesis="0xa", height=9, timestamp=2**40, peers=3, pending=0, queued=0, clock=0.0
    )
    node.hashes, node.seals = {8: "0x8", 9: "0x9"}, {8: seal, 9: seal}
    node.timestamp = 0
    for key, value in changes.items():
        setattr(node, key, value)
    return node


def told(*nodes: NodeHealth, moves: bool = False) -> str:
    return "\n".join(_findings(nodes, moves, 5.0))


def test_each_kind_of_trouble_is_named() -> None:
    well = healthy("a")
    assert told(well, healthy("b"), moves=True) == ""
    assert "different networks, by their chain ids" in told(well, healthy("b", chain_id="0x2"))
    assert "different networks, by their first blocks" in told(well, healthy("b", genesis="0xb"))
    assert "a fork: block 9 differs" in told(well, healthy("b", hashes={8: "0x8", 9: "0x99"}), moves=True)
    assert "b is 5 blocks behind" in told(well, healthy("b", height=4, hashes={4: "0x4"}), moves=True)
    assert "b has no peers" in told(well, healthy("b", peers=0), moves=True)
    assert "b: its clock is -30 s off" in told(well, healthy("b", clock=-30.0), moves=True)
    assert "7 transactions wait for an earlier one of their sender" in told(well, healthy("b", queued=7), moves=True)
    assert "pool: 12 transactions wait" in told(healthy("a", pending=12))
    assert "no quorum: 3 of 4" in told(healthy("a", peers=1))
    silent = Seal(VALIDATORS - {f"0x{3:040x}"}, VALIDATORS)
    assert f"signed none of the last 2 blocks: 0x{3:040x}" in told(healthy("a", seals={8: silent, 9: silent}))
