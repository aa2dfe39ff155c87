"""An Ethereum virtual machine with London's rules: exact gas, fast enough to simulate with.

Bytecode is translated to Python, trace by trace, when it is first reached (`skyrelay.chain.evm.translate`); this file
holds what the translated code calls: state, gas, memory, calls between contracts, and the execution of one transaction.
Why not an existing one: docs/decisions/0020-embedded-chain.md.

Addresses, storage slots and storage values are integers; code, call data and output are bytes.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import rlp  # type: ignore[import-untyped]
from eth_hash.auto import keccak

from skyrelay.core.errors import ChainError

WORD = (1 << 256) - 1
ADDRESS = (1 << 160) - 1
MAX_CODE_SIZE = 24_576
MAX_DEPTH = 1024
INTRINSIC_GAS = 21_000
CREATE_GAS = 32_000

STOPPED, REVERTED = -1, -2
"""What a trace returns in place of the next program counter when the frame ends."""

Trace = Callable[["Frame", list[int]], int]


class Halt(Exception):  # noqa: N818  (the yellow paper's term: exceptional halting)
    """The frame ends exceptionally: its gas is spent and its changes are undone."""


@lru_cache(maxsize=1 << 17)
def keccak_small(data: bytes) -> int:
    """Keccak-256 of short inputs, remembered: the same mapping slots are looked up in every transaction."""
    return int.from_bytes(keccak(data), "big")


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


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a transaction did.

    Attributes:
        status: True where it succeeded; where not, nothing changed but the sender's nonce.
        gas_used: after refunds.
        output: the return value, the revert's data, or the deployed code.
        created: the new contract's address, None for a call.
        halt: why it ended exceptionally; None after success and after REVERT.
    """

    status: bool
    gas_used: int
    output: bytes
    logs: tuple[Log, ...]
    created: int | None
    halt: str | None


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

        trace = self.traces[pc] = translate(self, pc, follow_jumps=True)
        return trace

    def straight_trace(self, pc: int) -> Trace:
        """A trace that ends at the first jump, for the rare frame whose stack is nearly full."""
        from skyrelay.chain.evm.translate import translate

        if pc not in self._straight:
            self._straight[pc] = translate(self, pc, follow_jumps=False)
        return self._straight[pc]


@lru_cache(maxsize=256)
def _code(code: bytes) -> Code:
    return Code(code)


NO_CODE = _code(b"")


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
        self.codes[address] = _code(code)


@dataclass(slots=True)
class Changes:
    """What transactions wrote, as the values before the first of them wrote."""

    storage: dict[tuple[int, int], int] = field(default_factory=dict)
    accounts: set[int] = field(default_factory=set)


class Transaction:
    """One transaction under way: access lists, refunds, logs, and the journal that undoes reverted frames."""

    __slots__ = (
        "block",
        "created",
        "destroyed",
        "journal",
        "logs",
        "origin",
        "originals",
        "refund",
        "state",
        "warm_accounts",
        "warm_slots",
    )

    def __init__(self, state: WorldState, block: BlockContext, origin: int) -> None:
        self.state = state
        self.block = block
        self.origin = origin
        self.warm_accounts: dict[int, Any] = dict.fromkeys(range(1, 10), True)
        self.warm_accounts[origin] = True
        self.warm_slots: dict[int, dict[int, Any]] = {}
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


class Frame:
    """One call or creation: its gas, memory and surroundings."""

    __slots__ = (
        "address",
        "caller",
        "code",
        "data",
        "depth",
        "gas",
        "mem",
        "originals",
        "output",
        "returned",
        "static",
        "storage",
        "tx",
        "value",
        "warm",
    )

    def __init__(
        self,
        tx: Transaction,
        code: Code,
        *,
        address: int,
        caller: int,
        value: int,
        data: bytes,
        gas: int,
        depth: int,
        static: bool,
    ) -> None:
        self.tx = tx
        self.code = code
        self.address = address
        self.caller = caller
        self.value = value
        self.data = data
        self.gas = gas
        self.depth = depth
        self.static = static
        self.mem = bytearray()
        self.returned = b""
        self.output = b""
        self.storage = tx.state.storage.setdefault(address, {})
        self.warm = tx.warm_slots.setdefault(address, {})
        self.originals = tx.originals.setdefault(address, {})


