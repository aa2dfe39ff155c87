"""What a transaction works on: accounts, their code and storage, and the journal that undoes what fails.

Addresses, storage slots and storage values are integers; code is bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from eth_hash.auto import keccak

if TYPE_CHECKING:
    from skyrelay.chain.evm.frame import Frame

ACCESSED_ADDRESS_GAS, ACCESSED_SLOT_GAS = 2400, 1900

MANY_TRACES = 1024
"""Code with more places to begin at has its further traces cut short: it was made to be translated over and over."""

Trace = Callable[["Frame", list[int]], int]


@dataclass(frozen=True, slots=True)
class Log:
    """What LOG0..LOG4 wrote."""

    address: int
    topics: tuple[int, ...]
    data: bytes


@dataclass(frozen=True, slots=True)
class BlockContext:
    """What a transaction can see of its block; `block_hash(n)` serves the 256 blocks before it, else 0."""

    number: int
    timestamp: int
    gas_limit: int
    chain_id: int
    block_hash: Callable[[int], int]
    coinbase: int = 0
    difficulty: int = 0
    base_fee: int = 0


class Code:
    """A contract's bytecode and the traces translated from it so far."""

    __slots__ = ("_jump_destinations", "_straight", "code", "hash", "traces")

    def __init__(self, code: bytes) -> None:
        self.code = code
        self.hash = int.from_bytes(keccak(code), "big")
        self.traces: dict[int, Trace] = {}
        self._straight: dict[int, Trace] = {}
        self._jump_destinations: frozenset[int] | None = None

    @property
    def jump_destinations(self) -> frozenset[int]:
        """Where a jump may land: each JUMPDEST that is no push's operand."""
        if self._jump_destinations is None:
            found, pc = set(), 0
            while pc < len(self.code):
                op = self.code[pc]
                if op == 0x5B:
                    found.add(pc)
                pc += op - 0x5E if 0x60 <= op <= 0x7F else 1
            self._jump_destinations = frozenset(found)
        return self._jump_destinations

    def trace(self, pc: int) -> Trace:
        """The trace from ``pc``, translated now."""
        from skyrelay.chain.evm.translate import translate

        trace = self.traces[pc] = translate(self, pc, follow_jumps=True, short=len(self.traces) > MANY_TRACES)
        return trace

    def straight_trace(self, pc: int) -> Trace:
        """A trace that ends at the first jump, for the rare frame whose stack is nearly full."""
        from skyrelay.chain.evm.translate import translate

        if pc not in self._straight:
            self._straight[pc] = translate(self, pc, follow_jumps=False)
        return self._straight[pc]


@lru_cache(maxsize=256)
def code_of(code: bytes) -> Code:
    """Bytecode with its traces, remembered: most transactions call what was called before."""
    return Code(code)


NO_CODE = code_of(b"")


class WorldState:
    """Balances, nonces, code and storage of all accounts; an absent entry is zero or empty."""

    __slots__ = ("balances", "codes", "nonces", "storage")

    def __init__(self) -> None:
        self.balances: dict[int, int] = {}
        self.nonces: dict[int, int] = {}
        self.codes: dict[int, Code] = {}
        self.storage: dict[int, dict[int, int]] = {}

    def is_empty(self, address: int) -> bool:
        """No balance, nonce or code (EIP-161's dead account)."""
        return not (self.nonces.get(address) or self.balances.get(address) or self.codes.get(address, NO_CODE).code)

    def set_code(self, address: int, code: bytes) -> None:
        """Put a contract at an address."""
        self.codes[address] = code_of(code)


@dataclass(slots=True)
class Changes:
    """What transactions wrote, as the values before the first of them wrote."""

    storage: dict[tuple[int, int], int] = field(default_factory=dict)
    accounts: set[int] = field(default_factory=set)


MAX_PAIRS = 8
"""Pairs of points that one transaction may have paired: each takes half a second here, for gas of a millisecond."""


class Transaction:
    """One transaction under way: access lists, refunds, logs, and the journal that undoes reverted frames.

    Args:
        price: of gas, as GASPRICE tells it.
        access: addresses and slots that are warm from the start, and paid for (EIP-2930).

    Attributes:
        until: by `time.monotonic`, when it must have ended; None: gas alone bounds it.
        pairs: points that it may still have paired; see `skyrelay.chain.evm.alt_bn128`.
    """

    __slots__ = (
        "access_gas",
        "block",
        "created",
        "destroyed",
        "journal",
        "logs",
        "origin",
        "originals",
        "pairs",
        "price",
        "refund",
        "state",
        "until",
        "warm_accounts",
        "warm_slots",
    )

    def __init__(
        self,
        state: WorldState,
        block: BlockContext,
        origin: int,
        *,
        price: int = 0,
        access: Sequence[tuple[int, Sequence[int]]] = (),
    ) -> None:
        self.state = state
        self.block = block
        self.origin = origin
        self.price = price
        self.pairs = MAX_PAIRS
        self.until: float | None = None
        self.access_gas = 0
        self.warm_accounts: dict[int, Any] = dict.fromkeys(range(1, 10), True)
        self.warm_accounts[origin] = True
        self.warm_slots: dict[int, dict[int, Any]] = {}
        for address, slots in access:
            self.access_gas += ACCESSED_ADDRESS_GAS + ACCESSED_SLOT_GAS * len(slots)
            self.warm_accounts[address] = True
            self.warm_slots.setdefault(address, {}).update(dict.fromkeys(slots, True))
        self.originals: dict[int, dict[int, int]] = {}
        self.journal: list[tuple[dict[int, Any], int, Any]] = []
        self.refund = 0
        self.logs: list[Log] = []
        self.destroyed: dict[int, Any] = {}

    def put(self, table: dict[int, Any], key: int, value: Any) -> None:
        """Write an entry so that a revert can undo it."""
        self.journal.append((table, key, table.get(key)))
        table[key] = value

    def undo(self, mark: int) -> None:
        """Take back what was written since the journal had ``mark`` entries."""
        journal = self.journal
        while len(journal) > mark:
            table, key, old = journal.pop()
            if old is None:
                table.pop(key, None)
            else:
                table[key] = old

    def transfer(self, sender: int, recipient: int, value: int) -> None:
        """Move value; the caller has checked the balance."""
        if value:
            balances = self.state.balances
            self.put(balances, sender, balances.get(sender, 0) - value)
            self.put(balances, recipient, balances.get(recipient, 0) + value)
