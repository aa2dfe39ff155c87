"""Contracts that are part of the machine: addresses 1 to 9."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

from skyrelay.chain.evm import alt_bn128
from skyrelay.chain.evm.words import call_data_load

PAIRING = 8


def precompiled(address: int, data: bytes, gas: int, pairs: int) -> tuple[int, bytes] | str:
    """What a precompiled contract costs and gives, or why the call of it ends exceptionally.

    Args:
        pairs: that a pairing may still ask for.
    """
    words = (len(data) + 31) >> 5
    if address == 5:
        cost, output = _mod_exp(data, gas)
    elif address in _ON_A_CURVE:
        run_curve, base = _ON_A_CURVE[address]
        cost = base + (alt_bn128.PAIR_GAS * (len(data) // 192) if address == PAIRING else 0)
        if address == PAIRING and cost <= gas and len(data) // 192 > pairs:
            return "more pairings than a transaction may ask of this machine"
        found = run_curve(data) if cost <= gas else b""
        if found is None:
            return "no points of the curve"
        output = found
    elif address in _PRECOMPILED:
        base, per_word, run = _PRECOMPILED[address]
        cost = base + per_word * words
        output = run(data) if cost <= gas else b""
    else:
        return f"precompiled contract {address} is not part of this machine"
    return (cost, output) if cost <= gas else "out of gas"


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

_ON_A_CURVE: dict[int, tuple[Callable[[bytes], bytes | None], int]] = {
    6: (alt_bn128.add, alt_bn128.ADD_GAS),
    7: (alt_bn128.multiply, alt_bn128.MULTIPLY_GAS),
    PAIRING: (alt_bn128.pairing, alt_bn128.PAIRING_GAS),
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
    middle, end = base_size + exponent_size, base_size + exponent_size + modulus_size
    base, exponent, modulus = (
        int.from_bytes(padded[first:last], "big")
        for first, last in ((0, base_size), (base_size, middle), (middle, end))
    )
    return cost, (pow(base, exponent, modulus) if modulus else 0).to_bytes(modulus_size, "big")
