"""Words of 256 bits: their arithmetic where it is not Python's own."""

from __future__ import annotations

from functools import lru_cache

from eth_hash.auto import keccak

WORD = (1 << 256) - 1
ADDRESS = (1 << 160) - 1


@lru_cache(maxsize=1 << 17)
def keccak_small(data: bytes) -> int:
    """Keccak-256 of short inputs, remembered: the same mapping slots are looked up in every transaction."""
    return int.from_bytes(keccak(data), "big")


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


def call_data_load(data: bytes, offset: int) -> int:
    """CALLDATALOAD."""
    return int.from_bytes(data[offset : offset + 32].ljust(32, b"\0"), "big")
