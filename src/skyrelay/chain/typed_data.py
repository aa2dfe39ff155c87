"""What is signed off the chain for others to hand in: proposals, vouchers, receipts for payment (EIP-712)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from eth_hash.auto import keccak

from skyrelay.chain.accounts import Keyring, recovered
from skyrelay.core.recursion import recursion_limit_kept

with recursion_limit_kept():
    from eth_account.messages import SignableMessage, encode_typed_data

_PROPOSAL = (
    ("uav", "address"),
    ("zone", "uint32"),
    ("round", "uint32"),
    ("x", "int32"),
    ("y", "int32"),
    ("payment", "uint32"),
    ("demand", "uint32"),
    ("since", "uint32"),
)
_VOUCHER = (("member", "address"), ("kind", "uint8"), ("expires", "uint256"))
_ACKNOWLEDGEMENT = (("proposal", "bytes32"), ("deadline", "uint256"))
_RECEIPT = (
    ("vehicle", "address"),
    ("uav", "address"),
    ("zone", "uint32"),
    ("period", "uint32"),
    ("amount", "uint96"),
)
UAV, VEHICLE = 1, 2
"""Kinds of members in a voucher."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A vehicle's proposal with its record for the period, in the contract's units.

    Attributes:
        uav: address of the UAV that it asks.
        zone, round: of the UAV, which the proposal is for and no other.
        x, y: where the vehicle is [0.1 m].
        payment: [cents per Mbit/s]; demand: [kbit/s].
        since: time of the record that this one replaces, as the contract has it [s]: every record's is another, so
            that the same proposal is never taken twice.
    """

    uav: str
    zone: int
    round: int
    x: int
    y: int
    payment: int
    demand: int
    since: int


@dataclass(frozen=True, slots=True)
class SignedProposal:
    """A proposal and its vehicle's signature: 65 bytes, r, s, v."""

    proposal: Proposal
    signature: bytes

    @property
    def packed(self) -> tuple[int, bytes, bytes]:
        """Terms, r, and vs, as `submitSigned` takes them."""
        p = self.proposal
        terms = p.since << 128 | p.demand << 96 | p.payment << 64 | (p.y & 0xFFFFFFFF) << 32 | p.x & 0xFFFFFFFF
        return terms, *compact(self.signature)

    @classmethod
    def unpacked(cls, uav: str, zone: int, round_: int, terms: int, r: str, vs: str) -> SignedProposal:
        """From what `submitSigned` was called with, `r` and `vs` as ``0x`` text; the inverse of `packed`."""
        x, y, payment, demand, since = ((terms >> 32 * place) & 0xFFFFFFFF for place in range(5))
        signature = expanded(bytes.fromhex(r[2:]), bytes.fromhex(vs[2:]))
        return cls(Proposal(uav, zone, round_, _signed(x), _signed(y), payment, demand, since), signature)

    def digest(self, contract: str, chain_id: int) -> bytes:
        """What its vehicle signed: 32 bytes."""
        return _digest(_message("Proposal", _PROPOSAL, _fields(self.proposal, _PROPOSAL), contract, chain_id))

    def signer(self, contract: str, chain_id: int) -> str | None:
        """The address that signed it for a contract; None where the signature is none."""
        return _recovered(self.digest(contract, chain_id), self.signature)


@dataclass(frozen=True, slots=True)
class Voucher:
    """A registrar's word that an address is one vehicle or UAV.

    Attributes:
        kind: `UAV` or `VEHICLE`.
        expires: until when it can be handed in [s].
    """

    member: str
    kind: int
    expires: int
    signature: bytes = b""


@dataclass(frozen=True, slots=True)
class Receipt:
    """What a vehicle owes a UAV so far for one period of a zone.

    Attributes:
        amount: in the token's unit.
    """

    vehicle: str
    uav: str
    zone: int
    period: int
    amount: int

    def digest(self, payments: str, chain_id: int) -> bytes:
        """What its two parties sign for one contract of payments: 32 bytes."""
        return _digest(self.message(payments, chain_id))

    def message(self, payments: str, chain_id: int) -> SignableMessage:
        """The same, to be signed."""
        return _message("Receipt", _RECEIPT, _fields(self, _RECEIPT), payments, chain_id, "SkyRelayPayments")

    def signer(self, signature: bytes, payments: str, chain_id: int) -> str | None:
        """Who has signed it; None where the bytes are no signature."""
        return _recovered(self.digest(payments, chain_id), signature)


