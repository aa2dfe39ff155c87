"""Beacons as bytes: packed, signed, and let in only from members that the chain knows. No input, no output.

A member's own key signs a certificate once: "until then, this session key speaks for me on this contract". The
session key signs the beacons, so that the process with the radio need not hold the key that moves the member on the
chain. The certificate travels with every beacon: who starts late or has lost messages needs nothing else to check one.

Layout, big-endian: version, flags, sender, zone, sequence number, time, speed, battery, what it asks for, [position],
[to], then the certificate (session address, issued, expires, signature) and the session key's signature of all that
stands before it.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable, Container
from dataclasses import dataclass
from enum import Enum

from skyrelay.chain.accounts import SigningKey, signer
from skyrelay.protocol.messages import Beacon

VERSION = 2
_HAS_POSITION, _HAS_TO = 1, 2
_HEAD = struct.Struct(">BB20sHIdfff")
_POSITION = struct.Struct(">dd")
_ADDRESS = 20
_CERTIFICATE = struct.Struct(">20sdd")
_SIGNATURE = 65
_TAIL = _CERTIFICATE.size + 2 * _SIGNATURE

LONGEST = _HEAD.size + _POSITION.size + _ADDRESS + _TAIL
"""Bytes of the longest beacon."""
FARTHEST = 1e7
"""Largest coordinate [m]: no area is a quarter of the Earth's circumference away from its origin."""
FASTEST = 1e3
"""Largest speed [m/s]."""
SKEW = 1.0
"""A sender's clock may be so far ahead of the receiver's [s]."""
MOST = 2.0**31
"""Asked for [kbit/s]: more than a scenario takes."""


class Dropped(Enum):
    """Why a beacon was not let in."""

    MALFORMED = "malformed"
    UNKNOWN = "unknown"
    FOREIGN = "foreign"
    STALE = "stale"
    EARLY = "early"
    REPLAYED = "replayed"
    EXPIRED = "expired"
    FORGED = "forged"


@dataclass(frozen=True, slots=True)
class Certificate:
    """A member's word for a session key.

    Attributes:
        key: the session key's address.
        issued, expires: [s], on the clock of the beacons.
        signature: [65] by the member.
    """

    key: str
    issued: float
    expires: float
    signature: bytes


@dataclass(frozen=True, slots=True)
class SealedBeacon:
    """A beacon as it came: taken apart, not yet believed.

    Attributes:
        sequence: counts a session's beacons.
        signed: the bytes that `signature` is of.
    """

    beacon: Beacon
    sequence: int
    certificate: Certificate
    signed: bytes
    signature: bytes


class Session:
    """Seals one member's beacons.

    Args:
        member: its address.
        contract: address and chain id of the contract that knows the member: a beacon counts nowhere else.
        vouch: the member's signature of a message (`Keyring.vouch`); is asked once.
        now: [s]; a later session of the member must begin later.
        lifetime: the certificate's [s].
    """

    def __init__(
        self, member: str, contract: tuple[str, int], vouch: Callable[[bytes], bytes], now: float, lifetime: float
    ) -> None:
        self.member = member
        self._key = SigningKey()
        self._domain = _domain(contract)
        issued, expires = now, now + lifetime
        signature = vouch(_certified(self._domain, member, self._key.address, issued, expires))
        self.certificate = Certificate(self._key.address, issued, expires, signature)
        self._sequence = 0

    def seal(self, beacon: Beacon) -> bytes:
        """The beacon's bytes, with the next sequence number.

        Raises:
            ValueError: the beacon is another member's, or a number of it fits no beacon.
        """
        if beacon.sender != self.member:
            raise ValueError(f"beacon of {beacon.sender} in the session of {self.member}")
        if not _plausible(beacon):
            raise ValueError(f"{beacon}: expected finite numbers within a beacon's bounds")
        self._sequence += 1
        flags = (_HAS_POSITION if beacon.position else 0) | (_HAS_TO if beacon.to else 0)
        certificate = self.certificate
        parts = [
            _HEAD.pack(
                VERSION,
                flags,
                _bytes(beacon.sender),
                beacon.zone,
                self._sequence,
                beacon.time,
                beacon.speed,
                beacon.battery,
                beacon.asks,
            ),
            _POSITION.pack(*beacon.position) if beacon.position else b"",
            _bytes(beacon.to) if beacon.to else b"",
            _CERTIFICATE.pack(_bytes(certificate.key), certificate.issued, certificate.expires),
            certificate.signature,
        ]
        signed = b"".join(parts)
        return signed + self._key.sign(self._domain + signed)


