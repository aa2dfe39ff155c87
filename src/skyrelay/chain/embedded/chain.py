"""The embedded chain: a London EVM inside the process, its blocks in one file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType

from eth_hash.auto import keccak

from skyrelay.chain import evm
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Answer, Call, LogEntry, Receipt, SentTransaction
from skyrelay.chain.embedded.ledger import (
    FILE_NAME,
    MAX_GAS_LIMIT,
    Block,
    BlockFile,
    DamagedRecordError,
    Genesis,
    Transaction,
    Writes,
    decode_block,
    decode_genesis,
    encode_block,
    encode_genesis,
)
from skyrelay.chain.evm.state import NO_CODE
from skyrelay.core.errors import ChainError

CHAIN_ID = 31337
GAS_LIMIT = 30_000_000
QUERY_GAS = 10_000_000_000
"""Gas of a question: more than any view needs, so that only an endless loop runs out of it."""


class EmbeddedChain:
    """A chain of one process: no server, no keys, no mining time.

    The same calls at the same timestamps give the same blocks, byte for byte.

    Args:
        path: folder of the record, made where there is none; None keeps the chain in memory.
        chain_id, gas_limit, timestamp: of a new chain [-, gas a block, s]; of an old one they must agree where given.
    Raises:
        ChainError: the record is damaged, is of another chain, or is open in another process.
    """

    def __init__(
        self,
        path: Path | None = None,
        *,
        chain_id: int | None = None,
        gas_limit: int | None = None,
        timestamp: int | None = None,
    ) -> None:
        if gas_limit is not None and not 0 < gas_limit <= MAX_GAS_LIMIT:
            raise ChainError("chain: gas_limit", gas_limit, f"1 to {MAX_GAS_LIMIT}")
        self._state = evm.WorldState()
        self._blocks: list[Block] = []
        self._file = BlockFile(path / FILE_NAME) if path is not None else None
        genesis = Genesis(
            CHAIN_ID if chain_id is None else chain_id,
            GAS_LIMIT if gas_limit is None else gas_limit,
            1 if timestamp is None else timestamp,
        )
        try:
            self._genesis, self._genesis_hash = self._open(genesis)
            self._require(chain_id=chain_id, gas_limit=gas_limit, timestamp=timestamp)
        except BaseException:
            self.close()
            raise

    def _open(self, new: Genesis) -> tuple[Genesis, str]:
        """Read the record, or start it."""
        if self._file is None:
            return new, encode_genesis(new)[0]
        genesis, genesis_hash = None, ""
        for number, line in enumerate(self._file.lines()):
            place = f"{self._file.path}: block {number}"
            if genesis is None:
                genesis_hash, genesis = decode_genesis(place, line)
                self._genesis, self._genesis_hash = genesis, genesis_hash
                continue
            block = decode_block(place, line, genesis.chain_id)
            if (block.number, block.parent) != (number, self.head):
                raise DamagedRecordError(
                    place, block.parent, f"number {number} and the hash of the block before, {self.head}"
                )
            apply(self._state, block.writes)
            self._blocks.append(block)
        if genesis is None:
            genesis = new
            genesis_hash, line = encode_genesis(new)
            self._file.append(line)
        return genesis, genesis_hash

    def _require(self, **given: int | None) -> None:
        for name, value in given.items():
            if value is not None and value != getattr(self._genesis, name):
                raise ChainError(f"chain: {name}", getattr(self._genesis, name), f"{value}")

    # The Chain protocol

    @property
    def chain_id(self) -> int:
        """The network's number."""
        return self._genesis.chain_id

    @property
    def block_number(self) -> int:
        """Number of the latest block; 0 before the first."""
        return len(self._blocks)

    @property
    def block_gas_limit(self) -> int:
        """Most gas that the transactions of one block may ask for."""
        return self._genesis.gas_limit

    @property
    def head(self) -> str:
        """Hash of the latest block: it commits to every byte of the record before it."""
        return self._blocks[-1].hash if self._blocks else self._genesis_hash

    @property
    def timestamp(self) -> int:
        """Of the latest block [s]."""
        return self._blocks[-1].timestamp if self._blocks else self._genesis.timestamp

    def account(self, name: str) -> str:
        """The address of a member: a hash of its name, for there is no key to manage."""
        return account_of(name)

    def send(self, calls: Sequence[Call], timestamp: int | None = None) -> list[Receipt]:
        """Execute calls in as few blocks as their gas limits allow; when this returns they are on the disk.

        Args:
            timestamp: of the blocks [s]; left out: that of the latest block.
        Returns: one receipt a call, failed ones included.
        Raises:
            ChainError: time runs backwards; a gas limit is below the intrinsic gas or above the block's; the disk is
                full. What was executed before is kept.
        """
        time = self.timestamp if timestamp is None else timestamp
        if time < self.timestamp:
            raise ChainError("chain: timestamp", time, f"no less than the latest block's, {self.timestamp}")
        for call in calls:
            least = evm.intrinsic_gas(call.data, call.to is None)
            if not least <= call.gas <= self.block_gas_limit:
                raise ChainError(
                    f"chain: gas limit of {call.name or 'a call'}",
                    call.gas,
                    f"{least} (the intrinsic gas) to {self.block_gas_limit} (a block's limit)",
                )
        receipts: list[Receipt] = []
        rest = list(calls)
        while rest:
            builder = BlockBuilder(self._state, self._genesis, self._blocks, self.head, time)
            taken = 0
            try:
                for call in rest:
                    if not builder.has_room(call.gas):
                        break
                    nonce = self._state.nonces.get(int(call.sender, 16), 0)
                    builder.add(Transaction(call.sender, nonce, call.to, call.gas, call.data))
                    taken += 1
            finally:
                if taken:
                    receipts += self._append(builder.block()).receipts
            rest = rest[taken:]
        return receipts

    def query(self, calls: Sequence[Call], gas: int = QUERY_GAS) -> list[Answer]:
        """Ask the latest state.

        Args:
            gas: that each question may use, beside the intrinsic gas.
        """
        context = block_context(self._genesis, self._blocks, self._genesis_hash, self.block_number, self.timestamp)
        answers = []
        for call in calls:
            outcome = evm.query(
                self._state,
                context,
                sender=int(call.sender, 16),
                to=None if call.to is None else int(call.to, 16),
                data=call.data,
                gas=gas,
            )
            answers.append(Answer(outcome.status, outcome.output))
        return answers

    def logs(self, address: str, from_block: int, to_block: int) -> list[LogEntry]:
        """All logs of a contract in these blocks, both included, in order."""
        return [
            entry
            for block in self._blocks[max(from_block, 1) - 1 : max(to_block, 0)]
            for receipt in block.receipts
            for entry in receipt.logs
            if entry.address == address
        ]

    def code(self, address: str) -> bytes:
        """The code of a contract; empty where there is none."""
        return self._state.codes.get(int(address, 16), NO_CODE).code

    # Beyond it

    def nonce(self, address: str) -> int:
        """How many transactions an account has sent."""
        return self._state.nonces.get(int(address, 16), 0)

    @property
    def genesis_hash(self) -> str:
        """What stands in for the hash of block 0."""
        return self._genesis_hash

    @property
    def genesis_timestamp(self) -> int:
        """Of block 0 [s]."""
        return self._genesis.timestamp

    def transaction(self, block: int, index: int) -> SentTransaction:
        """The transaction at a place of a block."""
        if not (1 <= block <= len(self._blocks) and 0 <= index < len(self._blocks[block - 1].transactions)):
            raise ChainError("chain: transaction", f"{index} of block {block}", "one that was executed")
        told = self._blocks[block - 1].transactions[index]
        return SentTransaction(told.sender, told.nonce, told.to, told.data)

    @property
    def blocks(self) -> Sequence[Block]:
        """All blocks, the first being number 1."""
        return self._blocks

    def close(self) -> None:
        """Let go of the record."""
        if self._file is not None:
            self._file.close()

    def __enter__(self) -> EmbeddedChain:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _append(self, block: Block) -> Block:
        digest, line = encode_block(block, self.chain_id)
        if self._file is not None:
            try:
                self._file.append(line)
            except ChainError:
                self.close()  # the state in memory is ahead of the record: only a fresh opening is sound
                raise
        block = with_hash(block, digest)
        self._blocks.append(block)
        return block


