"""What attackers tried on an audit and on a client: each attack, by those who can play it."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from chain_rounds import World, write_run
from json_rpc_node import Node
from tapes import PlayedChain, read
from typer.testing import CliRunner

from skyrelay.chain.abi import contract, extension
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Call
from skyrelay.chain.client import IovClient, Settings, VehicleRecord, _parameters
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.embedded.ledger import FILE_NAME, Genesis, Transaction, content_hash, encode_genesis
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.proof.audit import AuditReport, audit_node, audit_run
from skyrelay.chain.proof.headers import header_hash
from skyrelay.chain.proof.replay import replay
from skyrelay.chain.proof.root import TrustRoot
from skyrelay.cli.main import app
from skyrelay.core.errors import ChainError, UsageError

TAPES = {consensus: read(consensus) for consensus in ("qbft", "ibft", "clique")}
ISTANBUL_FREE = "0x" + "00" * 32


def head_of(tape: dict[str, Any]) -> int:
    chain = PlayedChain(tape["answers"], tape["confirmations"])
    return chain.block_number


def with_blocks(tape: dict[str, Any], count: int, change: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
    """The chain with empty blocks on top, as a node without a key can make them."""
    head = head_of(tape)
    changed = copy.deepcopy(tape["answers"])
    parent = changed[json.dumps(["eth_getBlockByNumber", [hex(head), True]])]
    for number in range(head + 1, head + 1 + count):
        block = {**parent, "number": hex(number), "parentHash": parent["hash"], "transactions": []}
        block["logsBloom"] = "0x" + "00" * 256
        block["transactionsRoot"] = block["receiptsRoot"] = (
            "0x56e81f171bcc55a6ff8345e692c0f86e5b48e01b996cadc001622fb5e363b421"
        )
        change(block)
        block["hash"] = header_hash(block)[0]
        changed[json.dumps(["eth_getBlockByNumber", [hex(number), True]])] = parent = block
    top = hex(head + count)
    changed[json.dumps(["eth_blockNumber", []])] = hex(head + count + tape["confirmations"])
    for request, answer in list(changed.items()):
        method, parameters = json.loads(request)
        if method == "eth_getLogs" and parameters[0]["toBlock"] == hex(head):
            changed[json.dumps([method, [parameters[0] | {"toBlock": top}]])] = answer
        if method == "eth_getProof" and parameters[2] == hex(head):
            changed[json.dumps([method, [*parameters[:2], top]])] = answer
    return {**tape, "answers": changed}


def audit(tape: dict[str, Any], root: TrustRoot | None = None) -> AuditReport:
    return audit_node(PlayedChain(tape["answers"], tape["confirmations"]), tape["contract"], root=root)


def unsealed(block: dict[str, Any]) -> None:
    block.update(mixHash=ISTANBUL_FREE, extraData="0x")


def sealed_by_a_stranger(block: dict[str, Any]) -> None:
    """As Clique seals: one key, and no list of who may."""
    from eth_keys.datatypes import PrivateKey

    key = PrivateKey(b"\x07" * 32)
    block.update(mixHash=ISTANBUL_FREE, extraData="0x" + "00" * 32)
    digest = bytes.fromhex(header_hash(block)[0][2:])
    block["extraData"] += key.sign_msg_hash(digest).to_bytes().hex()


# An unsealed tail


@pytest.mark.parametrize("consensus", ["qbft", "ibft", "clique"])
@pytest.mark.parametrize("count", [1, 3])
def test_a_tail_that_nobody_sealed_is_a_difference(consensus: str, count: int) -> None:
    report = audit(with_blocks(TAPES[consensus], count, unsealed))
    first = head_of(TAPES[consensus]) + 1
    assert [difference.place for difference in report.differences] == [
        f"block {number}: sealed by" for number in range(first, first + count)
    ]


@pytest.mark.parametrize("consensus", ["qbft", "ibft"])
def test_a_tail_that_a_stranger_sealed_is_a_difference(consensus: str) -> None:
    report = audit(with_blocks(TAPES[consensus], 1, sealed_by_a_stranger))
    assert report.differences[0].place == f"block {head_of(TAPES[consensus]) + 1}: sealed by"


def test_a_chain_that_nobody_sealed_is_a_difference_unless_asked_for() -> None:
    tape = copy.deepcopy(TAPES["qbft"])
    parent = None
    blocks = sorted(
        (json.loads(request)[1][0], request)
        for request in tape["answers"]
        if json.loads(request)[0] == "eth_getBlockByNumber" and json.loads(request)[1][1]
    )
    for _, request in sorted(blocks, key=lambda pair: int(pair[0], 16)):
        block = tape["answers"][request]
        unsealed(block)
        block["parentHash"] = parent or block["parentHash"]
        block["hash"] = parent = header_hash(block)[0]
    head = head_of(tape)
    assert [d.place for d in audit(tape).differences] == [f"block {head}: sealed by"]
    assert audit(tape, TrustRoot(unsealed=True)).agrees
    assert audit(tape, TrustRoot(head=parent)).agrees
    pinned = audit(tape, TrustRoot.of(["0x" + "12" * 20], unsealed=True))
    assert [d.place for d in pinned.differences] == [f"block {head}: sealed by"]


@pytest.mark.parametrize("consensus", ["qbft", "ibft", "clique"])
def test_validators_and_a_block_can_be_pinned(consensus: str) -> None:
    tape = TAPES[consensus]
    given = audit(tape).given
    sealers = re.findall("0x[0-9a-f]{40}", given["blocks sealed by"])
    head = given[f"block {head_of(tape)}"]
    assert audit(tape, TrustRoot.of(sealers, head)).agrees
    assert not audit(tape, TrustRoot.of([*sealers[:-1], "0x" + "12" * 20])).agrees
    wrong = audit(tape, TrustRoot.of((), "0x" + "12" * 32))
    assert [d.expected for d in wrong.differences] == ["that block among them"]


@pytest.mark.parametrize("text", ["", "0x12", "12" * 20, "0x" + "zz" * 20, "0x" + "12" * 32])
def test_a_pin_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="hexadecimal"):
        TrustRoot.of([text])


@pytest.mark.parametrize("consensus", ["qbft", "ibft", "clique"])
def test_a_client_believes_no_node_of_other_validators(consensus: str) -> None:
    tape = TAPES[consensus]
    block = tape["answers"][json.dumps(["eth_getBlockByNumber", [hex(head_of(tape)), True]])]
    digest, seal = header_hash(block)

    def ask(method: str, parameters: list[Any]) -> Any:
        return block if method == "eth_getBlockByNumber" or parameters[0] == digest else None

    sealers = sorted(seal.validators or seal.signers)
    TrustRoot.of(sealers, digest).check("node", ask)
    with pytest.raises(ChainError, match="node: sealed by"):
        TrustRoot.of([*sealers[1:], "0x" + "12" * 20]).check("node", ask)
    with pytest.raises(ChainError, match="node: block"):
        TrustRoot.of((), "0x" + "12" * 32).check("node", ask)
    forged = {**block, "gasUsed": "0x1"}
    with pytest.raises(ChainError, match="node: "):
        TrustRoot.of(sealers).check("node", lambda *_: forged)
    with Node() as node, pytest.raises(ChainError, match=r"sealed by|block"):
        NodeChain(node.url, Keyring.ephemeral(), root=TrustRoot.of(sealers))


# Another contract behind the genuine code


def other_extension() -> bytes:
    """Creates a contract that answers everything with 32 bytes of 7, in as many bytes as the genuine one."""
    code = bytes.fromhex("600760005260206000f3")
    return bytes([0x60, len(code), 0x60, 12, 0x60, 0, 0x39, 0x60, len(code), 0x60, 0, 0xF3]) + code


def deploy(chain: Any, creation: bytes) -> str:
    (receipt,) = chain.send([Call(chain.account("admin"), None, creation, 8_000_000)])
    assert receipt.created is not None
    return str(receipt.created)


def forged_creation(runtime: bytes, data: bytes, topics: tuple[bytes, ...]) -> bytes:
    """A constructor that logs ``data`` under ``topics`` and leaves ``runtime``."""

    def push3(number: int) -> bytes:
        return b"\x62" + number.to_bytes(3, "big")

    body = b"".join(b"\x7f" + topic for topic in reversed(topics))
    size = 3 * 4 + 1 + len(body) + 2 * 4 + 1 + 2 * 4 + 1
    copy_all = push3(len(data) + len(runtime)) + push3(size) + push3(0) + b"\x39"
    log = body + push3(len(data)) + push3(0) + bytes([0xA0 + len(topics)])
    leave = push3(len(runtime)) + push3(len(data)) + b"\xf3"
    code = copy_all + log + leave
    assert len(code) == size
    return code + data + runtime


def forged_contract(chain: Any) -> str:
    """The genuine runtime with an extension of the deployer's, behind a Deployed event that names the genuine one."""
    scratch = EmbeddedChain()
    honest = deploy(scratch, extension().creation(_parameters(Settings())))
    genuine = deploy(scratch, contract().creation(_parameters(Settings()), honest))
    (event,) = [log for log in scratch.logs(genuine, 0, 9) if log.topics[0] == contract().topic("Deployed")]
    known = deploy(chain, extension().creation(_parameters(Settings())))
    evil = deploy(chain, other_extension())

    def renamed(data: bytes, address: str) -> bytes:
        return data.replace(bytes.fromhex(honest[2:]), bytes.fromhex(address[2:]))

    runtime = renamed(scratch.code(genuine), evil)
    assert runtime != scratch.code(genuine)
    topics = tuple(renamed(topic, known) for topic in event.topics)
    return deploy(chain, forged_creation(runtime, renamed(event.data, known), topics))