class BeaconGate:
    """Lets in beacons that are fresh, new, and signed for a member that the chain knows; counts the others.

    Cheap questions come first: no signature is worked out for a sender that the chain does not know.

    Args:
        contract: as in `Session`.
        uavs, vehicles: addresses that the chain knows as such; they may grow and shrink.
        zones: that are listened to.
        patience: beyond this age a beacon is stale [s].
        skew: how far the sender's clock may be ahead of the receiver's [s].

    Attributes:
        admitted: how many were let in.
        dropped: how many were not, by reason.
    """

    def __init__(
        self,
        contract: tuple[str, int],
        uavs: Container[str],
        vehicles: Container[str],
        zones: Container[int],
        *,
        patience: float,
        skew: float = SKEW,
    ) -> None:
        self.admitted = 0
        self.dropped: Counter[Dropped] = Counter()
        self._domain = _domain(contract)
        self._uavs, self._vehicles, self._zones = uavs, vehicles, zones
        self._patience, self._skew = patience, skew
        self._certificates: dict[str, Certificate] = {}  # the last one of each member that was found true
        self._last: dict[str, tuple[float, int]] = {}  # when its session began, and its last sequence number

    def admit(self, raw: bytes, now: float, *, remember: bool = True) -> Beacon | None:
        """The beacon, or None where it is dropped; never raises, whatever the bytes.

        Args:
            now: [s], on the clock of the beacons.
            remember: that older ones of its sender are replays from now on; not where the sender's clock may be false,
                or its true beacons would be dropped once it is right.
        """
        sealed = parse(raw)
        reason = Dropped.MALFORMED if sealed is None else self._fault(sealed, now)
        if sealed is None or reason is not None:
            self.dropped[reason or Dropped.MALFORMED] += 1
            return None
        beacon, certificate = sealed.beacon, sealed.certificate
        self._certificates[beacon.sender] = certificate
        if remember:
            self._last[beacon.sender] = (certificate.issued, sealed.sequence)
        self.admitted += 1
        return beacon

    def dropped_by_reason(self) -> dict[str, int]:
        """How many were dropped for each reason there is; may be asked from any thread."""
        return {reason.value: self.dropped[reason] for reason in Dropped}

    def _fault(self, sealed: SealedBeacon, now: float) -> Dropped | None:
        beacon, certificate = sealed.beacon, sealed.certificate
        if beacon.sender not in (self._uavs if beacon.to is None and not beacon.asks else self._vehicles):
            return Dropped.UNKNOWN
        if beacon.zone not in self._zones:
            return Dropped.FOREIGN
        if now - beacon.time > self._patience:
            return Dropped.STALE
        if beacon.time - now > self._skew:
            return Dropped.EARLY
        if (certificate.issued, sealed.sequence) <= self._last.get(beacon.sender, (-math.inf, 0)):
            return Dropped.REPLAYED
        if not certificate.issued - self._skew <= beacon.time <= certificate.expires:
            return Dropped.EXPIRED
        if certificate != self._certificates.get(beacon.sender) and not self._is_true(certificate, beacon.sender):
            return Dropped.FORGED
        if signer(self._domain + sealed.signed, sealed.signature) != certificate.key:
            return Dropped.FORGED
        return None

    def _is_true(self, certificate: Certificate, member: str) -> bool:
        message = _certified(self._domain, member, certificate.key, certificate.issued, certificate.expires)
        return signer(message, certificate.signature) == member


def parse(raw: bytes) -> SealedBeacon | None:
    """Take bytes apart; None where they are no beacon."""
    if not _HEAD.size + _TAIL <= len(raw) <= LONGEST:
        return None
    version, flags, sender, zone, sequence, time, speed, battery, asks = _HEAD.unpack_from(raw)
    if version != VERSION or flags & ~(_HAS_POSITION | _HAS_TO):
        return None
    place = _HEAD.size
    position: tuple[float, float] | None = None
    to: str | None = None
    length = place + (_POSITION.size if flags & _HAS_POSITION else 0) + (_ADDRESS if flags & _HAS_TO else 0) + _TAIL
    if len(raw) != length:
        return None
    if flags & _HAS_POSITION:
        x, y = _POSITION.unpack_from(raw, place)
        position = (x, y)
        place += _POSITION.size
    if flags & _HAS_TO:
        to = _text(raw[place : place + _ADDRESS])
        place += _ADDRESS
    key, issued, expires = _CERTIFICATE.unpack_from(raw, place)
    place += _CERTIFICATE.size
    beacon = Beacon(_text(sender), zone, to, position, time, speed, battery, asks)
    if not (_plausible(beacon) and math.isfinite(issued) and math.isfinite(expires)):
        return None
    certificate = Certificate(_text(key), issued, expires, raw[place : place + _SIGNATURE])
    return SealedBeacon(beacon, sequence, certificate, raw[:-_SIGNATURE], raw[-_SIGNATURE:])


def _plausible(beacon: Beacon) -> bool:
    """Its numbers are finite and within bounds; a comparison with NaN is false."""
    x, y = beacon.position or (0.0, 0.0)
    return (
        abs(x) <= FARTHEST
        and abs(y) <= FARTHEST
        and math.isfinite(beacon.time)
        and 0 <= beacon.zone < 1 << 16
        and 0.0 <= beacon.speed <= FASTEST
        and 0.0 <= beacon.battery <= 100.0
        and 0.0 <= beacon.asks <= MOST
    )


def _domain(contract: tuple[str, int]) -> bytes:
    """Stands before all that is signed: a signature for one contract is none for another."""
    address, chain_id = contract
    return b"skyrelay beacon" + _bytes(address) + chain_id.to_bytes(8, "big")


def _certified(domain: bytes, member: str, key: str, issued: float, expires: float) -> bytes:
    """What a member signs: longer than any beacon's prefix could be mistaken for, by its first word."""
    return b"certificate " + domain + _bytes(member) + _CERTIFICATE.pack(_bytes(key), issued, expires)


def _bytes(address: str) -> bytes:
    return bytes.fromhex(address[2:])


def _text(address: bytes) -> str:
    return "0x" + address.hex()
