"""What claims decide in a zone's period, worked out again from their transactions and compared.

A claim stands for the events that the contract would have emitted, had it decided itself: these are what the rest of an
audit reads of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from skyrelay.chain.abi import Event
from skyrelay.chain.claims import IN_NO_LOG, MOST_PROPOSALS, Claim, Share
from skyrelay.chain.typed_data import SignedProposal
from skyrelay.core.errors import SelectionError
from skyrelay.selection.fixed_point import (
    DISTANCE_SCALE,
    FixedParameters,
    allocate_fixed,
    distance_fixed,
    qov_fixed,
    score_fixed,
)


class Rated(Protocol):
    """A vehicle, whose reputation was another before a block."""

    reputation: int
    past: tuple[int, int]
    suspended: bool
    suspended_in: int


class Offering(Protocol):
    """A UAV as it was when it was claimed of."""

    x: int
    y: int
    bandwidth: int
    zone: int
    battery: int
    suspended: bool


@dataclass
class ClaimedUav:
    """A UAV's proposals by place, and the places of those that it serves."""

    vehicles: list[str] = field(default_factory=list)
    scored: list[tuple[int, int]] = field(default_factory=list)
    held: set[int] = field(default_factory=set)


@dataclass
class ClaimedZone:
    """The claims of a zone's period.

    Attributes:
        as_of: the block whose reputations they go by.
        claimant: who made them.
        uavs: that have a share.
        bids: the round of each vehicle's latest proposal.
        served: the vehicles that UAVs served before the round that is followed.
    """

    as_of: int
    claimant: str
    uavs: dict[str, ClaimedUav] = field(default_factory=dict)
    bids: dict[str, int] = field(default_factory=dict)
    served: set[str] = field(default_factory=set)

    @property
    def selected(self) -> list[int]:
        """How many vehicles each UAV serves that serves any."""
        return [len(uav.held) for uav in self.uavs.values() if uav.held]


@dataclass(frozen=True)
class ClaimCheck:
    """Compares claims with what the reference contract knows.

    Args:
        address, chain_id: of SkyRelay, for which vehicles sign.
        fixed, rules: its parameters.
        uav_of, vehicle_of: its members by address; None of one that is none.
        expect: is told what, what was found and what it should be.
    """

    address: str
    chain_id: int
    fixed: FixedParameters
    rules: Mapping[str, Any]
    uav_of: Callable[[str], Offering | None]
    vehicle_of: Callable[[str], Rated | None]
    expect: Callable[[str, object, object], None]

    def follow(self, claim: Claim, zone: ClaimedZone, at: Event) -> list[Event]:
        """Check a claim and enter it; the events that it stands for."""
        self.expect("claims of the period as of block", claim.as_of, zone.as_of)
        self.expect("claims of the period by", claim.sender, zone.claimant)
        zone.served = {uav.vehicles[place] for uav in zone.uavs.values() for place in uav.held}
        told: list[Event] = []
        before = ""
        for share in claim.shares:
            uav = self.uav_of(share.uav)
            self.expect(f"UAV {share.uav} with power in zone", _zone_of(uav), claim.zone)
            self.expect(f"shares before {share.uav}", int(share.uav <= before), 0)
            before = share.uav
            if uav is not None:
                told += self._follow_share(claim, zone, share, uav, at)
        return told

    def _follow_share(self, claim: Claim, zone: ClaimedZone, share: Share, uav: Offering, at: Event) -> list[Event]:
        entry = zone.uavs.setdefault(share.uav, ClaimedUav())
        self.expect(f"served by {share.uav} before", share.before, len(entry.held))
        first = len(entry.vehicles)
        told = [self._enter(claim, zone, entry, signed, uav, at) for signed in share.proposals]
        count = len(entry.vehicles)
        self.expect(f"proposals to {share.uav} above {MOST_PROPOSALS}", max(count - MOST_PROPOSALS, 0), 0)
        open_ = [place for place in range(count) if place >= first or place in entry.held]
        taken = [open_[i] for i in allocate_fixed(uav.bandwidth, [entry.scored[place] for place in open_])]
        claimed = {place for place in range(share.selected.bit_length()) if share.selected >> place & 1}
        self.expect(f"selected by {share.uav}", sorted(claimed), sorted(taken))
        # From here on what is claimed counts, until it is proved wrong on the chain.
        entry.held = {place for place in claimed if place < count}
        order = [*(place for place in taken if place in entry.held), *sorted(entry.held - set(taken))]
        args = {
            "uav": share.uav,
            "zone": claim.zone,
            "round": claim.round,
            "session": 0,
            "decided": count,
            "committed": sum(entry.scored[place][1] for place in order),
            "selected": [entry.vehicles[place] for place in order],
        }
        return [*told, Event("UAVAllocated", args, at.block, at.transaction, IN_NO_LOG)]

    def _enter(
        self,
        claim: Claim,
        zone: ClaimedZone,
        entry: ClaimedUav,
        signed: SignedProposal,
        uav: Offering,
        at: Event,
    ) -> Event:
        told, place = signed.proposal, len(entry.vehicles)
        name = signed.signer(self.address, self.chain_id) or "nobody"
        vehicle = self.vehicle_of(name)
        self.expect(f"signature {place} to {told.uav} of a vehicle", vehicle is not None, True)
        self._expect_free(claim, zone, entry, name)
        reputation = 0
        if vehicle is not None:
            block, past = vehicle.past
            reputation = past if block > claim.as_of else vehicle.reputation
            self.expect(f"{name} suspended", vehicle.suspended and vehicle.suspended_in <= claim.as_of, False)
        distance = distance_fixed(told.x - uav.x, told.y - uav.y)
        far = self.rules["rangeGate"] and distance > self.fixed.max_distance * DISTANCE_SCALE
        self.expect(f"{name} beyond the range of {told.uav}", far, False)
        self.expect(f"record that the proposal of {name} replaces", told.since, 0)
        try:
            qov = qov_fixed(self.fixed, told.demand, told.payment, reputation, distance)
        except SelectionError as error:
            self.expect(f"{name}: {error.place}", error.value, error.expected)
            qov = 0
        score = score_fixed(qov, max(told.demand, 1))
        entry.vehicles.append(name)
        entry.scored.append((score, told.demand))
        zone.bids[name] = claim.round
        args = {
            "vehicle": name,
            "uav": told.uav,
            "zone": claim.zone,
            "x": told.x,
            "y": told.y,
            "payment": told.payment,
            "demand": told.demand,
            "uavX": uav.x,
            "uavY": uav.y,
            "reputation": reputation,
            "qov": qov,
            "score": score,
            "session": 0,
            "index": place,
            "round": claim.round,
        }
        return Event("VehSelectionSubmitted", args, at.block, at.transaction, IN_NO_LOG)

    def _expect_free(self, claim: Claim, zone: ClaimedZone, entry: ClaimedUav, name: str) -> None:
        """The vehicle has no other proposal in the round, is not served, and has not asked this UAV in the period."""
        self.expect(f"{name} at this UAV before", entry.vehicles.count(name), 0)
        self.expect(f"{name} served before", name in zone.served, False)
        self.expect(f"proposals of {name} in the round before", int(zone.bids.get(name) == claim.round), 0)


def _zone_of(uav: Offering | None) -> int | None:
    return None if uav is None or uav.battery == 0 or uav.suspended else uav.zone