# The execution of a transaction and of its frames


def transact(
    state: WorldState,
    block: BlockContext,
    *,
    sender: int,
    to: int | None,
    data: bytes,
    gas: int,
    changes: Changes | None = None,
) -> Outcome:
    """Execute a transaction of no value at gas price 0, and keep what it changed.

    Args:
        to: the account called; None creates a contract from ``data``.
        gas: the limit; at least `intrinsic_gas`.
        changes: collects what was written.
    Raises:
        ChainError: ``gas`` is below the intrinsic gas (such a transaction fits no block), or the contract needs a
            precompiled contract that this machine does not have.
    """
    tx = Transaction(state, block, sender)
    try:
        outcome = _transact(tx, to, data, gas)
    except BaseException:
        tx.undo(0)
        raise
    if changes is not None:
        for address, slots in tx.originals.items():
            for slot, old in slots.items():
                changes.storage.setdefault((address, slot), old)
        tables = (state.nonces, state.balances, state.codes)
        changes.accounts.update(key for table, key, _ in tx.journal if any(table is known for known in tables))
    return outcome


def query(
    state: WorldState, block: BlockContext, *, sender: int, to: int | None, data: bytes, gas: int, free: bool = True
) -> Outcome:
    """Execute without keeping anything (eth_call).

    Args:
        free: leave the intrinsic gas out, so that ``gas`` is all for the contract.
    Raises:
        ChainError: as `transact`.
    """
    tx = Transaction(state, block, sender)
    try:
        return _transact(tx, to, data, gas + (intrinsic_gas(data, to is None) if free else 0))
    finally:
        tx.undo(0)


def intrinsic_gas(data: bytes, creates: bool) -> int:
    """Gas that a transaction costs before any code runs."""
    zeros = data.count(0)
    return INTRINSIC_GAS + 4 * zeros + 16 * (len(data) - zeros) + (CREATE_GAS if creates else 0)


def contract_address(sender: int, nonce: int) -> int:
    """Where CREATE puts a contract."""
    return int.from_bytes(keccak(rlp.encode([sender.to_bytes(20, "big"), nonce])), "big") & ADDRESS


