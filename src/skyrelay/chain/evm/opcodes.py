"""What translated code calls, but for calls and creations.

Each charges the dynamic part of its gas; the static part is charged by the trace.
"""

from __future__ import annotations

from eth_hash.auto import keccak

from skyrelay.chain.evm.frame import Frame, Halt
from skyrelay.chain.evm.gas import account, charge, touch
from skyrelay.chain.evm.state import NO_CODE, Log
from skyrelay.chain.evm.words import keccak_small


def sha3(f: Frame, offset: int, size: int) -> int:
    """KECCAK256."""
    charge(f, 6 * ((size + 31) >> 5))
    touch(f, offset, size)
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
    charge(f, 8 * size)
    touch(f, offset, size)
    data = bytes(f.mem[offset : offset + size]) if size else b""
    f.tx.logs.append(Log(f.address, tuple(int(topic) for topic in topics), data))


def copy(f: Frame, source: bytes, target: int, offset: int, size: int) -> None:
    """CALLDATACOPY, CODECOPY: bytes beyond the source are zeros."""
    charge(f, 3 * ((size + 31) >> 5))
    touch(f, target, size)
    if size:
        f.mem[target : target + size] = source[offset : offset + size].ljust(size, b"\0")


def return_data_copy(f: Frame, target: int, offset: int, size: int) -> None:
    """RETURNDATACOPY: halts beyond the data (EIP-211)."""
    if offset + size > len(f.returned):
        raise Halt("return data out of bounds")
    copy(f, f.returned, target, offset, size)


def balance(f: Frame, address: int) -> int:
    """BALANCE."""
    return f.tx.state.balances.get(account(f, address), 0)


def code_size(f: Frame, address: int) -> int:
    """EXTCODESIZE."""
    return len(f.tx.state.codes.get(account(f, address), NO_CODE).code)


def code_hash(f: Frame, address: int) -> int:
    """EXTCODEHASH: 0 of an empty account."""
    address = account(f, address)
    return 0 if f.tx.state.is_empty(address) else f.tx.state.codes.get(address, NO_CODE).hash


def code_copy(f: Frame, address: int, target: int, offset: int, size: int) -> None:
    """EXTCODECOPY."""
    copy(f, f.tx.state.codes.get(account(f, address), NO_CODE).code, target, offset, size)


def block_hash(f: Frame, number: int) -> int:
    """BLOCKHASH: of the 256 blocks before this one, else 0."""
    block = f.tx.block
    return block.block_hash(number) if block.number - 256 <= number < block.number else 0


def exp(f: Frame, base: int, exponent: int) -> int:
    """EXP (EIP-160)."""
    charge(f, 50 * ((exponent.bit_length() + 7) >> 3))
    return pow(base, exponent, 1 << 256)
