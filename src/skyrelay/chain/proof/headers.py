"""Ethereum blocks as a node tells them, worked out again: hashes, roots, senders, and who sealed them.

A block's hash covers its header, the header the roots of its transactions and receipts, and the validators sign the
hash: what a node tells is either what they sealed or does not fit. Every function raises `UNREADABLE` where the node's
answer is not of the form that Ethereum's JSON-RPC gives.

Source: Ethereum Yellow Paper, section 4.3; EIP-155, 225 (Clique), 1559, 2718, 2930; the headers of GoQuorum's QBFT and
IBFT.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eth_hash.auto import keccak
from eth_keys.datatypes import Signature
from eth_keys.exceptions import BadSignature
from eth_utils.exceptions import ValidationError

from skyrelay.chain.chain import LogEntry
from skyrelay.chain.proof.trie import Node, decode, encode, list_root
from skyrelay.chain.proof.votes import Ballot
from skyrelay.core.untrusted import hex_bytes, hex_number

UNREADABLE = (
    KeyError,
    IndexError,
    TypeError,
    ValueError,
    AttributeError,
    OverflowError,
    BadSignature,
    ValidationError,
)
"""What an answer of the wrong form raises."""

_ISTANBUL = "0x63746963616c2062797a616e74696e65206661756c7420746f6c6572616e6365"
"""mixHash of QBFT's and IBFT's headers."""
_VANITY, _SEAL = 32, 65
_IBFT_COMMIT = b"\x02"
_ADMITS = {b"\xff": True, b"\x00": False, b"": False}
_IBFT_VOTES = {b"\xff" * 8: b"\xff", bytes(8): b""}
"""By the nonce of IBFT's headers; where there is no vote, the candidate is nobody, who is no validator anyway."""

_HEADER = (
    ("parentHash", False),
    ("sha3Uncles", False),
    ("miner", False),
    ("stateRoot", False),
    ("transactionsRoot", False),
    ("receiptsRoot", False),
    ("logsBloom", False),
    ("difficulty", True),
    ("number", True),
    ("gasLimit", True),
    ("gasUsed", True),
    ("timestamp", True),
    ("extraData", False),
    ("mixHash", False),
    ("nonce", False),
)
"""Fields of a header in their order, and whether they are numbers; London appends the base fee."""


