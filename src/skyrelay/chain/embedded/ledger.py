r"""The embedded chain's record on disk: one line a block, each hashed, each naming the hash before it.

A line is ``<sha-256 of the JSON, in hexadecimal> <JSON>\n``; the first describes the chain. Lines are only ever
appended, so that a process that is killed leaves at most an unfinished last line, which the next opening drops;
anything else that does not fit is damage and is refused. A block has all that is needed to check it (transactions,
receipts with their logs) and to go on without executing it again (what it wrote to the state).
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skyrelay.chain.chain import LogEntry, Receipt
from skyrelay.core.errors import ChainError
from skyrelay.core.untrusted import parse_json

FORMAT = "skyrelay-chain/1"
MAX_GAS_LIMIT = 1_000_000_000
"""Of a block: more than Python executes in ten seconds."""
FILE_NAME = "blocks.jsonl"

_ADDRESS = re.compile("0x[0-9a-f]{40}")
_WORD = re.compile("[0-9a-f]{1,64}")


@dataclass(frozen=True, slots=True)
class Genesis:
    """What a chain starts from."""

    chain_id: int
    gas_limit: int
    timestamp: int


@dataclass(frozen=True, slots=True)
class Transaction:
    """A transaction of the embedded chain: it carries its sender; nobody signs inside one process."""

    sender: str
    nonce: int
    to: str | None
    gas: int
    data: bytes

    def hash(self, chain_id: int) -> str:
        """Identifies the transaction on its chain."""
        fields = [str(chain_id), self.sender, str(self.nonce), self.to or "", str(self.gas), self.data.hex()]
        return "0x" + hashlib.sha256(" ".join(fields).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Writes:
    """The state that a block left changed, as values after it."""

    nonces: dict[str, int] = field(default_factory=dict)
    codes: dict[str, bytes] = field(default_factory=dict)
    storage: dict[str, dict[int, int]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Block:
    """A block as recorded; `hash` is that of its line."""

    number: int
    parent: str
    timestamp: int
    gas_used: int
    transactions: tuple[Transaction, ...]
    receipts: tuple[Receipt, ...]
    writes: Writes
    hash: str = ""


class DamagedRecordError(ChainError):
    """A line of a chain's record is not what was written."""


def encode_genesis(genesis: Genesis) -> tuple[str, bytes]:
    """Hash and line."""
    return _line(
        {
            "format": FORMAT,
            "chain_id": genesis.chain_id,
            "gas_limit": genesis.gas_limit,
            "timestamp": genesis.timestamp,
            "rules": "london",
        }
    )


def encode_block(block: Block, chain_id: int) -> tuple[str, bytes]:
    """Hash and line."""
    return _line(
        {
            "number": block.number,
            "parent": block.parent,
            "timestamp": block.timestamp,
            "gas_used": block.gas_used,
            "transactions": [
                {
                    "hash": t.hash(chain_id),
                    "sender": t.sender,
                    "nonce": t.nonce,
                    "to": t.to,
                    "gas": t.gas,
                    "data": t.data.hex(),
                }
                for t in block.transactions
            ],
            "receipts": [
                {
                    "status": r.status,
                    "gas_used": r.gas_used,
                    "created": r.created,
                    "output": r.output.hex(),
                    "halt": r.halt,
                    "logs": [
                        {"address": e.address, "topics": [t.hex() for t in e.topics], "data": e.data.hex()}
                        for e in r.logs
                    ],
                }
                for r in block.receipts
            ],
            "writes": {
                "nonces": block.writes.nonces,
                "codes": {address: code.hex() for address, code in block.writes.codes.items()},
                "storage": {
                    address: {f"{slot:x}": f"{value:x}" for slot, value in slots.items()}
                    for address, slots in block.writes.storage.items()
                },
            },
        }
    )


