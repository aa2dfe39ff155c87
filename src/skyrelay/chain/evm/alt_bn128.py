"""The precompiled contracts 6 to 8: addition, multiplication and pairing on alt_bn128 (EIP-196, EIP-197, EIP-1108).

The curve's arithmetic is py_ecc's. A pairing takes it a good part of a second, and the price of gas is that of compiled
code, so that a transaction may ask for a few alone (`skyrelay.chain.evm.state.MAX_PAIRS`): a call for more fails, where
another machine would answer.
"""

from __future__ import annotations

from typing import Any

from skyrelay.core.recursion import recursion_limit_kept

ADD_GAS, MULTIPLY_GAS = 150, 6_000
PAIRING_GAS, PAIR_GAS = 45_000, 34_000


def add(data: bytes) -> bytes | None:
    """The sum of two points, 64 bytes; None where one is none."""
    curve = _curve()
    try:
        a, b = (_point(curve, data.ljust(128, b"\0")[start : start + 64]) for start in (0, 64))
    except ValueError:
        return None
    return _bytes(curve, curve.add(a, b))


def multiply(data: bytes) -> bytes | None:
    """A point times a number, 64 bytes; None where it is none."""
    curve = _curve()
    data = data.ljust(96, b"\0")
    try:
        point = _point(curve, data[:64])
    except ValueError:
        return None
    return _bytes(curve, curve.multiply(point, int.from_bytes(data[64:96], "big") % curve.curve_order))


def pairing(data: bytes) -> bytes | None:
    """Whether the product of all pairings is one, 32 bytes; None where there are no such points."""
    if len(data) % 192:
        return None
    curve = _curve()
    product = curve.FQ12.one()
    try:
        pairs = [
            (_point(curve, data[start : start + 64]), _twisted(curve, data[start + 64 : start + 192]))
            for start in range(0, len(data), 192)
        ]
    except ValueError:
        return None
    for point, twisted in pairs:
        if not curve.is_inf(point) and not curve.is_inf(twisted):
            product = product * curve.pairing(twisted, point, final_exponentiate=False)
    return int(curve.final_exponentiate(product) == curve.FQ12.one()).to_bytes(32, "big")


def _curve() -> Any:
    with recursion_limit_kept():  # py_ecc raises it to 100,000
        from py_ecc import optimized_bn128
    return optimized_bn128


def _numbers(curve: Any, data: bytes) -> list[int]:
    numbers = [int.from_bytes(data[start : start + 32], "big") for start in range(0, len(data), 32)]
    if any(number >= curve.field_modulus for number in numbers):
        raise ValueError
    return numbers


def _point(curve: Any, data: bytes) -> Any:
    x, y = _numbers(curve, data)
    if x == y == 0:
        return curve.Z1
    point = (curve.FQ(x), curve.FQ(y), curve.FQ(1))
    if not curve.is_on_curve(point, curve.b):
        raise ValueError
    return point


def _twisted(curve: Any, data: bytes) -> Any:
    """A point of the second group, whose coordinates have their imaginary part first."""
    numbers = _numbers(curve, data)
    if not any(numbers):
        return curve.Z2
    x1, x0, y1, y0 = numbers
    point = (curve.FQ2([x0, x1]), curve.FQ2([y0, y1]), curve.FQ2.one())
    if not curve.is_on_curve(point, curve.b2) or not curve.is_inf(curve.multiply(point, curve.curve_order)):
        raise ValueError
    return point


def _bytes(curve: Any, point: Any) -> bytes:
    if curve.is_inf(point):
        return bytes(64)
    x, y = curve.normalize(point)
    return int(x).to_bytes(32, "big") + int(y).to_bytes(32, "big")