def _transact(tx: Transaction, to: int | None, data: bytes, gas: int) -> Outcome:
    state = tx.state
    available = gas - intrinsic_gas(data, to is None)
    if available < 0:
        raise ChainError("chain: gas limit", gas, f"at least {gas - available}, the transaction's intrinsic gas")
    nonce = state.nonces.get(tx.origin, 0)
    tx.put(state.nonces, tx.origin, nonce + 1)
    created = None
    if to is None:
        created = contract_address(tx.origin, nonce)
        tx.warm_accounts[created] = True
        status, left, output, halt = _create_frame(tx, created, tx.origin, 0, data, available, 0)
    else:
        tx.warm_accounts[to] = True
        status, left, output, halt = _call_frame(tx, to, to, tx.origin, 0, data, available, 0, static=False)
    if not status:
        created = None
    used = gas - left
    used -= min(used // 5, tx.refund) if status else 0
    for address in tx.destroyed:
        for slot in list(state.storage.get(address, ())):
            tx.originals.setdefault(address, {}).setdefault(slot, state.storage[address][slot])
            tx.put(state.storage[address], slot, 0)
        tx.put(state.codes, address, NO_CODE)
        tx.put(state.nonces, address, 0)
        tx.put(state.balances, address, 0)
    return Outcome(status, used, output, tuple(tx.logs), created, halt)


Result = tuple[bool, int, bytes, str | None]
"""Of a frame: success, gas left, output, and the reason of an exceptional halt."""


def _call_frame(
    tx: Transaction,
    code_address: int,
    address: int,
    caller: int,
    value: int,
    data: bytes,
    gas: int,
    depth: int,
    *,
    static: bool,
    moves_value: bool = True,
) -> Result:
    mark = (len(tx.journal), len(tx.logs), tx.refund)
    if moves_value:
        tx.transfer(caller, address, value)
    if 1 <= code_address <= 9:
        return _precompiled(tx, mark[0], code_address, data, gas)
    code = tx.state.codes.get(code_address, NO_CODE)
    if not code.code:
        return True, gas, b"", None
    frame = Frame(tx, code, address=address, caller=caller, value=value, data=data, gas=gas, depth=depth, static=static)
    return _run(frame, mark)


def _create_frame(tx: Transaction, address: int, caller: int, value: int, init: bytes, gas: int, depth: int) -> Result:
    state = tx.state
    if state.nonces.get(address) or state.codes.get(address, NO_CODE).code:
        return False, 0, b"", "address collision"
    mark = (len(tx.journal), len(tx.logs), tx.refund)
    tx.put(state.nonces, address, 1)
    tx.transfer(caller, address, value)
    frame = Frame(
        tx, _code(init), address=address, caller=caller, value=value, data=b"", gas=gas, depth=depth, static=False
    )
    status, left, code, halt = _run(frame, mark)
    if not status:
        return status, left, code, halt
    left -= 200 * len(code)
    if left < 0 or len(code) > MAX_CODE_SIZE or code[:1] == b"\xef":
        _abandon(tx, mark)
        reason = "out of gas" if left < 0 else "code too large" if len(code) > MAX_CODE_SIZE else "code starts with EF"
        return False, 0, b"", reason
    tx.put(state.codes, address, _code(code))
    return True, left, code, None


def _run(frame: Frame, mark: tuple[int, int, int]) -> Result:
    """Run a frame to its end; undo to ``mark`` if it fails."""
    code = frame.code
    traces = code.traces
    stack: list[int] = []
    pc = 0
    try:
        while pc >= 0:
            trace = traces.get(pc) or code.trace(pc)
            pc = trace(frame, stack)
    except Halt as halt:
        reason = str(halt)
    except IndexError:  # a trace popped from the empty stack
        reason = "stack underflow"
    else:
        if pc == STOPPED:
            return True, frame.gas, frame.output, None
        _abandon(frame.tx, mark)
        return False, frame.gas, frame.output, None
    _abandon(frame.tx, mark)
    return False, 0, b"", reason


def _abandon(tx: Transaction, mark: tuple[int, int, int]) -> None:
    journal, logs, tx.refund = mark
    tx.undo(journal)
    del tx.logs[logs:]


# What translated code calls. Each charges the dynamic part of its gas; the static part is charged by the trace.


def extend(f: Frame, end: int) -> None:
    """Grow memory to hold ``end`` bytes."""
    words, old = (end + 31) >> 5, len(f.mem) >> 5
    f.gas -= 3 * (words - old) + (words * words >> 9) - (old * old >> 9)
    if f.gas < 0:
        raise Halt("out of gas")
    f.mem.extend(bytes((words - old) << 5))


def _touch(f: Frame, offset: int, size: int) -> None:
    if size and offset + size > len(f.mem):
        extend(f, offset + size)


def _charge(f: Frame, gas: int) -> None:
    f.gas -= gas
    if f.gas < 0:
        raise Halt("out of gas")


def sha3(f: Frame, offset: int, size: int) -> int:
    """KECCAK256."""
    _charge(f, 6 * ((size + 31) >> 5))
    _touch(f, offset, size)
    data = bytes(f.mem[offset : offset + size]) if size else b""
    return keccak_small(data) if size <= 64 else int.from_bytes(keccak(data), "big")


def sload(f: Frame, slot: int) -> int:
    """SLOAD (EIP-2929)."""
    if slot in f.warm:
        f.gas -= 100
    else:
        f.gas -= 2100
        f.tx.journal.append((f.warm, slot, None))
        f.warm[slot] = True
    if f.gas < 0:
        raise Halt("out of gas")
    return f.storage.get(slot, 0)


def sstore(f: Frame, slot: int, value: int) -> None:
    """SSTORE (EIP-2200, 2929, 3529)."""
    if f.static:
        raise Halt("write in a static call")
    if f.gas <= 2300:
        raise Halt("out of gas")
    tx = f.tx
    cost = 0
    if slot not in f.warm:
        cost = 2100
        tx.journal.append((f.warm, slot, None))
        f.warm[slot] = True
    current = f.storage.get(slot, 0)
    original = f.originals.setdefault(slot, current)
    if value == current:
        cost += 100
    elif current == original:
        cost += 2900 if original else 20_000
        if original and not value:
            tx.refund += 4800
    else:
        cost += 100
        if original and not current:
            tx.refund -= 4800
        elif original and not value:
            tx.refund += 4800
        if value == original:
            tx.refund += 2800 if original else 19_900
    f.gas -= cost
    if f.gas < 0:
        raise Halt("out of gas")
    if value != current:
        tx.journal.append((f.storage, slot, current))
        f.storage[slot] = int(value)  # a comparison's bool becomes the number that it is


def log(f: Frame, offset: int, size: int, topics: tuple[int, ...]) -> None:
    """LOG0..LOG4."""
    if f.static:
        raise Halt("write in a static call")
    _charge(f, 8 * size)
    _touch(f, offset, size)
    data = bytes(f.mem[offset : offset + size]) if size else b""
    f.tx.logs.append(Log(f.address, tuple(int(topic) for topic in topics), data))


def call_data_load(data: bytes, offset: int) -> int:
    """CALLDATALOAD."""
    return int.from_bytes(data[offset : offset + 32].ljust(32, b"\0"), "big")


def copy(f: Frame, source: bytes, target: int, offset: int, size: int) -> None:
    """CALLDATACOPY, CODECOPY: bytes beyond the source are zeros."""
    _charge(f, 3 * ((size + 31) >> 5))
    _touch(f, target, size)
    if size:
        f.mem[target : target + size] = source[offset : offset + size].ljust(size, b"\0")


def return_data_copy(f: Frame, target: int, offset: int, size: int) -> None:
    """RETURNDATACOPY: halts beyond the data (EIP-211)."""
    if offset + size > len(f.returned):
        raise Halt("return data out of bounds")
    copy(f, f.returned, target, offset, size)


def _account(f: Frame, address: int) -> int:
    """The address, its access charged (EIP-2929)."""
    address &= ADDRESS
    warm = f.tx.warm_accounts
    if address in warm:
        _charge(f, 100)
    else:
        f.tx.journal.append((warm, address, None))
        warm[address] = True
        _charge(f, 2600)
    return address


def balance(f: Frame, address: int) -> int:
    """BALANCE."""
    return f.tx.state.balances.get(_account(f, address), 0)


def code_size(f: Frame, address: int) -> int:
    """EXTCODESIZE."""
    return len(f.tx.state.codes.get(_account(f, address), NO_CODE).code)


def code_hash(f: Frame, address: int) -> int:
    """EXTCODEHASH: 0 of an empty account."""
    address = _account(f, address)
    return 0 if f.tx.state.is_empty(address) else f.tx.state.codes.get(address, NO_CODE).hash


def code_copy(f: Frame, address: int, target: int, offset: int, size: int) -> None:
    """EXTCODECOPY."""
    copy(f, f.tx.state.codes.get(_account(f, address), NO_CODE).code, target, offset, size)


def block_hash(f: Frame, number: int) -> int:
    """BLOCKHASH: of the 256 blocks before this one, else 0."""
    block = f.tx.block
    return block.block_hash(number) if block.number - 256 <= number < block.number else 0


def exp(f: Frame, base: int, exponent: int) -> int:
    """EXP (EIP-160)."""
    _charge(f, 50 * ((exponent.bit_length() + 7) >> 3))
    return pow(base, exponent, 1 << 256)


def signed(value: int) -> int:
    """A word as a two's complement number."""
    return value - (1 << 256) if value >> 255 else value


def sdiv(a: int, b: int) -> int:
    """SDIV: rounds towards zero."""
    a, b = signed(a), signed(b)
    if b == 0:
        return 0
    return (abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)) & WORD