@dataclass(frozen=True, slots=True)
class Seal:
    """Who vouches for a block.

    Attributes:
        signers: of the seals in it; none where the protocol puts none into its headers.
        validators: that the header names as entitled; None where it names none (Clique between its checkpoints).
        proposer: of the block, and ``ballot`` its vote on who is a validator, where QBFT's or IBFT's header has them.
    """

    signers: frozenset[str]
    validators: frozenset[str] | None
    proposer: str | None = None
    ballot: Ballot | None = None

    @property
    def quorum(self) -> int:
        """How many of the validators must have signed: two thirds, rounded up."""
        return 0 if self.validators is None else -(-2 * len(self.validators) // 3)


@dataclass(frozen=True, slots=True)
class Transaction:
    """What a transaction's signed bytes say: hash, sender, nonce, recipient (None: it creates a contract), input."""

    hash: str
    sender: str
    nonce: int
    to: str | None
    data: bytes


def header_hash(header: Mapping[str, Any]) -> tuple[str, Seal]:
    """A block's hash and its seal.

    QBFT and IBFT leave the commit seals out of the hash (QBFT the round, too), as they come after it; Clique's seal is
    in the hash and signs all but itself.
    """
    fields = [_quantity(header[name]) if number else hex_bytes(header[name]) for name, number in _HEADER]
    if "baseFeePerGas" in header:
        fields.append(_quantity(header["baseFeePerGas"]))
    place = [name for name, _ in _HEADER].index("extraData")

    def digest(extra: bytes) -> bytes:
        return bytes(keccak(encode([*fields[:place], extra, *fields[place + 1 :]])))

    extra = fields[place]
    if header["mixHash"] == _ISTANBUL:
        ibft = _ibft_extra(extra)
        if ibft is not None:
            validators, proposer, seals = ibft
            found = digest(extra[:_VANITY] + encode([validators, proposer, []]))
            signed = bytes(keccak(found + _IBFT_COMMIT))
            unproposed = digest(extra[:_VANITY] + encode([validators, b"", []]))
            author = _signer(bytes(keccak(unproposed)), proposer) if proposer else None
            vote = [hex_bytes(header["miner"]), _IBFT_VOTES[hex_bytes(header["nonce"])]]
        else:
            vanity, validators, vote, round_, seals = decode(extra)
            author = _address(hex_bytes(header["miner"]))
            found = digest(encode([vanity, validators, vote, b"", []]))
            signed = digest(encode([vanity, validators, vote, round_, []]))
        signers = frozenset(_signer(signed, seal) for seal in seals)
        entitled = frozenset(_address(item) for item in validators)
        return "0x" + found.hex(), Seal(signers, entitled, author, _ballot(author, vote))
    signers = frozenset()
    if len(extra) >= _VANITY + _SEAL:
        signers = frozenset({_signer(digest(extra[:-_SEAL]), extra[-_SEAL:])})
    return "0x" + digest(extra).hex(), Seal(signers, None)


def transactions_root(raw: Sequence[bytes]) -> str:
    """The root that a header names for signed transactions."""
    return "0x" + list_root(raw).hex()


def raw_transaction(told: Mapping[str, Any]) -> bytes:
    """The signed bytes of a transaction."""
    kind, unsigned, signature = _transaction(told)
    return kind + encode([*unsigned, *signature])


def transaction(told: Mapping[str, Any]) -> Transaction:
    """What is believed of a transaction, by its signed bytes."""
    kind, unsigned, signature = _transaction(told)
    v = int.from_bytes(signature[0], "big")
    if not kind and v >= 35:
        chain_id, parity = divmod(v - 35, 2)
        unsigned = [*unsigned, _number(chain_id), b"", b""]
    else:
        parity = v if kind else v - 27
    r, s = (item.rjust(32, b"\0") for item in signature[1:])
    sender = _signer(bytes(keccak(kind + encode(unsigned))), r + s + bytes([parity]))
    to = told["to"]
    return Transaction(
        "0x" + keccak(raw_transaction(told)).hex(),
        sender,
        hex_number(told["nonce"]),
        None if to is None else _address(hex_bytes(to)),
        hex_bytes(told["input"]),
    )


def receipts_root(receipts: Sequence[Mapping[str, Any]]) -> str:
    """The root that a header names for its transactions' receipts."""
    return "0x" + list_root([_receipt(receipt) for receipt in receipts]).hex()


def receipt_logs(receipts: Sequence[Mapping[str, Any]], block: int) -> list[LogEntry]:
    """All logs of a block's receipts, numbered by their places there."""
    places = [(index, log) for index, receipt in enumerate(receipts) for log in receipt["logs"]]
    return [
        LogEntry(
            _address(hex_bytes(log["address"])),
            tuple(hex_bytes(topic) for topic in log["topics"]),
            hex_bytes(log["data"]),
            block,
            transaction_,
            index,
        )
        for index, (transaction_, log) in enumerate(places)
    ]


def may_have_logs(header: Mapping[str, Any], address: str) -> bool:
    """False where a header's bloom filter rules out that a contract emitted a log in the block."""
    bloom, digest = int.from_bytes(hex_bytes(header["logsBloom"]), "big"), keccak(hex_bytes(address))
    bits = (int.from_bytes(digest[i : i + 2], "big") % 2048 for i in (0, 2, 4))
    return all(bloom >> bit & 1 for bit in bits)


def account_code_hash(account: bytes) -> bytes:
    """The hash of a contract's code, of its entry in the state's trie."""
    _, _, _, code_hash = decode(account)
    return bytes(code_hash)


def _ballot(proposer: str | None, vote: Sequence[bytes]) -> Ballot | None:
    """A proposer's vote, of its RLP: nothing, or an account and whether it is to be a validator."""
    if proposer is None or not vote:
        return None
    candidate, kind = vote
    return Ballot(proposer, _address(candidate), _ADMITS[kind])


def _ibft_extra(extra: bytes) -> list[Any] | None:
    """Validators, the proposer's seal and the commit seals where extra data has IBFT's form."""
    try:
        found = decode(extra[_VANITY:])
    except ValueError:
        return None
    return list(found) if isinstance(found, list) and len(found) == 3 else None


def _transaction(told: Mapping[str, Any]) -> tuple[bytes, list[Node], list[bytes]]:
    """Type prefix, unsigned fields, and v, r, s."""
    kind = hex_number(told.get("type", "0x0"))
    prices = ["maxPriorityFeePerGas", "maxFeePerGas"] if kind == 2 else ["gasPrice"]
    fields: list[Node] = [_quantity(told[name]) for name in ("nonce", *prices, "gas")]
    to = told["to"]
    fields += [b"" if to is None else hex_bytes(to), _quantity(told["value"]), hex_bytes(told["input"])]
    signature = [_quantity(told[name]) for name in ("v", "r", "s")]
    if kind == 0:
        return b"", fields, signature
    if kind not in (1, 2):
        raise ValueError(f"a transaction of type {kind}")
    access: Node = [
        [hex_bytes(entry["address"]), [hex_bytes(key) for key in entry["storageKeys"]]] for entry in told["accessList"]
    ]
    return bytes([kind]), [_quantity(told["chainId"]), *fields, access], signature


def _receipt(told: Mapping[str, Any]) -> bytes:
    kind = hex_number(told.get("type", "0x0"))
    logs: Node = [
        [hex_bytes(log["address"]), [hex_bytes(topic) for topic in log["topics"]], hex_bytes(log["data"])]
        for log in told["logs"]
    ]
    body = [_quantity(told["status"]), _quantity(told["cumulativeGasUsed"]), hex_bytes(told["logsBloom"]), logs]
    return (bytes([kind]) if kind else b"") + encode(body)


def _signer(digest: bytes, seal: bytes) -> str:
    """The address that signed: r, s and the parity, 65 bytes."""
    return "0x" + Signature(seal).recover_public_key_from_msg_hash(digest).to_canonical_address().hex()


def _address(data: bytes) -> str:
    if len(data) != 20:
        raise ValueError(f"an address of {len(data)} bytes")
    return "0x" + data.hex()


def _quantity(text: str) -> bytes:
    return _number(hex_number(text))


def _number(value: int) -> bytes:
    return value.to_bytes((value.bit_length() + 7) // 8, "big")
