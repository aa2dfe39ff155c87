"""What the client needs of a chain: the embedded one and a node's both offer it.

Addresses are ``0x`` and forty lower-case hexadecimal digits; hashes likewise with sixty-four.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

DEFAULT_GAS = 1_000_000
"""Gas limit of a call that names none: at gas price 0 what is not used costs nothing."""


@dataclass(frozen=True, slots=True)
class Call:
    """A transaction to send, or a question to ask.

    Attributes:
        sender: who sends it; an account of the chain.
        to: the contract; None to create one.
        data: selector and arguments, or the code that creates.
        gas: the limit.
        name: the function's name, for messages only.
    """

    sender: str
    to: str | None
    data: bytes
    gas: int = DEFAULT_GAS
    name: str = ""


@dataclass(frozen=True, slots=True)
class SentTransaction:
    """A transaction as it was sent; ``to`` is None where it creates a contract."""

    sender: str
    nonce: int
    to: str | None
    data: bytes


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One log.

    Attributes:
        block, transaction, index: where it stands: block number, place in the block, place in the block's logs.
    """

    address: str
    topics: tuple[bytes, ...]
    data: bytes
    block: int
    transaction: int
    index: int


@dataclass(frozen=True, slots=True)
class Receipt:
    """What became of a transaction.

    Attributes:
        status: False where it reverted or halted.
        gas_used: after refunds.
        created: the address of the contract it created.
        output: the revert's data where the status is False, else empty.
        halt: why it failed without a REVERT, e.g. ``"out of gas"``; None where it did not, or a node did not say.
    """

    hash: str
    block: int
    transaction: int
    sender: str
    to: str | None
    created: str | None
    status: bool
    gas_used: int
    logs: tuple[LogEntry, ...]
    output: bytes = b""
    halt: str | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """What a question gave: the return value, or the revert's data where the status is False."""

    status: bool
    output: bytes


@runtime_checkable
class Chain(Protocol):
    """A chain: the embedded one (`EmbeddedChain`) or a node's (`NodeChain`)."""

    @property
    def chain_id(self) -> int:
        """The network's number."""
        ...

    @property
    def block_number(self) -> int:
        """Number of the latest block."""
        ...

    @property
    def block_gas_limit(self) -> int:
        """Most gas that the transactions of one block may ask for."""
        ...

    def account(self, name: str) -> str:
        """The address of a member; the same name has the same address each time."""
        ...

    def send(self, calls: Sequence[Call], timestamp: int | None = None) -> list[Receipt]:
        """Have transactions mined.

        Those of one sender are mined in this order. The embedded chain keeps it between senders too; a network need
        not: what must come first goes into a `send` of its own.

        Args:
            timestamp: of the blocks [s]; only the embedded chain heeds it, a node has its own clock.
        Returns: one receipt a call, failed ones included.
        Raises:
            ChainError: a transaction cannot be mined at all, or the chain is out of reach.
        """
        ...

    def query(self, calls: Sequence[Call]) -> list[Answer]:
        """Ask without changing anything.

        Raises:
            ChainError: the chain is out of reach.
        """
        ...

    def logs(self, address: str, from_block: int, to_block: int) -> list[LogEntry]:
        """All logs of a contract in these blocks, both included, in order."""
        ...

    def code(self, address: str) -> bytes:
        """The code of a contract; empty where there is none."""
        ...

    def transaction(self, block: int, index: int) -> SentTransaction:
        """The transaction at a place of a block.

        Raises:
            ChainError: there is none, or the chain is out of reach.
        """
        ...