def test_another_extension_behind_the_genuine_event_is_refused() -> None:
    chain = EmbeddedChain()
    address = forged_contract(chain)
    with pytest.raises(ChainError, match="code of this version's SkyRelay contract"):
        IovClient.connect(chain, address)
    with Node() as node:
        remote = NodeChain(node.url, Keyring(b"k" * 32), poll=0.01)
        address = forged_contract(remote)
        with pytest.raises(ChainError, match="code of this version's SkyRelay contract"):
            IovClient.connect(remote, address)


def test_genuine_code_that_another_constructor_left_is_refused() -> None:
    """Byte for byte the code of the contract, with storage of the deployer's choice."""
    chain = EmbeddedChain()
    helper = deploy(chain, extension().creation(_parameters(Settings())))
    genuine = deploy(chain, contract().creation(_parameters(Settings()), helper))
    IovClient.connect(chain, genuine)
    (event,) = [log for log in chain.logs(genuine, 0, 9) if log.topics[0] == contract().topic("Deployed")]
    forged = deploy(chain, forged_creation(chain.code(genuine), event.data, event.topics))
    assert chain.code(forged) == chain.code(genuine)
    with pytest.raises(ChainError, match="another one was created"):
        IovClient.connect(chain, forged)


def test_a_contract_that_another_contract_created_is_refused() -> None:
    chain = EmbeddedChain()
    helper = deploy(chain, extension().creation(_parameters(Settings())))
    creation = contract().creation(_parameters(Settings()), helper)
    size = b"\x62" + len(creation).to_bytes(3, "big")
    # Copies what follows it into memory and creates from it.
    factory = size + bytes.fromhex("6018600039") + size + bytes.fromhex("60006000f060006000f3")
    factory = factory.ljust(0x18, b"\0")
    assert len(factory) == 0x18
    (receipt,) = chain.send([Call(chain.account("admin"), None, factory + creation, 20_000_000)])
    assert receipt.status
    (made,) = {log.address for log in receipt.logs}
    with pytest.raises(ChainError, match="a transaction of its own"):
        IovClient.connect(chain, made)