def smod(a: int, b: int) -> int:
    """SMOD: the sign of the dividend."""
    a, b = signed(a), signed(b)
    if b == 0:
        return 0
    return (abs(a) % abs(b) * (1 if a >= 0 else -1)) & WORD


def sign_extend(size: int, value: int) -> int:
    """SIGNEXTEND from ``size`` + 1 bytes."""
    if size > 30:
        return value
    bits = 8 * size + 8
    value &= (1 << bits) - 1
    return value | (WORD ^ ((1 << bits) - 1)) if value >> (bits - 1) else value


def sar(shift: int, value: int) -> int:
    """SAR."""
    return (signed(value) >> min(shift, 256)) & WORD


def call(f: Frame, gas: int, to: int, value: int, offset: int, size: int, target: int, room: int) -> int:
    """CALL."""
    if value and f.static:
        raise Halt("write in a static call")
    to &= ADDRESS
    extra = 0
    if value:
        extra = 9_000 + (25_000 if f.tx.state.is_empty(to) else 0)
    return _message(f, gas, to, to, f.address, value, (offset, size, target, room), extra, static=f.static)


def call_code(f: Frame, gas: int, to: int, value: int, offset: int, size: int, target: int, room: int) -> int:
    """CALLCODE."""
    area = (offset, size, target, room)
    return _message(f, gas, to & ADDRESS, f.address, f.address, value, area, 9_000 if value else 0, static=f.static)


