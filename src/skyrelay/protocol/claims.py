"""The coordinator's book of claims: what vehicles have signed, what Algorithm 2 makes of it, and the claim of that.

Agents hear of it what they would hear of the contract, had it decided itself: the same events, though in no log.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from skyrelay.chain.abi import Event
from skyrelay.chain.chain import Call
from skyrelay.chain.claims import IN_NO_LOG, MOST_NEW, MOST_PROPOSALS, MOST_UAVS, ClaimClient, Share
from skyrelay.chain.client import DECIMETRES, UavInfo
from skyrelay.chain.typed_data import SignedProposal
from skyrelay.core.errors import ChainError, SelectionError
from skyrelay.selection.fixed_point import (
    DISTANCE_SCALE,
    FixedParameters,
    allocate_fixed,
    distance_fixed,
    fixed_weights,
    qov_fixed,
    score_fixed,
)


@dataclass
class _List:
    """A UAV's proposals of a period, by place: vehicle, score, demand; which are held; which are new."""

    vehicles: list[str] = field(default_factory=list)
    scored: list[tuple[int, int]] = field(default_factory=list)
    held: set[int] = field(default_factory=set)
    new: list[SignedProposal] = field(default_factory=list)


@dataclass
class _Zone:
    """A zone's period: the UAVs' lists, and where in them each vehicle stands."""

    period: int
    as_of: int
    uavs: dict[str, _List] = field(default_factory=dict)
    places: dict[str, list[tuple[str, int]]] = field(default_factory=dict)

    def binds(self, vehicle: str, uav: str) -> bool:
        """Whether a vehicle may not ask a UAV: it has asked that one, is held by one, or waits to be decided."""
        for other, place in self.places.get(vehicle, ()):
            entry = self.uavs[other]
            if other == uav or place in entry.held or place >= len(entry.vehicles) - len(entry.new):
                return True
        return False