def decode_genesis(place: str, line: bytes) -> tuple[str, Genesis]:
    """Hash and content of a record's first line.

    Raises:
        DamagedRecordError: the line is not one that `encode_genesis` writes.
    """
    digest, content = split(line)
    try:
        tree = parse_json(content)
        known, genesis = (
            tree["format"],
            Genesis(*(_natural(tree[name]) for name in ("chain_id", "gas_limit", "timestamp"))),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DamagedRecordError(place, None, f"a chain's first record ({error})") from error
    if not 0 < genesis.gas_limit <= MAX_GAS_LIMIT:
        raise DamagedRecordError(f"{place}: gas limit", genesis.gas_limit, f"1 to {MAX_GAS_LIMIT}")
    if (digest, line) != encode_genesis(genesis):
        raise DamagedRecordError(place, known, f"a first record of the format {FORMAT}, with its SHA-256 before it")
    return digest, genesis


def decode_block(place: str, line: bytes, chain_id: int) -> Block:
    """A recorded block.

    Raises:
        DamagedRecordError: the line or a transaction does not have the hash that it names, or the line is no block.
    """
    digest, content = split(line)
    if digest != content_hash(content):
        raise DamagedRecordError(place, digest, "the SHA-256 of what follows it on the line")
    block = parse_block(place, digest, content)
    for transaction, receipt in zip(block.transactions, block.receipts, strict=True):
        if receipt.hash != transaction.hash(chain_id):
            raise DamagedRecordError(
                f"{place}, transaction {receipt.transaction}", receipt.hash, "the hash of its content"
            )
    return block


def parse_block(place: str, digest: str, content: bytes) -> Block:
    """A block from its JSON, whatever its hashes.

    Raises:
        DamagedRecordError: it is no block.
    """
    try:
        return _block(place, digest, parse_json(content))
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DamagedRecordError(place, None, f"a block's record ({error})") from error


def split(line: bytes) -> tuple[str, bytes]:
    """The hash that a line names (empty where it names none), and the JSON behind it."""
    if line[64:65] != b" " or not line.endswith(b"\n"):
        return "", line[65:].removesuffix(b"\n")
    return "0x" + line[:64].decode("ascii", "replace"), line[65:-1]


def content_hash(content: bytes) -> str:
    """The hash that a line must name."""
    return "0x" + hashlib.sha256(content).hexdigest()


def _block(place: str, digest: str, tree: dict[str, Any]) -> Block:
    number = _natural(tree["number"])
    transactions, receipts, index = [], [], 0
    if len(tree["transactions"]) != len(tree["receipts"]):
        raise DamagedRecordError(
            place, len(tree["receipts"]), f"{len(tree['transactions'])} receipts, one a transaction"
        )
    for place_in_block, (t, r) in enumerate(zip(tree["transactions"], tree["receipts"], strict=True)):
        transaction = Transaction(
            _address(t["sender"]),
            _natural(t["nonce"]),
            _address_or_none(t["to"]),
            _natural(t["gas"]),
            bytes.fromhex(t["data"]),
        )
        logs = []
        for entry in r["logs"]:
            topics = tuple(bytes.fromhex(topic) for topic in entry["topics"])
            data = bytes.fromhex(entry["data"])
            logs.append(LogEntry(_address(entry["address"]), topics, data, number, place_in_block, index))
            index += 1
        transactions.append(transaction)
        receipts.append(
            Receipt(
                hash=_text(t["hash"]),
                block=number,
                transaction=place_in_block,
                sender=transaction.sender,
                to=transaction.to,
                created=_address_or_none(r["created"]),
                status=bool(r["status"]),
                gas_used=_natural(r["gas_used"]),
                logs=tuple(logs),
                output=bytes.fromhex(r["output"]),
                halt=None if r["halt"] is None else _text(r["halt"]),
            )
        )
    writes = tree["writes"]
    return Block(
        number=number,
        parent=_text(tree["parent"]),
        timestamp=_natural(tree["timestamp"]),
        gas_used=_natural(tree["gas_used"]),
        transactions=tuple(transactions),
        receipts=tuple(receipts),
        writes=Writes(
            nonces={_address(address): _natural(nonce) for address, nonce in writes["nonces"].items()},
            codes={_address(address): bytes.fromhex(code) for address, code in writes["codes"].items()},
            storage={
                _address(address): {_word(slot): _word(value) for slot, value in slots.items()}
                for address, slots in writes["storage"].items()
            },
        ),
        hash=digest,
    )


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return value


def _address(value: Any) -> str:
    if not _ADDRESS.fullmatch(_text(value)):
        raise ValueError(f"{value!r} is no address")
    return str(value)


def _address_or_none(value: Any) -> str | None:
    return None if value is None else _address(value)


def _natural(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 64:
        raise ValueError(f"{value!r} is no number of 64 bits")
    return value


def _word(value: Any) -> int:
    if not _WORD.fullmatch(_text(value)):
        raise ValueError(f"{value!r} is no hexadecimal word")
    return int(value, 16)


def _line(tree: dict[str, Any]) -> tuple[str, bytes]:
    content = json.dumps(tree, separators=(",", ":")).encode()
    digest = content_hash(content)
    return digest, digest[2:].encode() + b" " + content + b"\n"


class BlockFile:
    """A chain's record, open for appending by this process alone."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b", buffering=0)
        except OSError as error:
            raise ChainError(path, None, f"a file that can be written ({error.strerror})") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise ChainError(path, None, "a chain that no other process has open") from None

    def lines(self) -> Iterator[bytes]:
        """Whole lines from the start; an unfinished last one is cut off."""
        self._file.seek(0)
        end = 0
        with os.fdopen(os.dup(self._file.fileno()), "rb") as reader:
            for line in reader:
                if not line.endswith(b"\n"):
                    self._file.truncate(end)
                    return
                end += len(line)
                yield line

    def append(self, line: bytes) -> None:
        """Add a line; it is on the disk when this returns.

        Raises:
            ChainError: the disk took less than the whole line; what it took is cut off again.
        """
        end = os.fstat(self._file.fileno()).st_size
        try:
            written = 0
            while written < len(line):
                written += os.write(self._file.fileno(), line[written:])
            os.fsync(self._file.fileno())
        except OSError as error:
            self._file.truncate(end)
            raise ChainError(self.path, None, f"room for another block ({error.strerror})") from error

    def close(self) -> None:
        """Let others open it."""
        self._file.close()
