"""The audit of a node: what validators sealed agrees, and whatever a node tells otherwise is named.

The chains are real ones, of GoQuorum and go-ethereum, on tape (`tapes.py`).
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tapes import CONSENSUS, PlayedChain, read
from typer.testing import CliRunner

from skyrelay.chain.proof import sealed
from skyrelay.chain.proof.audit import AuditReport, audit_node
from skyrelay.chain.proof.headers import Seal, header_hash
from skyrelay.chain.proof.trie import decode
from skyrelay.cli.main import app
from skyrelay.core.errors import ChainError

Tape = dict[str, Any]
TAPES = {consensus: read(consensus) for consensus in CONSENSUS}


def audit(tape: Tape) -> AuditReport:
    return audit_node(PlayedChain(tape["answers"], tape["confirmations"]), tape["contract"])


def answers(tape: Tape, method: str) -> list[tuple[str, Any]]:
    return [(request, answer) for request, answer in tape["answers"].items() if json.loads(request)[0] == method]


def told_otherwise(tape: Tape, request: str, change: Callable[[Any], None]) -> list[str]:
    """What the audit says when one answer is another."""
    changed = {**tape, "answers": tape["answers"] | {request: copy.deepcopy(tape["answers"][request])}}
    change(changed["answers"][request])
    try:
        return [str(difference) for difference in audit(changed).differences]
    except ChainError as error:
        return [str(error)]


@pytest.mark.parametrize("consensus", CONSENSUS)
def test_what_the_validators_sealed_agrees(consensus: str) -> None:
    report = audit(TAPES[consensus])
    assert report.differences == []
    assert report.checked["vehicles selected"] > 0
    assert report.checked["contracts' code proven"] == 2
    per_block = 1 if consensus == "clique" else 3
    assert report.checked["seals"] >= per_block * report.checked["blocks"]
    head = f"block {max(int(answer['number'], 16) for _, answer in answers(TAPES[consensus], 'eth_getBlockByNumber'))}"
    assert consensus == "clique" or head in report.given
    assert report.given["blocks sealed by"].count("0x") == 4


HEADER = [
    "parentHash", "sha3Uncles", "miner", "stateRoot", "transactionsRoot", "receiptsRoot", "logsBloom", "difficulty",
    "number", "gasLimit", "gasUsed", "timestamp", "extraData", "mixHash", "nonce", "hash",
]  # fmt: skip
TRANSACTION = ["nonce", "gasPrice", "gas", "to", "value", "input", "v", "r", "s", "hash", "from"]
RECEIPT = ["status", "cumulativeGasUsed", "logsBloom"]


def flipped(text: str, place: int) -> str:
    """Hexadecimal with one digit changed, the number of digits as it was; something where there was nothing."""
    if text == "0x":
        return "0x12"
    at = 2 + place % (len(text) - 2)
    digit = int(text[at], 16)
    return text[:at] + f"{digit ^ 1:x}" + text[at + 1 :]


@settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_field_that_a_node_tells_otherwise_is_named(data: st.DataObject) -> None:
    tape = TAPES[data.draw(st.sampled_from(CONSENSUS))]
    kind = data.draw(st.sampled_from(["header", "transaction", "receipt", "log", "proof"]))
    whole = [pair for pair in answers(tape, "eth_getBlockByNumber") if json.loads(pair[0])[1][1]]
    place = data.draw(st.integers(0, 10_000))
    if kind == "header":
        request, _ = data.draw(st.sampled_from(whole))
        field = data.draw(st.sampled_from(HEADER))
    elif kind == "transaction":
        request, _ = data.draw(st.sampled_from([pair for pair in whole if pair[1]["transactions"]]))
        field = data.draw(st.sampled_from(TRANSACTION))
    else:
        method = "eth_getProof" if kind == "proof" else "eth_getTransactionReceipt"
        pairs = [pair for pair in answers(tape, method) if kind != "log" or pair[1]["logs"]]
        request, _ = data.draw(st.sampled_from(pairs))
        field = data.draw(st.sampled_from(RECEIPT if kind == "receipt" else ["address", "topics", "data"]))

    def change(answer: Any) -> None:
        if kind == "transaction":
            answer = answer["transactions"][place % len(answer["transactions"])]
        elif kind == "log":
            answer = answer["logs"][place % len(answer["logs"])]
        if kind == "proof":
            proof = answer["accountProof"]
            proof[place % len(proof)] = flipped(proof[place % len(proof)], place)
        elif field == "topics" and kind == "log":
            answer["topics"][0] = flipped(answer["topics"][0], place)
        elif answer[field] is None:
            answer[field] = "0x" + "12" * 20
        else:
            answer[field] = flipped(answer[field], place)

    assert told_otherwise(tape, request, change)


@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_any_digit_of_the_code_that_a_node_tells_otherwise_is_named(data: st.DataObject) -> None:
    """Also where the constructor wrote: of those places only the state's proof tells."""
    tape = TAPES[data.draw(st.sampled_from(CONSENSUS))]
    number = data.draw(st.integers(0, 1))
    request, code = answers(tape, "eth_getCode")[number]
    place = data.draw(st.integers(0, 30_000))
    if number == 0 and data.draw(st.booleans()):
        place = code.index("7f0000000000000000000000", 1000) + data.draw(st.integers(0, 63))
    changed = {**tape, "answers": tape["answers"] | {request: flipped(code, place)}}
    try:
        assert any(difference.place.startswith("code of ") for difference in audit(changed).differences)
    except ChainError as error:
        assert "code of this version" in str(error)  # noqa: PT017  (either is right)