class ClaimBook:
    """Of one coordinator's zones.

    Args:
        claims: the contract that takes them.
        proven: whether it is to check everything at once, which it does for one round a period.
    """

    def __init__(self, claims: ClaimClient, *, proven: bool = False) -> None:
        self._claims, self._client, self._proven = claims, claims.client, proven
        settings = self._client.settings
        self._rules = FixedParameters(
            fixed_weights(settings.qov_weights),
            settings.max_demand,
            settings.max_payment,
            round(settings.max_distance * DECIMETRES),
        )
        self._zones: dict[int, _Zone] = {}

    def take(self, signed: Sequence[SignedProposal]) -> list[Event]:
        """Enter what vehicles have signed for the present round of their zones.

        Returns: VehSelectionSubmitted of each that is taken, zone by zone and UAV by UAV, as the claims will have them.
        """
        address, chain_id = self._client.address, self._client.chain.chain_id
        named = [(one.signer(address, chain_id), one) for one in signed]
        known = [(vehicle, one) for vehicle, one in named if vehicle is not None]
        infos = self._uavs(sorted({one.proposal.uav for _, one in known}))
        events = []
        for zone in sorted({one.proposal.zone for _, one in known}):
            book = self._zone(zone)
            here = [(vehicle, one) for vehicle, one in known if one.proposal.zone == zone]
            reputations = self._client.reputations_at([vehicle for vehicle, _ in here], book.as_of)
            rated = sorted(zip(here, reputations, strict=True), key=lambda entry: entry[0][1].proposal.uav)
            for (vehicle, one), reputation in rated:
                event = self._enter(book, vehicle, one, reputation, infos[one.proposal.uav])
                events += [] if event is None else [event]
        return events

    def call(self, sender: str, zone: int) -> Call:
        """The claim of a zone's round.

        Raises:
            ChainError: it has more proposals or UAVs than a claim takes.
        """
        book = self._zones[zone]
        deciding = {uav: entry for uav, entry in sorted(book.uavs.items()) if entry.new}
        most = max(len(entry.new) for entry in deciding.values())
        if most > MOST_NEW or len(deciding) > MOST_UAVS:
            found = f"{most} proposals to one of {len(deciding)} UAVs in a round"
            limits = f"at most {MOST_NEW} and {MOST_UAVS} of an optimistic allocation"
            raise ChainError(f"zone {zone}", found, limits)
        shares = []
        for uav, info in self._uavs(deciding).items():
            entry = deciding[uav]
            before = len(entry.held)
            self._decide(entry, info)
            shares.append(Share(uav, sum(1 << place for place in entry.held), before, tuple(entry.new)))
        round_ = next(iter(deciding.values())).new[0].proposal.round
        if self._proven:
            return self._claims.prove(sender, zone, round_, shares)
        return self._claims.claim(sender, zone, round_, book.as_of, shares)

    def decided(self, zone: int, at: Event) -> list[Event]:
        """UAVAllocated of each UAV in the claim that an event ZoneAllocated tells of; they are not new any more."""
        events = []
        for uav, entry in sorted(self._zones[zone].uavs.items()):
            if not entry.new:
                continue
            entry.new = []
            taken = sorted(entry.held, key=lambda place: (-entry.scored[place][0], place))
            args = {
                "uav": uav,
                "zone": zone,
                "round": at.args["round"],
                "session": 0,
                "decided": len(entry.vehicles),
                "committed": sum(entry.scored[place][1] for place in taken),
                "selected": [entry.vehicles[place] for place in taken],
            }
            events.append(Event("UAVAllocated", args, at.block, at.transaction, IN_NO_LOG))
        return events

    def _zone(self, zone: int) -> _Zone:
        """The zone's book of its present period."""
        info = self._client.zone_info(zone)
        if info is None:
            raise ChainError(f"zone {zone}", None, "a zone that a UAV has entered")
        if zone not in self._zones or self._zones[zone].period != info.period:
            self._zones[zone] = _Zone(info.period, self._client.chain.block_number)
        return self._zones[zone]

    def _uavs(self, addresses: Iterable[str]) -> dict[str, UavInfo]:
        wanted = list(addresses)
        return dict(zip(wanted, self._client.uav_infos(wanted), strict=True))

    def _enter(self, book: _Zone, vehicle: str, signed: SignedProposal, reputation: int, info: UavInfo) -> Event | None:
        """Enter one proposal; None where a claim with it would be wrong."""
        told, entry = signed.proposal, book.uavs.setdefault(signed.proposal.uav, _List())
        x, y = round(info.x * DECIMETRES), round(info.y * DECIMETRES)
        distance = distance_fixed(told.x - x, told.y - y)
        far = self._client.settings.range_gate and distance > self._rules.max_distance * DISTANCE_SCALE
        if (
            book.binds(vehicle, told.uav)
            or far
            or info.zone != told.zone
            or told.since
            or len(entry.vehicles) == MOST_PROPOSALS
        ):
            return None
        try:
            qov = qov_fixed(self._rules, told.demand, told.payment, reputation, distance)
        except SelectionError:
            return None
        score = score_fixed(qov, told.demand)
        args = {
            "vehicle": vehicle,
            "uav": told.uav,
            "zone": told.zone,
            "x": told.x,
            "y": told.y,
            "payment": told.payment,
            "demand": told.demand,
            "uavX": x,
            "uavY": y,
            "reputation": reputation,
            "qov": qov,
            "score": score,
            "session": 0,
            "index": len(entry.vehicles),
            "round": told.round,
        }
        book.places.setdefault(vehicle, []).append((told.uav, len(entry.vehicles)))
        entry.vehicles.append(vehicle)
        entry.scored.append((score, told.demand))
        entry.new.append(signed)
        return Event("VehSelectionSubmitted", args, self._client.chain.block_number, 0, IN_NO_LOG)

    def _decide(self, entry: _List, info: UavInfo) -> None:
        first = len(entry.vehicles) - len(entry.new)
        open_ = [place for place in range(len(entry.vehicles)) if place >= first or place in entry.held]
        taken = allocate_fixed(info.bandwidth, [entry.scored[place] for place in open_])
        entry.held = {open_[number] for number in taken}