def with_hash(block: Block, digest: str) -> Block:
    """The block, knowing its hash."""
    return Block(
        block.number,
        block.parent,
        block.timestamp,
        block.gas_used,
        block.transactions,
        block.receipts,
        block.writes,
        digest,
    )


def apply(state: evm.WorldState, writes: Writes) -> None:
    """Bring the state to what it was after a block."""
    for address, nonce in writes.nonces.items():
        state.nonces[int(address, 16)] = nonce
    for address, code in writes.codes.items():
        state.set_code(int(address, 16), code)
    for address, slots in writes.storage.items():
        state.storage.setdefault(int(address, 16), {}).update(slots)


def block_context(
    genesis: Genesis, blocks: Sequence[Block], genesis_hash: str, number: int, timestamp: int
) -> evm.BlockContext:
    """What the transactions of block ``number`` see."""

    def block_hash(n: int) -> int:
        return int(blocks[n - 1].hash if n else genesis_hash, 16)

    return evm.BlockContext(number, timestamp, genesis.gas_limit, genesis.chain_id, block_hash)


class BlockBuilder:
    """Executes transactions into the next block."""

    def __init__(
        self,
        state: evm.WorldState,
        genesis: Genesis,
        blocks: Sequence[Block],
        parent: str,
        timestamp: int,
        until: float | None = None,
    ) -> None:
        self._until = until
        self._state = state
        self._genesis = genesis
        self._number = len(blocks) + 1
        self._parent = parent
        self._timestamp = timestamp
        genesis_hash = encode_genesis(genesis)[0]
        self._context = block_context(genesis, blocks, genesis_hash, self._number, timestamp)
        self._changes = evm.Changes()
        self._gas_used = 0
        self._logs = 0
        self._transactions: list[Transaction] = []
        self._receipts: list[Receipt] = []

    def has_room(self, gas: int) -> bool:
        """A transaction with this limit still fits the block."""
        return self._gas_used + gas <= self._genesis.gas_limit

    def add(self, transaction: Transaction) -> Receipt:
        """Execute a transaction.

        Raises:
            ChainError: as `evm.transact`; the block is as it was.
        """
        outcome = evm.transact(
            self._state,
            self._context,
            sender=int(transaction.sender, 16),
            to=None if transaction.to is None else int(transaction.to, 16),
            data=transaction.data,
            gas=transaction.gas,
            changes=self._changes,
            until=self._until,
        )
        self._gas_used += outcome.gas_used
        receipt = Receipt(
            hash=transaction.hash(self._genesis.chain_id),
            block=self._number,
            transaction=len(self._transactions),
            sender=transaction.sender,
            to=transaction.to,
            created=None if outcome.created is None else _address(outcome.created),
            status=outcome.status,
            gas_used=outcome.gas_used,
            logs=tuple(self._entries(outcome.logs)),
            output=b"" if outcome.status else outcome.output,
            halt=outcome.halt,
        )
        self._transactions.append(transaction)
        self._receipts.append(receipt)
        return receipt

    def block(self) -> Block:
        """What was executed, as a block that does not know its hash yet."""
        state = self._state
        writes = Writes()
        for address in sorted(self._changes.accounts):
            writes.nonces[_address(address)] = state.nonces.get(address, 0)
            if address in state.codes:
                writes.codes[_address(address)] = state.codes[address].code
        for (address, slot), old in sorted(self._changes.storage.items()):
            value = state.storage[address].get(slot, 0)
            if value != old:
                writes.storage.setdefault(_address(address), {})[slot] = value
        return Block(
            self._number,
            self._parent,
            self._timestamp,
            self._gas_used,
            tuple(self._transactions),
            tuple(self._receipts),
            writes,
        )

    def _entries(self, logs: Iterable[evm.Log]) -> Iterable[LogEntry]:
        for entry in logs:
            topics = tuple(topic.to_bytes(32, "big") for topic in entry.topics)
            yield LogEntry(
                _address(entry.address), topics, entry.data, self._number, len(self._transactions), self._logs
            )
            self._logs += 1


def _address(number: int) -> str:
    return f"0x{number:040x}"


def signing_members() -> Keyring:
    """Keys of an embedded chain's members that sign for others to hand in; as open as the chain itself."""
    return Keyring(keccak(b"skyrelay embedded members"))


def account_of(name: str) -> str:
    """The address of a member of any embedded chain."""
    return "0x" + keccak(b"skyrelay embedded account " + name.encode())[12:].hex()
