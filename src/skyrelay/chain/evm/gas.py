"""Gas that is not the same each time: memory, access to accounts, what a transaction costs before any code runs."""

from __future__ import annotations

from skyrelay.chain.evm.frame import Frame, Halt
from skyrelay.chain.evm.words import ADDRESS

INTRINSIC_GAS = 21_000
CREATE_GAS = 32_000


def intrinsic_gas(data: bytes, creates: bool) -> int:
    """Gas that a transaction costs before any code runs."""
    zeros = data.count(0)
    return INTRINSIC_GAS + 4 * zeros + 16 * (len(data) - zeros) + (CREATE_GAS if creates else 0)


def extend(f: Frame, end: int) -> None:
    """Grow memory to hold ``end`` bytes."""
    words, old = (end + 31) >> 5, len(f.mem) >> 5
    f.gas -= 3 * (words - old) + (words * words >> 9) - (old * old >> 9)
    if f.gas < 0:
        raise Halt("out of gas")
    f.mem.extend(bytes((words - old) << 5))


def touch(f: Frame, offset: int, size: int) -> None:
    """Grow memory to hold an area of it."""
    if size and offset + size > len(f.mem):
        extend(f, offset + size)


def charge(f: Frame, gas: int) -> None:
    """Spend gas."""
    f.gas -= gas
    if f.gas < 0:
        raise Halt("out of gas")


def account(f: Frame, address: int) -> int:
    """The address, its access charged (EIP-2929)."""
    address &= ADDRESS
    warm = f.tx.warm_accounts
    if address in warm:
        charge(f, 100)
    else:
        f.tx.journal.append((warm, address, None))
        warm[address] = True
        charge(f, 2600)
    return address