def delegate_call(f: Frame, gas: int, to: int, offset: int, size: int, target: int, room: int) -> int:
    """DELEGATECALL."""
    area = (offset, size, target, room)
    return _message(f, gas, to & ADDRESS, f.address, f.caller, f.value, area, 0, static=f.static, moves_value=False)


def static_call(f: Frame, gas: int, to: int, offset: int, size: int, target: int, room: int) -> int:
    """STATICCALL."""
    to &= ADDRESS
    return _message(f, gas, to, to, f.address, 0, (offset, size, target, room), 0, static=True)


def _message(
    f: Frame,
    gas: int,
    code_address: int,
    address: int,
    caller: int,
    value: int,
    area: tuple[int, int, int, int],
    extra: int,
    *,
    static: bool,
    moves_value: bool = True,
) -> int:
    offset, size, target, room = area
    _touch(f, offset, size)
    _touch(f, target, room)
    _account(f, code_address)
    _charge(f, extra)
    given = min(gas, f.gas - f.gas // 64)  # EIP-150
    f.gas -= given
    if value and moves_value:
        given += 2300
    tx = f.tx
    f.returned = b""
    if f.depth >= MAX_DEPTH or (moves_value and value and tx.state.balances.get(f.address, 0) < value):
        f.gas += given
        return 0
    _allow_depth(f.depth)
    data = bytes(f.mem[offset : offset + size]) if size else b""
    status, left, output, _ = _call_frame(
        tx, code_address, address, caller, value, data, given, f.depth + 1, static=static, moves_value=moves_value
    )
    f.gas += left
    f.returned = output
    written = min(room, len(output))
    if written:
        f.mem[target : target + written] = output[:written]
    return 1 if status else 0


def create(f: Frame, value: int, offset: int, size: int, salt: int | None = None) -> int:
    """CREATE, and CREATE2 where there is a salt."""
    if f.static:
        raise Halt("write in a static call")
    if salt is not None:
        _charge(f, 6 * ((size + 31) >> 5))
    _touch(f, offset, size)
    init = bytes(f.mem[offset : offset + size]) if size else b""
    given = f.gas - f.gas // 64
    f.gas -= given
    f.returned = b""
    tx = f.tx
    nonce = tx.state.nonces.get(f.address, 0)
    if tx.state.balances.get(f.address, 0) < value or f.depth >= MAX_DEPTH or nonce >= (1 << 64) - 1:
        f.gas += given
        return 0
    if salt is None:
        address = contract_address(f.address, nonce)
    else:
        seed = b"\xff" + f.address.to_bytes(20, "big") + salt.to_bytes(32, "big") + keccak(init)
        address = int.from_bytes(keccak(seed), "big") & ADDRESS
    if address not in tx.warm_accounts:
        tx.put(tx.warm_accounts, address, True)
    tx.put(tx.state.nonces, f.address, nonce + 1)
    _allow_depth(f.depth)
    status, left, output, halt = _create_frame(tx, address, f.address, value, init, given, f.depth + 1)
    f.gas += left
    if status:
        return address
    f.returned = b"" if halt else output
    return 0


def self_destruct(f: Frame, heir: int) -> None:
    """SELFDESTRUCT (EIP-161, 2929, 3529)."""
    if f.static:
        raise Halt("write in a static call")
    heir &= ADDRESS
    tx = f.tx
    state = tx.state
    if heir not in tx.warm_accounts:
        tx.put(tx.warm_accounts, heir, True)
        _charge(f, 2600)
    amount = state.balances.get(f.address, 0)
    if amount and state.is_empty(heir):
        _charge(f, 25_000)
    tx.transfer(f.address, heir, amount)
    tx.put(state.balances, f.address, 0)
    tx.put(tx.destroyed, f.address, True)


def _allow_depth(depth: int) -> None:
    """A chain of calls is as many Python calls deep, three for each."""
    if depth == 100 and sys.getrecursionlimit() < 8 * MAX_DEPTH:
        sys.setrecursionlimit(8 * MAX_DEPTH)


# Precompiled contracts


def _precompiled(tx: Transaction, mark: int, address: int, data: bytes, gas: int) -> Result:
    words = (len(data) + 31) >> 5
    if address == 5:
        cost, output = _mod_exp(data, gas)
    elif address in _PRECOMPILED:
        base, per_word, run = _PRECOMPILED[address]
        cost = base + per_word * words
        output = run(data) if cost <= gas else b""
    else:
        raise ChainError(
            "chain: precompiled contract", address, "one of 1 to 5 (the embedded chain has no curves or BLAKE2)"
        )
    if cost > gas:
        tx.undo(mark)
        return False, 0, b"", "out of gas"
    return True, gas - cost, output, None


def _recover(data: bytes) -> bytes:
    """ECRECOVER: nothing where the signature is none."""
    from eth_keys.datatypes import Signature
    from eth_keys.exceptions import BadSignature
    from eth_utils.exceptions import ValidationError

    data = data.ljust(128, b"\0")
    v, r, s = (int.from_bytes(data[i : i + 32], "big") for i in (32, 64, 96))
    if v not in (27, 28):
        return b""
    try:
        key = Signature(vrs=(v - 27, r, s)).recover_public_key_from_msg_hash(data[:32])
    except (BadSignature, ValidationError):
        return b""
    return key.to_canonical_address().rjust(32, b"\0")


def _ripemd160(data: bytes) -> bytes:
    from Crypto.Hash import RIPEMD160  # OpenSSL 3 keeps it in its legacy provider, which many systems leave out

    return bytes(RIPEMD160.new(data).digest()).rjust(32, b"\0")


_PRECOMPILED: dict[int, tuple[int, int, Callable[[bytes], bytes]]] = {
    1: (3000, 0, _recover),
    2: (60, 12, lambda data: hashlib.sha256(data).digest()),
    3: (600, 120, _ripemd160),
    4: (15, 3, lambda data: data),
}


def _mod_exp(data: bytes, gas: int) -> tuple[int, bytes]:
    """MODEXP with EIP-2565's price."""
    base_size, exponent_size, modulus_size = (call_data_load(data, i) for i in (0, 32, 64))
    head = call_data_load(data[96 + base_size :], 0) >> (8 * (32 - min(exponent_size, 32)))
    iterations = max(head.bit_length() - 1, 0) + (8 * (exponent_size - 32) if exponent_size > 32 else 0)
    complexity = ((max(base_size, modulus_size) + 7) // 8) ** 2
    cost = max(200, complexity * max(iterations, 1) // 3)
    if cost > gas or modulus_size == 0:
        return cost, b""
    padded = data[96:].ljust(base_size + exponent_size + modulus_size, b"\0")
    numbers: Sequence[int] = [
        int.from_bytes(padded[start : start + size], "big")
        for start, size in (
            (0, base_size),
            (base_size, exponent_size),
            (base_size + exponent_size, modulus_size),
        )
    ]
    base, exponent, modulus = numbers
    return cost, (pow(base, exponent, modulus) if modulus else 0).to_bytes(modulus_size, "big")
