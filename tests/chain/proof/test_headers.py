"""Transactions of every kind by their signed bytes, and headers without seals."""

from __future__ import annotations

from typing import Any

import pytest
from eth_account import Account
from tapes import read

from skyrelay.chain.proof.headers import (
    Seal,
    header_hash,
    raw_transaction,
    receipts_root,
    transaction,
    transactions_root,
)

KEY = "0x" + "11" * 32
RECIPIENT = "0x" + "ab" * 20
ACCESS = [{"address": "0x" + "cd" * 20, "storageKeys": ["0x" + "01" * 32, "0x" + "00" * 32]}]
KINDS: dict[str, dict[str, Any]] = {
    "before EIP-155": {"gasPrice": 0},
    "EIP-155": {"gasPrice": 7, "chainId": 1337},
    "EIP-2930": {"type": 1, "gasPrice": 7, "chainId": 1337, "accessList": ACCESS},
    "EIP-1559": {"type": 2, "maxFeePerGas": 9, "maxPriorityFeePerGas": 0, "chainId": 1337, "accessList": ACCESS},
}


@pytest.mark.parametrize("to", [RECIPIENT, None])
@pytest.mark.parametrize("kind", KINDS)
def test_a_transactions_bytes_hash_and_sender(kind: str, to: str | None) -> None:
    fields = {"nonce": 300, "gas": 90_000, "value": 0, "data": "0x00ff", **KINDS[kind]}
    signed = Account.sign_transaction(fields | ({"to": bytes.fromhex(to[2:])} if to else {}), KEY)
    numbers = {name: hex(value) for name, value in fields.items() if isinstance(value, int)}
    told = numbers | {"to": to, "input": "0x00ff", "accessList": fields.get("accessList")}
    told |= {"v": hex(signed.v), "r": hex(signed.r), "s": hex(signed.s)}
    assert raw_transaction(told) == bytes(signed.raw_transaction)
    found = transaction(told)
    assert found.hash == "0x" + bytes(signed.hash).hex()
    assert found.sender == Account.from_key(KEY).address.lower()
    assert found.to == to


def test_a_kind_that_is_not_known_is_refused() -> None:
    told = dict.fromkeys(("nonce", "gasPrice", "gas", "value", "input", "v", "r", "s"), "0x1")
    with pytest.raises(ValueError, match="a transaction of type 3"):
        raw_transaction(told | {"type": "0x3", "to": None, "input": "0x"})


def test_a_header_without_a_seal_vouches_by_nobody() -> None:
    answers = read("clique")["answers"]
    header = next(a for r, a in answers.items() if "eth_getBlockByNumber" in r and "true" in r)
    digest, seal = header_hash(header)
    assert (digest, len(seal.signers)) == (header["hash"], 1)
    digest, seal = header_hash(header | {"extraData": "0x" + "00" * 32})
    assert digest != header["hash"]
    assert seal == Seal(frozenset(), None)
    assert seal.quorum == 0


@pytest.mark.parametrize(("validators", "quorum"), [(1, 1), (2, 2), (3, 2), (4, 3), (5, 4), (6, 4), (7, 5), (10, 7)])
def test_a_quorum_is_two_thirds(validators: int, quorum: int) -> None:
    assert Seal(frozenset(), frozenset(str(i) for i in range(validators))).quorum == quorum


def test_the_kind_of_a_receipt_counts() -> None:
    receipt = {"status": "0x1", "cumulativeGasUsed": "0x5208", "logsBloom": "0x" + "00" * 256, "logs": []}
    assert receipts_root([receipt]) != receipts_root([receipt | {"type": "0x2"}])
    assert receipts_root([receipt]) == receipts_root([receipt | {"type": "0x0"}])
    assert receipts_root([]) == transactions_root([])