def test_a_run_on_another_extension_differs(tmp_path: Path) -> None:
    write_run(tmp_path, lambda world: world.propose(1.0), uavs=2, vehicles=3)
    with EmbeddedChain(tmp_path / "chain") as chain:
        address = forged_contract(chain)
        summary = {"chain_head": chain.head, "blocks": chain.block_number, "contract": address}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    assert [d.place for d in audit_run(tmp_path).differences][:1] == ["summary.json: contract"]


# Calls by contracts


def calling(address: str, data: bytes, *, again: bool = False) -> bytes:
    """A constructor that calls a contract; ``again``: it leaves code that makes the same call whenever it is called."""

    def push2(number: int) -> bytes:
        return b"\x61" + number.to_bytes(2, "big")

    def call(start: int) -> bytes:
        """The call, its data being behind ``start`` in the code."""
        copied = push2(len(data)) + push2(start) + b"\x60\x00\x39"
        nothing = b"\x60\x00\x60\x00"
        to = b"\x73" + bytes.fromhex(address[2:])
        return copied + nothing + push2(len(data)) + nothing + to + b"\x5a\xf1"

    size = len(call(0))
    code = call(size + 1) + b"\x00" + data if again else b""
    tail = 13
    leave = push2(len(code)) + b"\x80" + push2(size + tail) + b"\x60\x00\x39\x60\x00\xf3"
    assert len(leave) == tail
    return call(size + tail + len(code)) + leave + code + data


