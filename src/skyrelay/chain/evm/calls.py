"""Transactions and the frames that they are made of: calls, creations, and what undoes them."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import rlp
from eth_hash.auto import keccak

from skyrelay.chain.evm.frame import STOPPED, Frame, Halt
from skyrelay.chain.evm.gas import account, charge, intrinsic_gas, touch
from skyrelay.chain.evm.precompiles import PAIRING, precompiled
from skyrelay.chain.evm.state import NO_CODE, BlockContext, Changes, Log, Transaction, WorldState, code_of
from skyrelay.chain.evm.words import ADDRESS
from skyrelay.core.errors import ChainError
from skyrelay.core.recursion import recursion_limit_kept

MAX_CODE_SIZE = 24_576
MAX_DEPTH = 1024


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


def transact(
    state: WorldState,
    block: BlockContext,
    *,
    sender: int,
    to: int | None,
    data: bytes,
    gas: int,
    changes: Changes | None = None,
    until: float | None = None,
) -> Outcome:
    """Execute a transaction of no value at gas price 0, and keep what it changed.

    Args:
        to: the account called; None creates a contract from ``data``.
        gas: the limit; at least `intrinsic_gas`.
        changes: collects what was written.
        until: by `time.monotonic`, when it must have ended.
    Raises:
        ChainError: ``gas`` is below the intrinsic gas (such a transaction fits no block), or it takes longer
            than ``until``; then nothing has changed.
    """
    tx = Transaction(state, block, sender)
    tx.until = until
    try:
        outcome = execute(tx, to, data, gas)
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
        return execute(tx, to, data, gas + (intrinsic_gas(data, to is None) if free else 0))
    finally:
        tx.undo(0)


def create_at(state: WorldState, block: BlockContext, *, sender: int, address: int, data: bytes, gas: int) -> Outcome:
    """Create a contract at an address of one's choice, the state being a scratch of the caller's."""
    tx = Transaction(state, block, sender)
    tx.warm_accounts[address] = True
    with recursion_limit_kept():
        status, left, output, halt = _create_frame(tx, address, sender, 0, data, gas, 0)
    return Outcome(status, gas - left, output, tuple(tx.logs), address if status else None, halt)


def contract_address(sender: int, nonce: int) -> int:
    """Where CREATE puts a contract."""
    return int.from_bytes(keccak(rlp.encode([sender.to_bytes(20, "big"), nonce])), "big") & ADDRESS


def execute(tx: Transaction, to: int | None, data: bytes, gas: int, value: int = 0) -> Outcome:
    """Execute a transaction whose sender can pay ``value``; what it changed stays in the journal.

    Raises:
        ChainError: as `transact`.
    """
    with recursion_limit_kept():  # deep calls raise it
        return _execute(tx, to, data, gas, value)


def _execute(tx: Transaction, to: int | None, data: bytes, gas: int, value: int) -> Outcome:
    state = tx.state
    available = gas - intrinsic_gas(data, to is None) - tx.access_gas
    if available < 0:
        raise ChainError("chain: gas limit", gas, f"at least {gas - available}, the transaction's intrinsic gas")
    nonce = state.nonces.get(tx.origin, 0)
    tx.put(state.nonces, tx.origin, nonce + 1)
    created = None
    if to is None:
        created = contract_address(tx.origin, nonce)
        tx.warm_accounts[created] = True
        status, left, output, halt = _create_frame(tx, created, tx.origin, value, data, available, 0)
    else:
        tx.warm_accounts[to] = True
        status, left, output, halt = _call_frame(tx, to, to, tx.origin, value, data, available, 0, static=False)
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
        answer = precompiled(code_address, data, gas, tx.pairs)
        if code_address == PAIRING and not isinstance(answer, str):
            tx.pairs -= len(data) // 192
        if isinstance(answer, str):
            tx.undo(mark[0])
            return False, 0, b"", answer
        cost, output = answer
        return True, gas - cost, output, None
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
    if any(state.storage.get(address, {}).values()):  # only a state that was made by hand can have it; a new one begins
        tx.put(state.storage, address, {})
    tx.transfer(caller, address, value)
    frame = Frame(
        tx, code_of(init), address=address, caller=caller, value=value, data=b"", gas=gas, depth=depth, static=False
    )
    status, left, code, halt = _run(frame, mark)
    if not status:
        return status, left, code, halt
    left -= 200 * len(code)
    if left < 0 or len(code) > MAX_CODE_SIZE or code[:1] == b"\xef":
        _abandon(tx, mark)
        reason = "out of gas" if left < 0 else "code too large" if len(code) > MAX_CODE_SIZE else "code starts with EF"
        return False, 0, b"", reason
    tx.put(state.codes, address, code_of(code))
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
    touch(f, offset, size)
    touch(f, target, room)
    account(f, code_address)
    charge(f, extra)
    given = min(gas, f.gas - f.gas // 64)  # EIP-150
    f.gas -= given
    if value and moves_value:
        given += 2300
    tx = f.tx
    f.returned = b""
    if f.depth >= MAX_DEPTH or (moves_value and value and tx.state.balances.get(f.address, 0) < value):
        f.gas += given
        return 0
    _allow(tx, f.depth)
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
        charge(f, 6 * ((size + 31) >> 5))
    touch(f, offset, size)
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
    _allow(tx, f.depth)
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
        charge(f, 2600)
    amount = state.balances.get(f.address, 0)
    if amount and state.is_empty(heir):
        charge(f, 25_000)
    tx.transfer(f.address, heir, amount)
    tx.put(state.balances, f.address, 0)
    tx.put(tx.destroyed, f.address, True)


def _allow(tx: Transaction, depth: int) -> None:
    """Another frame: a chain of calls is as many Python calls deep, three for each."""
    if tx.until is not None and time.monotonic() > tx.until:
        raise ChainError("chain: a transaction", "still running", "one that ends within the time for its record")
    if depth == 100 and sys.getrecursionlimit() < 8 * MAX_DEPTH:
        sys.setrecursionlimit(8 * MAX_DEPTH)