def compact(signature: bytes) -> tuple[bytes, bytes]:
    """r, and s with the parity of v in its first bit (EIP-2098), of a signature of 65 bytes: r, s, v."""
    r, s, v = signature[:32], signature[32:64], signature[64]
    return r, (int.from_bytes(s, "big") | (v - 27) << 255).to_bytes(32, "big")


def expanded(r: bytes, vs: bytes) -> bytes:
    """The signature of 65 bytes; the inverse of `compact`."""
    s = int.from_bytes(vs, "big")
    return r + (s & ((1 << 255) - 1)).to_bytes(32, "big") + bytes([27 + (s >> 255)])


def sign_proposal(keyring: Keyring, vehicle: str, proposal: Proposal, contract: str, chain_id: int) -> SignedProposal:
    """Sign as a vehicle of this host, for one contract on one chain."""
    message = _message("Proposal", _PROPOSAL, _fields(proposal, _PROPOSAL), contract, chain_id)
    return SignedProposal(proposal, keyring.sign_message(vehicle, message))


def sign_voucher(keyring: Keyring, registrar: str, voucher: Voucher, contract: str, chain_id: int) -> Voucher:
    """The voucher with its registrar's signature, for one contract on one chain."""
    message = _message("Voucher", _VOUCHER, _fields(voucher, _VOUCHER), contract, chain_id)
    return replace(voucher, signature=keyring.sign_message(registrar, message))


def sign_acknowledgement(
    keyring: Keyring, relayer: str, proposal: SignedProposal, deadline: int, contract: str, chain_id: int
) -> bytes:
    """A relayer's signature of a proposal and the number of the last block that it may come in."""
    return keyring.sign_message(relayer, _acknowledgement(proposal, deadline, contract, chain_id))


def acknowledgement_signer(
    proposal: SignedProposal, deadline: int, signature: bytes, contract: str, chain_id: int
) -> str | None:
    """Who signed that; None where the signature is none."""
    return _recovered(_digest(_acknowledgement(proposal, deadline, contract, chain_id)), signature)


def _acknowledgement(proposal: SignedProposal, deadline: int, contract: str, chain_id: int) -> SignableMessage:
    # With the signature: two vehicles can have signed the same words.
    named = keccak(proposal.digest(contract, chain_id) + proposal.signature)
    values = {"proposal": named, "deadline": deadline}
    return _message("Acknowledgement", _ACKNOWLEDGEMENT, values, contract, chain_id)


def _digest(message: SignableMessage) -> bytes:
    return keccak(b"\x19" + message.version + message.header + message.body)


def _recovered(digest: bytes, signature: bytes) -> str | None:
    """Who signed a digest; None where the bytes are no signature with a v of 27 or 28."""
    if len(signature) != 65 or signature[64] not in (27, 28):
        return None
    return recovered(digest, signature[:64] + bytes([signature[64] - 27]))


def _fields(source: Proposal | Voucher | Receipt, types: tuple[tuple[str, str], ...]) -> dict[str, Any]:
    return {name: getattr(source, name) for name, _ in types}


def _message(
    name: str,
    types: tuple[tuple[str, str], ...],
    values: Mapping[str, Any],
    contract: str,
    chain_id: int,
    of: str = "SkyRelay",
) -> SignableMessage:
    domain = {"name": of, "version": "1", "chainId": chain_id, "verifyingContract": contract}
    fields = {name: [{"name": field, "type": kind} for field, kind in types]}
    return encode_typed_data(domain, fields, dict(values))


def _signed(word: int) -> int:
    """An int32 of 32 bits."""
    return word - (1 << 32) if word >> 31 else word
