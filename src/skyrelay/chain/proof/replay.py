"""Checks the embedded chain's record: every hash, and every block executed again from its transactions."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from skyrelay.chain import evm
from skyrelay.chain.abi import contract
from skyrelay.chain.chain import Receipt
from skyrelay.chain.embedded.chain import BlockBuilder, with_hash
from skyrelay.chain.embedded.ledger import (
    FILE_NAME,
    Block,
    DamagedRecordError,
    Genesis,
    Transaction,
    Writes,
    content_hash,
    decode_genesis,
    encode_block,
    parse_block,
    split,
)
from skyrelay.core.errors import ChainError, RunFolderError

GAS, GAS_PER_BYTE = 150_000_000, 1_000
"""What a record may spend whatever its length, and for each byte: real ones spend some 50."""
SECONDS, SECONDS_PER_BYTE = 60.0, 200e-6


@dataclass(frozen=True, slots=True)
class Difference:
    """Where a record is not what it should be."""

    place: str
    found: str
    expected: str

    def __str__(self) -> str:
        return f"{self.place}: {self.found}, should be {self.expected}"


@dataclass
class Replay:
    """What executing a record again gave.

    Attributes:
        blocks: as executed again, not as recorded.
        head: hash that the record's last line names.
    """

    chain_id: int
    head: str
    blocks: list[Block]
    differences: list[Difference]

    @property
    def transactions(self) -> int:
        """How many were executed."""
        return sum(len(block.transactions) for block in self.blocks)


@dataclass
class _Budget:
    """What executing a record may cost, by its length: a short record must not keep the audit busy for hours.

    Attributes:
        gas: still to be spent.
        until: by `time.monotonic`.
    """

    gas: int
    until: float

    @classmethod
    def of(cls, size: int) -> _Budget:
        """For a record of so many bytes: ten to a hundred times what those of real runs take."""
        return cls(GAS + GAS_PER_BYTE * size, time.monotonic() + SECONDS + SECONDS_PER_BYTE * size)

    def check(self, transaction: Transaction, place: str) -> None:
        """A transaction must not be able to spend more than there is.

        Raises:
            DamagedRecordError: it can.
        """
        if transaction.gas > self.gas:
            raise DamagedRecordError(
                f"{place}: gas limit",
                transaction.gas,
                f"at most {self.gas}, what the record's length still accounts for",
            )

    def spend(self, gas: int) -> None:
        """Take what a transaction has used."""
        self.gas -= gas


def replay(folder: Path) -> Replay:
    """Check a chain's folder.

    Returns: what was executed, with every difference from the record; where a line cannot be read the check ends there.
    Raises:
        RunFolderError: there is no record.
    """
    path = folder / FILE_NAME
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise RunFolderError(path, None, f"a chain's record ({error.strerror})") from error
    lines = [line + b"\n" for line in lines[:-1]] + [line for line in lines[-1:] if line]
    if not lines:
        return Replay(0, "", [], [Difference("chain", "an empty record", "a first line that describes the chain")])
    try:
        digest, genesis = decode_genesis("block 0", lines[0])
    except ChainError as error:
        return Replay(0, "", [], [Difference(error.place, _found(error), error.expected)])
    result = Replay(genesis.chain_id, digest, [], [])
    budget = _Budget.of(sum(map(len, lines)))
    state = evm.WorldState()
    for number, line in enumerate(lines[1:], 1):
        try:
            _check_line(result, state, genesis, number, line, budget)
        except DamagedRecordError as error:
            rest = len(lines) - number - 1
            result.differences.append(Difference(error.place, _found(error), error.expected))
            if rest:
                result.differences.append(Difference(f"the {rest} blocks after it", "not checked", "executed again"))
            break
    return result


def _check_line(
    result: Replay, state: evm.WorldState, genesis: Genesis, number: int, line: bytes, budget: _Budget
) -> None:
    """Execute one recorded block again, add it to the result, and name every difference."""
    place = f"block {number}"
    if not line.endswith(b"\n"):
        raise DamagedRecordError(place, "cut short", "a whole line")
    digest, content = split(line)
    recorded = parse_block(place, digest, content)
    expected_parent, result.head = result.head, digest
    differences = result.differences
    before = len(differences)
    if digest != content_hash(content):
        differences.append(Difference(f"{place}: hash", digest or "none", f"{content_hash(content)} by its content"))
    if recorded.number != number:
        differences.append(Difference(f"{place}: number", str(recorded.number), str(number)))
    if recorded.parent != expected_parent:
        differences.append(Difference(f"{place}: parent", recorded.parent, f"{expected_parent}, the block before"))
    earliest = result.blocks[-1].timestamp if result.blocks else genesis.timestamp
    if recorded.timestamp < earliest:
        differences.append(Difference(f"{place}: timestamp", str(recorded.timestamp), f"no less than {earliest}"))
    builder = BlockBuilder(state, genesis, result.blocks, expected_parent, recorded.timestamp, budget.until)
    for index, transaction in enumerate(recorded.transactions):
        name = f"{place}, transaction {index} ({_describe(transaction.to, transaction.data)} by {transaction.sender})"
        try:
            nonce = state.nonces.get(int(transaction.sender, 16), 0)
            if transaction.nonce != nonce:
                differences.append(Difference(f"{name}: nonce", str(transaction.nonce), str(nonce)))
            if not builder.has_room(transaction.gas):
                differences.append(Difference(f"{name}: gas limit", str(transaction.gas), "within the block's limit"))
            budget.check(transaction, name)
            executed = builder.add(transaction)
            budget.spend(executed.gas_used)
        except DamagedRecordError:
            raise
        except (ChainError, ValueError, OverflowError) as error:
            raise DamagedRecordError(name, None, f"a transaction that can be executed ({error})") from error
        differences += _compare_receipts(name, recorded.receipts[index], executed)
    block = builder.block()
    if recorded.gas_used != block.gas_used:
        differences.append(Difference(f"{place}: gas used", str(recorded.gas_used), str(block.gas_used)))
    differences += _compare_writes(place, recorded.writes, block.writes)
    _, expected_line = encode_block(block, genesis.chain_id)
    if len(differences) == before and line != expected_line:
        differences.append(Difference(place, "written otherwise", "the JSON that this content has"))
    # Later blocks name the recorded hash as their parent, and so does BLOCKHASH.
    result.blocks.append(with_hash(block, digest or content_hash(content)))


def _compare_receipts(name: str, recorded: Receipt, executed: Receipt) -> Iterator[Difference]:
    for field in ("hash", "status", "gas_used", "created", "halt"):
        found, expected = getattr(recorded, field), getattr(executed, field)
        if found != expected:
            yield Difference(f"{name}: {field.replace('_', ' ')}", str(found), str(expected))
    if recorded.output != executed.output:
        yield Difference(f"{name}: output", "0x" + recorded.output.hex(), "0x" + executed.output.hex())
    if len(recorded.logs) != len(executed.logs):
        yield Difference(f"{name}: logs", str(len(recorded.logs)), str(len(executed.logs)))
        return
    for index, (found_log, expected_log) in enumerate(zip(recorded.logs, executed.logs, strict=True)):
        if found_log != expected_log:
            for field in ("address", "topics", "data"):
                found, expected = getattr(found_log, field), getattr(expected_log, field)
                if found != expected:
                    yield Difference(f"{name}: log {index} {field}", _text(found), _text(expected))


def _compare_writes(place: str, recorded: Writes, executed: Writes) -> Iterator[Difference]:
    for kind in ("nonces", "codes"):
        found, expected = getattr(recorded, kind), getattr(executed, kind)
        for address in sorted(found.keys() | expected.keys()):
            if found.get(address) != expected.get(address):
                yield Difference(
                    f"{place}: {kind[:-1]} of {address}", _text(found.get(address)), _text(expected.get(address))
                )
    for address in sorted(recorded.storage.keys() | executed.storage.keys()):
        slots, expected_slots = recorded.storage.get(address, {}), executed.storage.get(address, {})
        for slot in sorted(slots.keys() | expected_slots.keys()):
            if slots.get(slot) != expected_slots.get(slot):
                yield Difference(
                    f"{place}: storage of {address} at {slot:#x}",
                    _text(slots.get(slot)),
                    _text(expected_slots.get(slot)),
                )


def _describe(to: str | None, data: bytes) -> str:
    if to is None:
        return "a contract's creation"
    function = contract().function_of(data)
    return function.name if function is not None else "an unknown function"


def _found(error: ChainError) -> str:
    return "not readable" if error.value is None else str(error.value)


def _text(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, bytes):
        return "0x" + value.hex()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(_text(item) for item in value) + "]"
    return f"{value:#x}" if isinstance(value, int) else str(value)