@pytest.mark.parametrize("again", [False, True])
def test_a_contract_that_is_a_member_fails_no_audit(tmp_path: Path, again: bool) -> None:
    def build(world: World) -> None:
        world.propose(1.0)
        anyone = world.chain.account("anyone")
        call = world.client.register_vehicle(anyone, VehicleRecord(10.0, 10.0, 100, 1))
        created = deploy(world.chain, calling(world.client.address, call.data, again=again))
        assert any(event.args.get("vehicle") == created for event in world.client.events())
        if again:
            update = world.client.update_vehicle_info(anyone, VehicleRecord(20.0, 10.0, 100, 1))
            other = deploy(world.chain, calling(world.client.address, call.data, again=True))
            assert other != created
            world.chain.send([Call(anyone, created, update.data)])
        world.allocate(100)

    write_run(tmp_path, build, uavs=2, vehicles=4)
    assert audit_run(tmp_path).differences == []


# Records that take for ever


def record(folder: Path, gas_limit: int, creation: bytes, gas: int) -> None:
    """A record of one transaction that says what it likes."""
    folder.mkdir()
    digest, first = encode_genesis(Genesis(31337, gas_limit, 1))
    sent = Transaction("0x" + "11" * 20, 0, None, gas, creation)
    block = {
        "number": 1,
        "parent": digest,
        "timestamp": 1,
        "gas_used": gas,
        "transactions": [
            {
                "hash": sent.hash(31337),
                "sender": sent.sender,
                "nonce": 0,
                "to": None,
                "gas": gas,
                "data": creation.hex(),
            }
        ],
        "receipts": [
            {"status": False, "gas_used": gas, "created": None, "output": "", "halt": "out of gas", "logs": []}
        ],
        "writes": {"nonces": {sent.sender: 1}, "codes": {}, "storage": {}},
    }
    content = json.dumps(block, separators=(",", ":")).encode()
    (folder / FILE_NAME).write_bytes(first + content_hash(content)[2:].encode() + b" " + content + b"\n")


LOOP = bytes.fromhex("5b600056")