def blocks_with_events(tape: Tape) -> list[str]:
    return [
        request
        for request, answer in answers(tape, "eth_getBlockByNumber")
        if json.loads(request)[1][1] and answer["transactions"]
    ]


@pytest.mark.parametrize("consensus", CONSENSUS)
def test_an_event_that_a_node_keeps_to_itself_is_missed(consensus: str) -> None:
    tape = TAPES[consensus]
    for request, logs in answers(tape, "eth_getLogs"):
        lines = told_otherwise(tape, request, lambda told: told.pop(len(told) // 2))
        assert any(line.startswith(f"eth_getLogs: {len(logs) - 1} logs, should be the {len(logs)}") for line in lines)
    request = blocks_with_events(tape)[-1]
    lines = told_otherwise(tape, request, lambda block: block["transactions"].pop())
    assert any(": transactions: " in line for line in lines)
    receipt = next(request for request, answer in answers(tape, "eth_getTransactionReceipt") if answer["logs"])
    assert any(": receipts: " in line for line in told_otherwise(tape, receipt, lambda told: told["logs"].pop()))


@pytest.mark.parametrize("spelled", ["0x {}", "{}", " 0x{}", "0x{} "])
def test_an_event_under_an_address_of_another_spelling_is_missed_or_refused(spelled: str) -> None:
    """The receipts' root is of bytes: hidden from a comparison of texts, the log would still be under it."""
    tape = copy.deepcopy(TAPES["qbft"])
    logs = answers(tape, "eth_getLogs")
    hidden = logs[0][1][-1]["topics"][0]
    for request, entries in logs:
        tape["answers"][request] = [entry for entry in entries if entry["topics"][0] != hidden]
    for _, receipt in answers(tape, "eth_getTransactionReceipt"):
        for entry in receipt["logs"]:
            if entry["topics"][0] == hidden:
                entry["address"] = spelled.format(entry["address"][2:])
    assert any("receipts not readable" in str(difference) for difference in audit(tape).differences)


def test_lists_without_end_in_a_header_or_a_proof_are_no_crash() -> None:
    deep = b"\xc0"
    for _ in range(20_000):
        size = len(deep).to_bytes(3, "big")
        deep = b"\xfa" + size + deep
    tape = TAPES["qbft"]
    request = blocks_with_events(tape)[1]
    lines = told_otherwise(tape, request, lambda block: block.update(extraData="0x" + deep.hex()))
    assert any("not readable" in line for line in lines)
    with pytest.raises(ValueError, match="too deep"):
        decode(deep)


@pytest.mark.parametrize("consensus", ["qbft", "ibft"])
def test_seals_of_too_few_are_named(consensus: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def with_one_less(header: dict[str, Any]) -> tuple[str, Seal]:
        digest, seal = header_hash(header)
        return digest, replace(seal, signers=frozenset(sorted(seal.signers)[:2]))

    monkeypatch.setattr(sealed, "header_hash", with_one_less)
    lines = [str(difference) for difference in audit(TAPES[consensus]).differences]
    assert lines
    assert all(line.endswith("seals: of 2 validators, should be of 3 at least") for line in lines)


def test_validators_that_nobody_before_them_knows_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that makes up a chain of its own from some block on, with as many keys as it likes."""
    tape = TAPES["qbft"]
    usurpers = frozenset(f"0x{i:040x}" for i in range(4))
    head = max(int(answer["number"], 16) for _, answer in answers(tape, "eth_getBlockByNumber"))

    def usurped(header: dict[str, Any]) -> tuple[str, Seal]:
        digest, seal = header_hash(header)
        others = Seal(usurpers, usurpers, min(usurpers))
        return digest, others if int(header["number"], 16) > head - 2 else seal

    monkeypatch.setattr(sealed, "header_hash", usurped)
    report = audit(tape)
    place = f"block {head - 1}: v"  # the tape has no blocks before the contract's, where votes would be looked for
    assert [one.place[: len(place) + 4] for one in report.differences] == [f"{place}otes", f"{place}alid"]
    assert report.checked["changes of the validators"] == 1
    assert all(usurper in report.given["blocks sealed by"] for usurper in usurpers)


def test_an_answer_of_another_form_is_a_difference_and_no_crash() -> None:
    tape = TAPES["qbft"]
    request = blocks_with_events(tape)[1]
    for change in (
        lambda block: block.pop("extraData"),
        lambda block: block.update(extraData="0x"),
        lambda block: block.update(transactions=None),
        lambda block: block.update(logsBloom="none"),
        lambda block: block["transactions"][0].update(type="0x7"),
        lambda block: block["transactions"][0].update(gas="-0x5"),
        lambda block: block["transactions"][0].update(value="0x1_0"),
        lambda block: block.update(timestamp="-0x5"),
    ):
        assert any("not readable" in line for line in told_otherwise(tape, request, change))
    receipt = next(request for request, answer in answers(tape, "eth_getTransactionReceipt") if answer["logs"])
    lines = told_otherwise(tape, receipt, lambda told: told.update(logs=[{}]))
    assert any("receipts not readable" in line for line in lines)


def test_a_log_that_announces_more_than_any_memory_holds_is_named() -> None:
    tape = TAPES["qbft"]
    request, length = next(
        (request, place)
        for request, answer in answers(tape, "eth_getTransactionReceipt")
        for log in answer["logs"]
        # registerModel's CID of 36 bytes: the last of the places where 0x24 stands alone is its length.
        if (place := log["data"].rfind("0" * 62 + "24")) > 0
    )

    def change(answer: Any) -> None:
        for log in answer["logs"]:
            log["data"] = log["data"][:length] + "ff" * 32 + log["data"][length + 64 :]

    assert any(": receipts: " in line for line in told_otherwise(tape, request, change))


def test_a_wrong_address_is_refused() -> None:
    tape = TAPES["qbft"]
    nowhere = "0x" + "12" * 20
    tape = {
        **tape,
        "contract": nowhere,
        "answers": tape["answers"] | {json.dumps(["eth_getCode", [nowhere, "latest"]]): "0x"},
    }
    with pytest.raises(ChainError, match="a contract's address"):
        audit(tape)


def test_the_command_audits_a_node(monkeypatch: pytest.MonkeyPatch) -> None:
    tape = TAPES["qbft"]
    monkeypatch.setattr("skyrelay.chain.node.chain.NodeChain", lambda *_, **__: PlayedChain(tape["answers"]))
    command = ["audit", "--chain", "https://tape", "--contract", tape["contract"]]
    told = CliRunner().invoke(app, command, standalone_mode=False)
    assert told.return_value == 0
    assert "All agree." in told.output
    assert "Compare with what you know" in told.output
    as_json = json.loads(CliRunner().invoke(app, [*command, "--json"], standalone_mode=False).stdout)
    assert as_json["agrees"] is True
    assert as_json["given"] == audit(tape).given
