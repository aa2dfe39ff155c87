"""The contract in Python, fed by its own events: what each event says is worked out again and compared.

Nothing here runs the EVM or asks the contract. The QoV, the score and Algorithm 2 come from the fixed-point reference
(`skyrelay.selection.fixed_point`), all else from the rules in `contracts/src/interfaces`. One disagreement is named
once: after it the reference goes on from what the chain says.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from eth_abi.abi import encode
from eth_hash.auto import keccak

from skyrelay.chain.abi import Event
from skyrelay.chain.claims import Claim
from skyrelay.chain.proof.claimed import ClaimCheck, ClaimedZone
from skyrelay.chain.proof.replay import Difference
from skyrelay.core.errors import SelectionError
from skyrelay.selection.fixed_point import (
    DISTANCE_SCALE,
    FixedParameters,
    allocate_fixed,
    distance_fixed,
    qov_fixed,
    score_fixed,
)

ADMIN = "0x" + "00" * 32
COORDINATOR = "0x" + keccak(b"COORDINATOR_ROLE").hex()
PUBLISHER = "0x" + keccak(b"PUBLISHER_ROLE").hex()
REPUTATION = "0x" + keccak(b"REPUTATION_ROLE").hex()
REGISTRAR = "0x" + keccak(b"REGISTRAR_ROLE").hex()
SETTLER = "0x" + keccak(b"SETTLER_ROLE").hex()
_ROLES = {
    ADMIN: "administrator",
    COORDINATOR: "coordinator",
    PUBLISHER: "publisher",
    REPUTATION: "reputation authority",
    REGISTRAR: "registrar",
    SETTLER: "contract that takes claims",
}

_UAV, _VEHICLE = 1, 2
_NOBODY = "0x" + "00" * 20
_MAX_PROPOSALS = 1024
_MAX_PLACES = 65_535
_MAX_MODELS = 64
_MAX_SCORE = 2**31 - 1
_CARD_TYPE = "(uint16,uint16,uint16,uint16,uint16,uint8,uint8,int32)"


@dataclass
class _Proposal:
    vehicle: str
    demand: int
    score: int


@dataclass
class _Session:
    """A UAV's proposals and selections in one period of one zone; zone 0 before its first proposal.

    Attributes:
        proposals: by place; the first ``decided`` have been through an allocation.
        selected: places of those that the UAV serves.
        given_up: places of those that were selected and gave it up.
        closed: the one before was voided in this period, which takes no more proposals.
    """

    number: int
    zone: int = 0
    period: int = 0
    proposals: list[_Proposal] = field(default_factory=list)
    decided: int = 0
    selected: set[int] = field(default_factory=set)
    given_up: set[int] = field(default_factory=set)
    served: bool = False
    closed: bool = False

    @property
    def committed(self) -> int:
        return sum(self.proposals[i].demand for i in self.selected)


@dataclass
class _Uav:
    index: int
    x: int
    y: int
    battery: int
    bandwidth: int
    reputation: int
    written: int
    zone: int = 0
    suspended: bool = False
    past: tuple[int, int] = (0, 0)
    """The block in which the reputation last changed, and what it was before."""
    suspended_in: int = 0
    """The block of the last suspension or its end."""
    session: _Session = field(default_factory=lambda: _Session(1))
    finished: _Session | None = None
    """The last one that served somebody, before the session."""


@dataclass
class _Vehicle:
    x: int
    y: int
    payment: int
    zone: int
    reputation: int
    suspended: bool = False
    past: tuple[int, int] = (0, 0)
    suspended_in: int = 0
    proposal: tuple[str, int, int] | None = None
    """UAV, session and index of the latest one."""


@dataclass
class _Zone:
    period: int = 1
    round: int = 1
    since: int = 0
    begun: int = 0
    allocating: bool = False
    waiting: bool = False
    has_model: bool = False
    suspended: bool = False
    uavs: set[str] = field(default_factory=set)
    claimed: ClaimedZone | None = None
    """Claims decide the period."""
    wrong: list[Difference] = field(default_factory=list)
    """Of these claims."""


@dataclass
class _Model:
    owner: str
    card: Mapping[str, Any]


class ReferenceContract:
    """Follows a deployed contract event by event.

    Args:
        sender_of: who sent the transaction of an event to the contract; None where another contract called it.
        time_of: the time of a block [s].
        signer_of: who signed the proposal that an event tells of and somebody else handed in; None: nobody did.
        claim_of: the claim in the transaction of an event ZoneAllocated; None where it is none.
        identity: address and chain id of the contract.

    Attributes:
        told: the events, and before the claims' those that they stand for.
        checked: how many of each thing were compared.
        differences: every disagreement.
    """

    def __init__(
        self,
        sender_of: Callable[[Event], str | None],
        time_of: Callable[[int], int],
        signer_of: Callable[[Event], str | None],
        claim_of: Callable[[Event], Claim | None],
        identity: tuple[str, int],
    ) -> None:
        self.told: list[Event] = []
        self._claim_of, self._identity = claim_of, identity
        self.checked: Counter[str] = Counter()
        self.differences: list[Difference] = []
        self._sender_of = sender_of
        self._time_of = time_of
        self._signer_of = signer_of
        self._now = 0
        self._parameters: Mapping[str, Any] | None = None
        self._fixed: FixedParameters | None = None
        self._deployment: tuple[int, int] | None = None
        self._uavs: dict[str, _Uav] = {}
        self._vehicles: dict[str, _Vehicle] = {}
        self._zones: dict[int, _Zone] = {}
        self._coordinators: dict[int, str] = {}
        self._admitted: dict[str, int] = {}
        self._next_admin: tuple[str, int] | None = None
        self._suspending: tuple[str, int, int] | None = None
        self._models: dict[str, _Model] = {}
        self._in_use: list[str] = []
        self._roles: dict[str, set[str]] = {}
        self._place = ""

    def follow(self, events: Iterable[Event]) -> None:
        """Check events, in the chain's order; without the parameters of Deployed before them none can be checked."""
        for event in events:
            self._place = f"block {event.block}, transaction {event.transaction}, log {event.index}: {event.name}"
            if self._fixed is None and event.name != "Deployed":
                self._differs("comes first", "Deployed before it")
                return
            self.checked["events"] += 1
            self._now = self._time_of(event.block)
            self._expect_suspension(event)
            if event.name == "ZoneAllocated" and (claim := self._claim_of(event)) is not None:
                self._follow_claim(event, claim)
            self.told.append(event)
            check = getattr(self, f"_on_{event.name}", None)
            if check is None:
                self._differs("not known to the audit", "an event of this version")
                continue
            try:
                check(event, event.args)
            except (KeyError, IndexError, SelectionError) as error:
                self._differs(f"does not fit what went before ({error!r})", "an event that the contract can emit")

    # What each event must be

    def _on_Deployed(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802  (events keep their names)
        self._expect("deployments", int(self._parameters is not None), 0)
        parameters = args["parameters"]
        a, b, c, d = parameters["qovWeights"]
        self._fixed = FixedParameters(
            (a, b, c, d), parameters["maxDemand"], parameters["maxPayment"], parameters["maxDistance"]
        )
        self._parameters = parameters
        self._deployment = (event.block, event.transaction)

    def _on_UAVRegistered(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        uav = args["uav"]
        self._by(event, uav)
        self._expect("members of this address before", int(self._is_member(uav)), 0)
        self._expect_admitted(uav, _UAV)
        self._expect("index", args["index"], len(self._uavs))
        self._expect("reputation", args["reputation"], self._rules["initialReputation"])
        self._uavs[uav] = _Uav(
            args["index"], args["x"], args["y"], args["battery"], args["bandwidth"], args["reputation"], self._now
        )
        self._within_limits(args)

    def _on_UAVUpdated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["uav"])
        uav = self._uavs[args["uav"]]
        self._within_limits(args)
        if args["battery"] == 0:
            self._expect("proposals of an empty UAV", len(uav.session.proposals), 0)
        elif self._current(uav) and uav.session.proposals:
            self._require(
                "bandwidth", args["bandwidth"], args["bandwidth"] >= uav.bandwidth, "no less than was proposed to"
            )
        uav.x, uav.y, uav.written = args["x"], args["y"], self._now
        uav.battery, uav.bandwidth = args["battery"], args["bandwidth"]

    def _on_UAVZoneUpdated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["uav"])
        uav = self._uavs[args["uav"]]
        self._expect("zone left", args["from"], uav.zone)
        self._expect("proposals of a UAV that moves", len(uav.session.proposals), 0)
        if uav.zone:
            self._zones[uav.zone].uavs.discard(args["uav"])
        uav.zone, uav.written = args["to"], self._now
        if uav.zone:
            self._zones[uav.zone].uavs.add(args["uav"])

    def _on_UAVSubmissionReset(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        uav = self._uavs[args["uav"]]
        sender = self._sender_of(event)
        if sender not in (None, args["uav"]) and not self._is_stale(uav) and not uav.suspended:
            self._by_role(event, REGISTRAR)
            self._suspending = (args["uav"], event.block, event.transaction)
        session = uav.session
        self._require("proposals", 0, bool(session.proposals), "some to void")
        self._expect("session", args["session"], session.number + 1)
        if session.served:
            uav.finished = session
        uav.session = _Session(args["session"], session.zone, session.period, closed=True)
        self.checked["sessions ended"] += 1

    def _on_VehicleRegistered(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        vehicle = args["vehicle"]
        self._by(event, vehicle)
        self._expect("members of this address before", int(self._is_member(vehicle)), 0)
        self._expect("reputation", args["reputation"], self._rules["initialReputation"])
        self._expect_admitted(vehicle, _VEHICLE)
        self._require_at_most("payment", args["payment"], self._rules["maxPayment"])
        self._vehicles[vehicle] = _Vehicle(args["x"], args["y"], args["payment"], args["zone"], args["reputation"])
        self.checked["records"] += 1

    def _on_VehicleUpdated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["vehicle"])
        vehicle = self._vehicles[args["vehicle"]]
        self._require_at_most("payment", args["payment"], self._rules["maxPayment"])
        status = self._status(vehicle)
        self._require("proposal", status, status in ("none", "rejected"), "none or rejected: its terms are frozen")
        vehicle.x, vehicle.y = args["x"], args["y"]
        vehicle.payment, vehicle.zone = args["payment"], args["zone"]
        self.checked["records"] += 1

    def _on_ZoneOpened(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: ARG002, N802
        self._expect("openings of the zone before", int(args["zone"] in self._zones), 0)
        self._zones[args["zone"]] = _Zone(since=self._now, begun=self._now)

    def _on_VehSelectionSubmitted(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        vehicle, uav, zone = self._vehicles[args["vehicle"]], self._uavs[args["uav"]], self._zones[args["zone"]]
        status = self._status(vehicle)
        self._require("vehicle's proposal before", status, status in ("none", "rejected"), "none or rejected")
        self._expect_terms(event, args, vehicle)
        if self._status(vehicle) == "rejected" and vehicle.proposal is not None:
            self._require(
                "UAV", args["uav"], vehicle.proposal[0] != args["uav"], "one that has not rejected the vehicle"
            )
        self._expect("zone of the UAV", uav.zone, args["zone"])
        self._expect("zone of the vehicle", vehicle.zone, args["zone"])
        self._expect("round", args["round"], zone.round)
        self._expect("zone under allocation", zone.allocating, False)
        self._expect("zone decided by claims", zone.claimed is not None, False)
        self._expect("zone suspended", zone.suspended, False)
        self._expect("vehicle or UAV suspended", vehicle.suspended or uav.suspended, False)
        self._require("battery of the UAV", uav.battery, uav.battery > 0, "more than 0")
        self._require("UAV's last report [s]", uav.written, not self._is_stale(uav), f"a newer one at {self._now}")
        assert self._fixed is not None  # noqa: S101  (the parameters came first, or `follow` would have said so)
        self._expect("position of the UAV", (args["uavX"], args["uavY"]), (uav.x, uav.y))
        self._expect("reputation", args["reputation"], vehicle.reputation)
        distance = distance_fixed(vehicle.x - uav.x, vehicle.y - uav.y)
        if self._rules["rangeGate"]:
            farthest = self._fixed.max_distance * DISTANCE_SCALE
            self._require("distance [1e-16 m]", distance, distance <= farthest, f"at most {farthest}")
        qov = qov_fixed(self._fixed, args["demand"], vehicle.payment, vehicle.reputation, distance)
        self._expect("QoV", args["qov"], qov)
        self._expect("score", args["score"], score_fixed(qov, args["demand"]))
        if not self._current(uav):
            if uav.session.proposals:
                if uav.session.served:
                    uav.finished = uav.session
                uav.session = _Session(uav.session.number + 1)
            uav.session.closed = False
            uav.session.zone, uav.session.period = args["zone"], zone.period
        session = uav.session
        self._expect("UAV voided in this period", session.closed, False)
        self._expect("session", args["session"], session.number)
        self._expect("index", args["index"], len(session.proposals))
        self._require_at_most("index", args["index"], _MAX_PLACES - 1)
        self._require_at_most(
            "proposals before", len(session.proposals) - session.decided + len(session.selected), _MAX_PROPOSALS - 1
        )
        session.proposals.append(_Proposal(args["vehicle"], args["demand"], args["score"]))
        vehicle.proposal = (args["uav"], session.number, len(session.proposals) - 1)
        if not zone.waiting:
            zone.waiting, zone.since = True, self._now
        self.checked["proposals"] += 1

    def _expect_terms(self, event: Event, args: Mapping[str, Any], vehicle: _Vehicle) -> None:
        """What a proposal was computed from is the vehicle's record; or its record anew, where it was signed for it."""
        record = (vehicle.x, vehicle.y, vehicle.payment, vehicle.zone)
        terms = (args["x"], args["y"], args["payment"], args["zone"])
        sender = self._sender_of(event)
        if sender == args["vehicle"] and record == terms:
            return
        self._require_at_most("payment", args["payment"], self._rules["maxPayment"])
        vehicle.x, vehicle.y, vehicle.payment, vehicle.zone = terms
        if sender is not None:
            signer = self._signer_of(event)
            self._expect("signature of", signer or "nobody", args["vehicle"])
            self.checked["proposals by signature"] += 1

    def _on_VehSelectionWithdrawn(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        vehicle = self._vehicles[args["vehicle"]]
        if self._sender_of(event) not in (None, args["vehicle"]):
            self._by_role(event, REGISTRAR)
            self._suspending = (args["vehicle"], event.block, event.transaction)
        self._expect("proposal", (args["uav"], args["session"], args["index"]), vehicle.proposal)
        status = self._status(vehicle)
        self._require("proposal", status, status in ("pending", "selected"), "pending or selected")
        session, index = self._uavs[args["uav"]].session, args["index"]
        if index in session.selected:
            session.selected.discard(index)
            session.given_up.add(index)
        else:
            # The last one of the list moves into the place.
            last = session.proposals.pop()
            if index < len(session.proposals):
                session.proposals[index] = last
                self._vehicles[last.vehicle].proposal = (args["uav"], session.number, index)
        vehicle.proposal = None
        self.checked["withdrawals"] += 1

    def _on_UAVAllocated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        uav, zone = self._uavs[args["uav"]], self._zones[args["zone"]]
        self._by_coordinator(event, args["zone"], zone.allocating or (zone.waiting and self._is_overdue(zone)))
        session = uav.session
        self._expect("zone", args["zone"], uav.zone)
        self._expect("round", args["round"], zone.round)
        self._expect("session", args["session"], session.number)
        self._require("session", session.number, self._current(uav), "one of the zone's period")
        self._expect("decided", args["decided"], len(session.proposals))
        self._require("undecided proposals", 0, session.decided < len(session.proposals), "more than 0")
        open_ = [i for i in range(len(session.proposals)) if i >= session.decided or i in session.selected]
        taken = allocate_fixed(
            uav.bandwidth, [(session.proposals[i].score, session.proposals[i].demand) for i in open_]
        )
        vehicles = [session.proposals[open_[i]].vehicle for i in taken]
        self._expect("selected", list(args["selected"]), vehicles)
        session.decided = len(session.proposals)
        # From here on what the chain says counts.
        places = {session.proposals[i].vehicle: i for i in open_}
        session.selected = {places[vehicle] for vehicle in args["selected"]}
        session.served = session.served or bool(session.selected)
        self._expect("committed", args["committed"], session.committed)
        self._require_at_most("committed", args["committed"], uav.bandwidth)
        zone.allocating = True
        self.checked["selections by UAVs"] += 1
        self.checked["vehicles selected"] += len(args["selected"])

    def _on_ZonePieceAllocated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        zone = self._zones[args["zone"]]
        self._by_coordinator(event, args["zone"], zone.allocating or (zone.waiting and self._is_overdue(zone)))
        self._expect("round", args["round"], zone.round)
        self._require_at_most("cursor", args["cursor"], max(len(zone.uavs) - 1, 0))
        zone.allocating = True
        self.checked["pieces of allocations"] += 1

    def _on_ZoneAllocated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        zone = self._zones[args["zone"]]
        self._by_coordinator(event, args["zone"], zone.allocating or (zone.waiting and self._is_overdue(zone)))
        self._expect("period", args["period"], zone.period)
        self._expect("round", args["round"], zone.round)
        for name in sorted(zone.uavs):
            uav = self._uavs[name]
            if self._current(uav):
                self._expect(f"decided proposals of {name}", uav.session.decided, len(uav.session.proposals))
        before = len(self.differences)
        self._expect_selected(args["zone"], args)
        if zone.claimed is not None:
            zone.wrong += self.differences[before:]
        zone.allocating = zone.waiting = False
        zone.round, zone.since = args["round"] + 1, self._now
        self.checked["allocations of zones"] += 1

    def _follow_claim(self, event: Event, claim: Claim) -> None:
        """Check what a zone's coordinator claims of a round, and go on from it."""
        assert self._fixed is not None  # noqa: S101  (as above)
        zone = self._zones[event.args["zone"]]
        self._has_role(claim.contract, SETTLER)
        own = self._coordinators.get(claim.zone, _NOBODY)
        if own == _NOBODY:
            self._has_role(claim.sender, COORDINATOR)
        else:
            self._expect("sender", claim.sender, own)
        self._expect("zone", claim.zone, event.args["zone"])
        self._expect("round", claim.round, zone.round)
        self._expect("zone suspended, or with proposals", zone.suspended or zone.waiting, False)
        if zone.claimed is None:
            zone.claimed = ClaimedZone(claim.as_of, claim.sender)
        check = ClaimCheck(*self._identity, self._fixed, self._rules, self._uavs.get, self._vehicles.get, self._expect)
        before = len(self.differences)
        self.told += check.follow(claim, zone.claimed, event)
        zone.wrong += self.differences[before:]
        self.checked["claims"] += 1
        self.checked["proposals by signature"] += sum(len(share.proposals) for share in claim.shares)

    def _on_ZoneUnsettled(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: ARG002, N802
        """A claim was proved wrong, so that what is wrong with it does no harm any more."""
        zone = self._zones[args["zone"]]
        self._expect("period", args["period"], zone.period)
        self._require("claims", "none", zone.claimed is not None, "some to void")
        self.differences = [one for one in self.differences if one not in zone.wrong]
        zone.claimed, zone.wrong, zone.has_model = None, [], False
        self.checked["claims proved wrong"] += 1

    def _on_ZoneListsReset(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        zone = self._zones[args["zone"]]
        shortest = self._rules["minimumPeriod"]
        due = zone.begun + shortest
        self._by_coordinator(event, args["zone"], shortest > 0 and self._now > due and self._is_overdue(zone))
        self._require("time [s]", self._now, self._now >= due, f"no less than {due}")
        self._expect("zone with undecided proposals", zone.allocating or zone.waiting, False)
        self._expect("period", args["period"], zone.period + 1)
        self._expect("round", args["round"], zone.round + 1)
        zone.period, zone.round, zone.has_model = args["period"], args["round"], False
        zone.claimed, zone.wrong = None, []
        zone.since = zone.begun = self._now
        self.checked["resets of zones"] += 1

    def _on_ModelRegistered(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["owner"])
        self._by_role(event, PUBLISHER)
        cid, card = bytes.fromhex(args["cid"][2:]), args["card"]
        model_id = (
            "0x" + keccak(encode(["address", "bytes", _CARD_TYPE], [args["owner"], cid, tuple(card.values())])).hex()
        )
        self._expect("model id", args["modelId"], model_id)
        self._expect("registrations of the model before", int(args["modelId"] in self._models), 0)
        self._require("CID", args["cid"], len(cid) == 36 and (cid[0], cid[2:4]) == (1, b"\x12\x20"), "CIDv1 of SHA-256")
        ranges = 1 <= card["minUAVs"] <= card["maxUAVs"] and card["minVehicles"] <= card["maxVehicles"]
        self._require("ranges", list(card.values()), ranges, "from a least number to a largest one")
        self._require_at_most("score", card["score"], 0)
        for key in ("channels", "actions"):
            self._expect(key, card[key], self._rules[key])
        if self._rules["observationSide"]:
            self._expect("observation side", card["observationSide"], self._rules["observationSide"])
        self._models[args["modelId"]] = _Model(args["owner"], card)
        self._in_use.append(args["modelId"])
        self._require_at_most("models in use", len(self._in_use), _MAX_MODELS)
        self.checked["models"] += 1

    def _on_ModelRetired(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        if self._sender_of(event) != self._models[args["modelId"]].owner:
            self._by_role(event, ADMIN)
        self._require("model", args["modelId"], args["modelId"] in self._in_use, "one that is in use")
        self._in_use.remove(args["modelId"])
        self.checked["models retired"] += 1

    def _on_ModelAssigned(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        zone = self._zones[args["zone"]]
        late = not zone.has_model and not zone.waiting and self._is_overdue(zone)
        self._by_coordinator(event, args["zone"], late)
        self._expect("round", args["round"], zone.round)
        self._expect("zone under allocation", zone.allocating, False)
        uavs, vehicles = self._expect_selected(args["zone"], args)
        self._require("selected UAVs", uavs, uavs > 0, "more than 0")

        def rank(model_id: str) -> tuple[int, int, int]:
            card = self._models[model_id].card
            return (
                _outside(uavs, card["minUAVs"], card["maxUAVs"]),
                _outside(vehicles, card["minVehicles"], card["maxVehicles"]),
                _MAX_SCORE - card["score"],
            )

        # `min` takes the first of equals, as the contract does.
        best = min(self._in_use, key=rank) if self._in_use else "none"
        self._expect("model", args["modelId"], best)
        zone.has_model = True
        self.checked["model assignments"] += 1

    def _on_ReputationSet(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by_role(event, REPUTATION)
        self._require_at_most("reputation", args["reputation"], 10_000)
        self._note_reputation(event, self._member(args["member"]), args["reputation"])
        self.checked["reputations"] += 1

    def _on_MemberRated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["by"])
        member = self._member(args["member"])
        self._expect_match(args["member"], args["by"])
        step = self._rules["ratingStep"]
        self._require("rating", "given", step > 0, "none, ratings are off")
        moved = min(member.reputation + step, 10_000) if args["good"] else max(member.reputation - step, 0)
        self._expect("reputation", args["reputation"], moved)
        self._note_reputation(event, member, args["reputation"])
        self.checked["ratings"] += 1

    def _note_reputation(self, event: Event, member: _Uav | _Vehicle, reputation: int) -> None:
        settling = self._rules["settling"]
        early = settling > 0 and member.past[0] > 0 and event.block <= member.past[0] + settling
        self._expect("reputation changed too soon again", early, False)
        member.past, member.reputation = (event.block, member.reputation), reputation

    def _on_MemberAdmitted(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: ARG002, N802
        self._expect("admission", self._rules["admission"], True)
        self._has_role(args["registrar"], REGISTRAR)
        self._require("kind", args["kind"], args["kind"] in (_UAV, _VEHICLE), f"{_UAV} or {_VEHICLE}")
        member = args["member"]
        self._expect("admitted before", self._is_member(member) or member in self._admitted, False)
        self._admitted[member] = args["kind"]
        self.checked["admissions"] += 1

    def _on_MemberSuspended(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by_role(event, REGISTRAR)
        member = self._member(args["member"])
        if isinstance(member, _Uav):
            self._expect("proposals of a suspended UAV", len(member.session.proposals), 0)
        else:
            status = self._status(member)
            self._require("proposal", status, status in ("none", "rejected"), "withdrawn before")
        member.suspended, member.suspended_in = args["suspended"], event.block
        self.checked["suspensions"] += 1

    def _on_ZoneSuspended(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by_role(event, REGISTRAR)
        self._zones[args["zone"]].suspended = args["suspended"]
        self.checked["suspensions"] += 1

    def _on_ZoneCoordinatorSet(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by_role(event, ADMIN)
        self._coordinators[args["zone"]] = args["coordinator"]
        self.checked["role changes"] += 1

    def _on_RoleGranted(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        # The deployer is made administrator by the constructor; every other grant is an administrator's.
        if (event.block, event.transaction) != self._deployment:
            if args["role"] == ADMIN:
                self._expect_admin_change(args["account"], args["sender"])
                self._next_admin = None
            else:
                self._has_role(args["sender"], ADMIN)
        self._require("role", args["role"], args["role"] in _ROLES, "one of the contract's")
        self._require(
            "account", args["account"], not self._holds(args["account"], args["role"]), "one without the role"
        )
        self._roles.setdefault(args["role"], set()).add(args["account"])
        self.checked["role changes"] += 1

    def _on_RoleRevoked(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: ARG002, N802
        if args["role"] == ADMIN:
            # The administrator goes when its successor accepts; or renounces, having announced that nobody follows.
            renounced = args["sender"] == args["account"]
            self._expect_admin_change(_NOBODY if renounced else args["sender"], args["sender"])
        elif args["sender"] != args["account"]:
            self._has_role(args["sender"], ADMIN)
        self._has_role(args["account"], args["role"])
        self._roles.get(args["role"], set()).discard(args["account"])
        self.checked["role changes"] += 1

    def _on_DefaultAdminTransferScheduled(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by_role(event, ADMIN)
        self._expect("schedule", args["acceptSchedule"], self._now + self._rules["adminDelay"])
        self._next_admin = (args["newAdmin"], args["acceptSchedule"])
        self.checked["role changes"] += 1

    def _on_DefaultAdminTransferCanceled(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: ARG002, N802
        self._by_role(event, ADMIN)
        self._require("change of the administrator", "canceled", self._next_admin is not None, "one that was scheduled")
        self._next_admin = None

    def _expect_admin_change(self, successor: str, sender: str) -> None:
        """A change of the administrator was announced, its time has come, and the successor itself makes it."""
        announced = self._next_admin
        ready = announced is not None and announced[0] == successor and self._now > announced[1]
        self._require("administrator", successor, ready, "one that was announced the delay before")
        if successor != _NOBODY:
            self._expect("sender", sender, successor)

    def _on_RoleAdminChanged(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: ARG002, N802
        self._differs(f"role {args['role']} has another administrator", "no such change: the contract has no way to it")

    # State

    @property
    def _rules(self) -> Mapping[str, Any]:
        return self._parameters or {}

    def _is_stale(self, uav: _Uav) -> bool:
        after: int = self._rules["staleAfter"]
        return after > 0 and self._now > uav.written + after

    def _is_overdue(self, zone: _Zone) -> bool:
        """The coordinator has had its time."""
        return bool(self._now > zone.since + self._rules["allocationDeadline"])

    def _is_member(self, address: str) -> bool:
        return address in self._uavs or address in self._vehicles

    def _member(self, address: str) -> _Uav | _Vehicle:
        return self._uavs[address] if address in self._uavs else self._vehicles[address]

    def _current(self, uav: _Uav) -> bool:
        """The UAV's session belongs to the current period of its zone."""
        zone = self._zones.get(uav.zone)
        session = uav.session
        return zone is not None and (session.zone, session.period) == (uav.zone, zone.period)

    def _status(self, vehicle: _Vehicle) -> str:
        """Where the vehicle's latest proposal stands in the current period of its zone."""
        zone = self._zones.get(vehicle.zone)
        if vehicle.proposal is None or zone is None:
            return "none"
        name, number, index = vehicle.proposal
        session = self._uavs[name].session
        if (session.number, session.zone, session.period) != (number, vehicle.zone, zone.period):
            return "none"
        if index >= session.decided:
            return "pending"
        return "selected" if index in session.selected else "rejected"

    def _expect_selected(self, number: int, args: Mapping[str, Any]) -> tuple[int, int]:
        """Compare an event's numbers of selected UAVs and vehicles with the zone's."""
        sessions = [self._uavs[name].session for name in self._zones[number].uavs if self._current(self._uavs[name])]
        claimed = self._zones[number].claimed
        counts = [len(s.selected) for s in sessions if s.selected] + (claimed.selected if claimed is not None else [])
        uavs, vehicles = len(counts), sum(counts)
        self._expect("selected UAVs", args["selectedUAVs"], uavs)
        self._expect("selected vehicles", args["selectedVehicles"], vehicles)
        return uavs, vehicles

    def _expect_match(self, member: str, by: str) -> None:
        """Rater and rated were matched in the UAV's last finished session, and the match was not used before."""
        rates_uav = member in self._uavs
        name, vehicle = (member, by) if rates_uav else (by, member)
        uav = self._uavs[name]
        ended = uav.session.served and not self._current(uav)
        session = uav.session if ended else uav.finished
        if session is None:
            self._differs("rated", "no rating: the UAV has no finished session")
            return
        if rates_uav:
            proposal = self._vehicles[vehicle].proposal
            known = proposal is not None and proposal[:2] == (name, session.number) and proposal[2] in session.selected
            self._require("rating", f"of {name} by {vehicle}", known, "one of a UAV that served the vehicle")
            self._vehicles[vehicle].proposal = None
            return
        places = [i for i in session.selected | session.given_up if session.proposals[i].vehicle == vehicle]
        self._require("rating", f"of {vehicle} by {name}", bool(places), "one of a vehicle that the UAV served")
        for place in places:
            session.proposals[place].vehicle = ""

    # Comparison

    def _within_limits(self, args: Mapping[str, Any]) -> None:
        self._require_at_most("battery", args["battery"], 10_000)
        self._require_at_most("bandwidth", args["bandwidth"], self._rules["maxBandwidth"])
        self.checked["records"] += 1

    def _by(self, event: Event, member: str) -> None:
        """The transaction is the member's own."""
        sender = self._sender_of(event)
        if sender is not None:
            self._expect("sender", sender, member)

    def _by_role(self, event: Event, role: str) -> None:
        sender = self._sender_of(event)
        if sender is not None:
            self._has_role(sender, role)

    def _by_coordinator(self, event: Event, zone: int, open_to_all: bool) -> None:
        """The transaction is the zone's coordinator's; or anyone's, where that is so."""
        if open_to_all:
            return
        sender, own = self._sender_of(event), self._coordinators.get(zone, _NOBODY)
        if own == _NOBODY:
            self._by_role(event, COORDINATOR)
        elif sender is not None:
            self._expect("sender", sender, own)

    def _expect_admitted(self, member: str, kind: int) -> None:
        """Where the contract was deployed with admission, the member registers as what it was admitted as."""
        if self._rules["admission"]:
            self._expect("admitted as", self._admitted.pop(member, None), kind)

    def _expect_suspension(self, event: Event) -> None:
        """What a registrar has voided or withdrawn belongs to a member that it suspends in the same transaction."""
        if self._suspending is not None:
            member, block, transaction = self._suspending
            found = (event.name, event.args.get("member"), event.block, event.transaction)
            self._expect("follows", found, ("MemberSuspended", member, block, transaction))
            self._suspending = None

    def _has_role(self, account: str, role: str) -> None:
        self._require("sender", account, self._holds(account, role), f"one with the role of {_ROLES.get(role, role)}")

    def _holds(self, account: str, role: str) -> bool:
        return account in self._roles.get(role, ())

    def _expect(self, what: str, found: object, expected: object) -> None:
        if found != expected:
            self._differs(f"{what} {_text(found)}", _text(expected))

    def _require(self, what: str, found: object, holds: bool, expected: str) -> None:
        if not holds:
            self._differs(f"{what} {_text(found)}", expected)

    def _require_at_most(self, what: str, found: int, most: int) -> None:
        self._require(what, found, found <= most, f"at most {most}")

    def _differs(self, found: str, expected: str) -> None:
        self.differences.append(Difference(self._place, found, expected))


def _outside(value: int, low: int, high: int) -> int:
    return max(low - value, value - high, 0)


def _text(value: object) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(str(item) for item in value) + "]"
    return str(value)