@pytest.mark.parametrize("gas", [10**9, 10**12, 10**18])
def test_a_record_that_chooses_its_own_gas_limit_ends(tmp_path: Path, gas: int) -> None:
    record(tmp_path / "chain", gas, LOOP, gas)
    differences = replay(tmp_path / "chain").differences
    assert any("gas limit" in difference.place for difference in differences)


def test_a_record_within_the_limits_is_executed(tmp_path: Path) -> None:
    record(tmp_path / "chain", 30_000_000, LOOP, 1_000_000)
    assert replay(tmp_path / "chain").differences == []


def test_time_ends_what_gas_does_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Each call of an account without code copies a megabyte, for a hundred gas.
    monkeypatch.setattr("skyrelay.chain.proof.replay.SECONDS", 0.0)
    monkeypatch.setattr("skyrelay.chain.proof.replay.SECONDS_PER_BYTE", 0.0)
    code = bytes.fromhex("5b60006000620f42406000600061dead5af150600056")
    record(tmp_path / "chain", 30_000_000, code, 30_000_000)
    assert any("within the time" in difference.expected for difference in replay(tmp_path / "chain").differences)


def test_a_record_can_be_pinned_by_its_head(tmp_path: Path) -> None:
    write_run(tmp_path, lambda world: world.propose(1.0), uavs=2, vehicles=3)
    head = json.loads((tmp_path / "summary.json").read_text())["chain_head"]
    assert audit_run(tmp_path, head=head).agrees
    (difference,) = audit_run(tmp_path, head="0x" + "12" * 32).differences
    assert (difference.place, difference.found) == ("the record's last block", head)
    told = CliRunner().invoke(app, ["audit", str(tmp_path), "--head", "x"], standalone_mode=False)
    assert isinstance(told.exception, UsageError)


VALUES = [None, True, 1, -1, 1.5, 1e999, "", "x", "0x" + "12" * 20, [], {}, "0x" + "G" * 40, 2**300]
PLACES = [
    ("transactions", 0, "sender"),
    ("transactions", 0, "nonce"),
    ("transactions", 0, "to"),
    ("transactions", 0, "gas"),
    ("transactions", 0, "data"),
    ("transactions", 0, "hash"),
    ("transactions", 0),
    ("receipts", 0, "status"),
    ("receipts", 0, "created"),
    ("receipts", 0, "halt"),
    ("receipts", 0, "logs"),
    ("receipts", 0),
    ("writes", "nonces"),
    ("writes", "codes"),
    ("writes", "storage"),
    ("writes",),
    ("transactions",),
    ("receipts",),
    ("timestamp",),
    ("number",),
    ("parent",),
]


@pytest.mark.parametrize("place", PLACES, ids=lambda place: "-".join(map(str, place)))
def test_a_value_of_another_kind_is_a_difference_and_no_crash(tmp_path: Path, place: tuple[Any, ...]) -> None:
    record(tmp_path / "chain", 30_000_000, LOOP, 60_000)
    path = tmp_path / "chain" / FILE_NAME
    first, line = path.read_bytes().splitlines()
    for value in VALUES:
        tree = json.loads(line[65:])
        inner = tree
        for key in place[:-1]:
            inner = inner[key]
        if inner[place[-1]] == value and type(inner[place[-1]]) is type(value):
            continue
        inner[place[-1]] = value
        content = json.dumps(tree, separators=(",", ":")).encode()
        path.write_bytes(first + b"\n" + content_hash(content)[2:].encode() + b" " + content + b"\n")
        found: list[Any]
        try:
            found = replay(tmp_path / "chain").differences
        except ChainError as error:
            found = [error]
        if not (place[-1] == "timestamp" and value == 1):  # the times of blocks are free
            assert found, (place, value)
        try:
            EmbeddedChain(tmp_path / "chain").close()
        except ChainError as error:
            assert "\n" not in str(error)  # noqa: PT017  (any other exception is the failure)
