"""Signed transactions as they come over the wire: taken apart, and their sender worked out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import rlp
from eth_hash.auto import keccak

from skyrelay.chain.accounts import recovered
from skyrelay.core.errors import ChainError

LONGEST = 128 * 1024
"""Bytes of a transaction, as go-ethereum has it."""
_HALF_ORDER = 0x7FFFFFFFFFFFFFFFFFFFFFFFFFFFFFFF5D576E7357A4501DDFE92F46681B20A0
_FIELDS = {0: 9, 1: 11, 2: 12}
"""Type (0 for none) to number of fields."""


@dataclass(frozen=True, slots=True)
class SignedTransaction:
    """A transaction that its sender has signed.

    Attributes:
        chain_id: that it is for; None where it is for any (before EIP-155).
        price: the most that the sender would pay for gas [wei].
        value: [wei].
    """

    raw: bytes
    hash: str
    sender: str
    chain_id: int | None
    nonce: int
    to: str | None
    gas: int
    price: int
    value: int
    data: bytes


def read_signed(raw: bytes) -> SignedTransaction:
    """A transaction from its bytes: legacy, EIP-2930 or EIP-1559.

    Raises:
        ChainError: the bytes are none, in the one form that there is for them, or nobody's signature is under them.
    """
    if not 0 < len(raw) <= LONGEST:
        raise _malformed(f"{len(raw)} bytes", f"1 to {LONGEST}")
    kind = raw[0] if raw[0] < 0x80 else 0
    if kind not in _FIELDS or raw[0] == 0:
        raise _malformed(f"type {raw[0]}", "a legacy transaction or one of type 1 or 2")
    prefix = raw[:1] if kind else b""
    try:
        fields = rlp.decode(raw[len(prefix) :], strict=True)
    except (rlp.RLPException, RecursionError):
        raise _malformed(None, "RLP") from None
    access = fields[-4] if kind and isinstance(fields, list) and len(fields) == _FIELDS[kind] else []
    plain = [field for field in fields if field is not access] if isinstance(fields, list) else []
    if len(plain) != _FIELDS[kind] - bool(kind) or not all(isinstance(field, bytes) for field in plain):
        raise _malformed(None, f"{_FIELDS[kind]} fields")
    if access != []:
        raise _malformed("an access list", "none: gas is free here")
    v, r, s = (_number(field) for field in plain[-3:])
    if not (0 < r < 1 << 256 and 0 < s <= _HALF_ORDER):
        raise _malformed(None, "a signature with the smaller s (EIP-2)")
    unsigned: Sequence[Any] = fields[:-3]
    chain_id: int | None
    if kind:
        chain_id, parity = _number(plain[0]), v
    elif v >= 35:
        chain_id, parity = divmod(v - 35, 2)
        unsigned = [*unsigned, chain_id.to_bytes((chain_id.bit_length() + 7) // 8, "big"), b"", b""]
    else:
        chain_id, parity = None, v - 27
    if parity not in (0, 1):
        raise _malformed(f"v = {v}", "a signature's parity")
    digest = keccak(prefix + rlp.encode(unsigned, infer_serializer=False))
    sender = recovered(digest, r.to_bytes(32, "big") + s.to_bytes(32, "big") + bytes([parity]))
    if sender is None:
        raise _malformed(None, "a signature that somebody can have made")
    nonce, *prices, gas, to, value, data = plain[1:-3] if kind else plain[:-3]
    if len(to) not in (0, 20):
        raise _malformed(f"{len(to)} bytes", "a recipient of 20 bytes or none")
    return SignedTransaction(
        raw=raw,
        hash="0x" + keccak(raw).hex(),
        sender=sender,
        chain_id=chain_id,
        nonce=_number(nonce),
        to="0x" + to.hex() if to else None,
        gas=_number(gas),
        price=max(_number(price) for price in prices),
        value=_number(value),
        data=data,
    )


def _number(field: bytes) -> int:
    if field[:1] == b"\0" or len(field) > 32:
        raise _malformed(None, "numbers without leading zeros, of 32 bytes at most")
    return int.from_bytes(field, "big")


def _malformed(value: object, expected: str) -> ChainError:
    return ChainError("signed transaction", value, expected)
