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
_ROLES = {
    ADMIN: "administrator",
    COORDINATOR: "coordinator",
    PUBLISHER: "publisher",
    REPUTATION: "reputation authority",
}

_MAX_PROPOSALS = 1024
_MAX_MODELS = 64
_MAX_SCORE = 2**31 - 1
_CARD_TYPE = "(uint16,uint16,uint16,uint16,uint16,uint8,uint8,int32)"


@dataclass
class _Proposal:
    vehicle: str
    demand: int
    score: int
    withdrawn: bool = False


@dataclass
class _Session:
    """A UAV's proposals and selections in one period of one zone; zone 0 before its first proposal."""

    number: int
    zone: int = 0
    period: int = 0
    proposals: list[_Proposal] = field(default_factory=list)
    decided: int = 0
    selected: set[int] = field(default_factory=set)

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
    zone: int = 0
    session: _Session = field(default_factory=lambda: _Session(1))
    finished: _Session | None = None


@dataclass
class _Vehicle:
    x: int
    y: int
    payment: int
    zone: int
    reputation: int
    proposal: tuple[str, int, int] | None = None
    """UAV, session and index of the latest one."""


@dataclass
class _Zone:
    period: int = 1
    round: int = 1
    allocating: bool = False
    uavs: set[str] = field(default_factory=set)


@dataclass
class _Model:
    owner: str
    card: Mapping[str, Any]


class ReferenceContract:
    """Follows a deployed contract event by event.

    Args:
        sender_of: who sent the transaction of an event to the contract; None where another contract called it.

    Attributes:
        checked: how many of each thing were compared.
        differences: every disagreement.
    """

    def __init__(self, sender_of: Callable[[Event], str | None]) -> None:
        self.checked: Counter[str] = Counter()
        self.differences: list[Difference] = []
        self._sender_of = sender_of
        self._parameters: Mapping[str, Any] | None = None
        self._fixed: FixedParameters | None = None
        self._deployment: tuple[int, int] | None = None
        self._uavs: dict[str, _Uav] = {}
        self._vehicles: dict[str, _Vehicle] = {}
        self._zones: dict[int, _Zone] = {}
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
        self._expect("index", args["index"], len(self._uavs))
        self._expect("reputation", args["reputation"], self._rules["initialReputation"])
        self._uavs[uav] = _Uav(
            args["index"], args["x"], args["y"], args["battery"], args["bandwidth"], args["reputation"]
        )
        self._within_limits(args)

    def _on_UAVUpdated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["uav"])
        uav = self._uavs[args["uav"]]
        self._within_limits(args)
        if args["battery"] == 0:
            self._expect("proposals of an empty UAV", len(uav.session.proposals), 0)
        elif self._current(uav) and args["bandwidth"] < uav.bandwidth:
            self._require(
                "bandwidth", args["bandwidth"], args["bandwidth"] >= uav.session.committed, "what is promised"
            )
        uav.x, uav.y = args["x"], args["y"]
        uav.battery, uav.bandwidth = args["battery"], args["bandwidth"]

    def _on_UAVZoneUpdated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["uav"])
        uav = self._uavs[args["uav"]]
        self._expect("zone left", args["from"], uav.zone)
        self._expect("proposals of a UAV that moves", len(uav.session.proposals), 0)
        if uav.zone:
            self._zones[uav.zone].uavs.discard(args["uav"])
        uav.zone = args["to"]
        if uav.zone:
            self._zones[uav.zone].uavs.add(args["uav"])

    def _on_UAVSubmissionReset(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        if self._sender_of(event) != args["uav"]:
            self._by_role(event, COORDINATOR)
        uav = self._uavs[args["uav"]]
        self._expect("session", args["session"], uav.session.number + 1)
        uav.finished, uav.session = uav.session, _Session(args["session"])
        self.checked["sessions ended"] += 1

    def _on_VehicleRegistered(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        vehicle = args["vehicle"]
        self._by(event, vehicle)
        self._expect("members of this address before", int(self._is_member(vehicle)), 0)
        self._expect("reputation", args["reputation"], self._rules["initialReputation"])
        self._require_at_most("payment", args["payment"], self._rules["maxPayment"])
        self._vehicles[vehicle] = _Vehicle(args["x"], args["y"], args["payment"], args["zone"], args["reputation"])
        self.checked["records"] += 1

    def _on_VehicleUpdated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["vehicle"])
        vehicle = self._vehicles[args["vehicle"]]
        self._require_at_most("payment", args["payment"], self._rules["maxPayment"])
        if args["zone"] != vehicle.zone:
            self._require(
                "zone", args["zone"], self._status(vehicle) not in ("pending", "selected"), "a withdrawn proposal first"
            )
        vehicle.x, vehicle.y = args["x"], args["y"]
        vehicle.payment, vehicle.zone = args["payment"], args["zone"]
        self.checked["records"] += 1

    def _on_ZoneOpened(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: ARG002, N802
        self._expect("openings of the zone before", int(args["zone"] in self._zones), 0)
        self._zones[args["zone"]] = _Zone()

    def _on_VehSelectionSubmitted(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["vehicle"])
        vehicle, uav, zone = self._vehicles[args["vehicle"]], self._uavs[args["uav"]], self._zones[args["zone"]]
        self._expect("zone of the UAV", uav.zone, args["zone"])
        self._expect("zone of the vehicle", vehicle.zone, args["zone"])
        self._expect("round", args["round"], zone.round)
        self._expect("zone under allocation", zone.allocating, False)
        self._require("battery of the UAV", uav.battery, uav.battery > 0, "more than 0")
        status = self._status(vehicle)
        self._require("vehicle's proposal before", status, status in ("none", "rejected"), "none or rejected")
        if status == "rejected" and vehicle.proposal is not None:
            self._require(
                "UAV", args["uav"], vehicle.proposal[0] != args["uav"], "one that has not rejected the vehicle"
            )
        assert self._fixed is not None  # noqa: S101  (the parameters came first, or `follow` would have said so)
        distance = distance_fixed(vehicle.x - uav.x, vehicle.y - uav.y)
        if self._rules["rangeGate"]:
            farthest = self._fixed.max_distance * DISTANCE_SCALE
            self._require("distance [1e-16 m]", distance, distance <= farthest, f"at most {farthest}")
        qov = qov_fixed(self._fixed, args["demand"], vehicle.payment, vehicle.reputation, distance)
        self._expect("QoV", args["qov"], qov)
        self._expect("score", args["score"], score_fixed(qov, args["demand"]))
        if not self._current(uav):
            if uav.session.proposals:
                uav.finished, uav.session = uav.session, _Session(uav.session.number + 1)
            uav.session.zone, uav.session.period = args["zone"], zone.period
        session = uav.session
        self._expect("session", args["session"], session.number)
        self._expect("index", args["index"], len(session.proposals))
        self._require_at_most("index", args["index"], _MAX_PROPOSALS - 1)
        session.proposals.append(_Proposal(args["vehicle"], args["demand"], args["score"]))
        vehicle.proposal = (args["uav"], session.number, len(session.proposals) - 1)
        self.checked["proposals"] += 1

    def _on_VehSelectionWithdrawn(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["vehicle"])
        vehicle = self._vehicles[args["vehicle"]]
        self._expect("proposal", (args["uav"], args["session"], args["index"]), vehicle.proposal)
        status = self._status(vehicle)
        self._require("proposal", status, status in ("pending", "selected"), "pending or selected")
        session = self._uavs[args["uav"]].session
        session.proposals[args["index"]].withdrawn = True
        session.selected.discard(args["index"])
        vehicle.proposal = None
        self.checked["withdrawals"] += 1

    def _on_UAVAllocated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by_role(event, COORDINATOR)
        uav, zone = self._uavs[args["uav"]], self._zones[args["zone"]]
        session = uav.session
        self._expect("zone", args["zone"], uav.zone)
        self._expect("round", args["round"], zone.round)
        self._expect("session", args["session"], session.number)
        self._require("session", session.number, self._current(uav), "one of the zone's period")
        self._expect("decided", args["decided"], len(session.proposals))
        self._require("undecided proposals", 0, session.decided < len(session.proposals), "more than 0")
        open_ = [
            i
            for i, proposal in enumerate(session.proposals)
            if not proposal.withdrawn and (i >= session.decided or i in session.selected)
        ]
        taken = allocate_fixed(
            uav.bandwidth, [(session.proposals[i].score, session.proposals[i].demand) for i in open_]
        )
        vehicles = [session.proposals[open_[i]].vehicle for i in taken]
        self._expect("selected", list(args["selected"]), vehicles)
        session.decided = len(session.proposals)
        # From here on what the chain says counts.
        places = {session.proposals[i].vehicle: i for i in open_}
        session.selected = {places[vehicle] for vehicle in args["selected"]}
        self._expect("committed", args["committed"], session.committed)
        self._require_at_most("committed", args["committed"], uav.bandwidth)
        zone.allocating = True
        self.checked["selections by UAVs"] += 1
        self.checked["vehicles selected"] += len(args["selected"])

    def _on_ZoneAllocated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by_role(event, COORDINATOR)
        zone = self._zones[args["zone"]]
        self._expect("period", args["period"], zone.period)
        self._expect("round", args["round"], zone.round)
        for name in sorted(zone.uavs):
            uav = self._uavs[name]
            if self._current(uav):
                self._expect(f"decided proposals of {name}", uav.session.decided, len(uav.session.proposals))
        self._expect_selected(args["zone"], args)
        zone.allocating = False
        zone.round = args["round"] + 1
        self.checked["allocations of zones"] += 1

    def _on_ZoneListsReset(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by_role(event, COORDINATOR)
        zone = self._zones[args["zone"]]
        self._expect("period", args["period"], zone.period + 1)
        self._expect("round", args["round"], zone.round + 1)
        zone.period, zone.round, zone.allocating = args["period"], args["round"], False
        self.checked["resets of zones"] += 1

    def _on_ModelRegistered(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["owner"])
        self._by_role(event, PUBLISHER)
        cid, card = bytes.fromhex(args["cid"][2:]), args["card"]
        model_id = "0x" + keccak(encode(["bytes", _CARD_TYPE], [cid, tuple(card.values())])).hex()
        self._expect("model id", args["modelId"], model_id)
        self._expect("registrations of the model before", int(args["modelId"] in self._models), 0)
        self._require("CID", args["cid"], len(cid) == 36 and (cid[0], cid[2:4]) == (1, b"\x12\x20"), "CIDv1 of SHA-256")
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
        self._by_role(event, COORDINATOR)
        zone = self._zones[args["zone"]]
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
        self.checked["model assignments"] += 1

    def _on_ReputationSet(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by_role(event, REPUTATION)
        self._require_at_most("reputation", args["reputation"], 10_000)
        self._member(args["member"]).reputation = args["reputation"]
        self.checked["reputations"] += 1

    def _on_MemberRated(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        self._by(event, args["by"])
        member = self._member(args["member"])
        self._expect_match(args["member"], args["by"])
        step = self._rules["ratingStep"]
        self._require("rating", "given", step > 0, "none, ratings are off")
        moved = min(member.reputation + step, 10_000) if args["good"] else max(member.reputation - step, 0)
        self._expect("reputation", args["reputation"], moved)
        member.reputation = args["reputation"]
        self.checked["ratings"] += 1

    def _on_RoleGranted(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: N802
        # The deployer is made administrator by the constructor; every other grant is an administrator's.
        if (event.block, event.transaction) != self._deployment:
            self._has_role(args["sender"], ADMIN)
        self._require("role", args["role"], args["role"] in _ROLES, "one of the contract's")
        self._require(
            "account", args["account"], not self._holds(args["account"], args["role"]), "one without the role"
        )
        self._roles.setdefault(args["role"], set()).add(args["account"])
        self.checked["role changes"] += 1

    def _on_RoleRevoked(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: ARG002, N802
        if args["sender"] != args["account"]:
            self._has_role(args["sender"], ADMIN)
        self._has_role(args["account"], args["role"])
        self._roles.get(args["role"], set()).discard(args["account"])
        self.checked["role changes"] += 1

    def _on_RoleAdminChanged(self, event: Event, args: Mapping[str, Any]) -> None:  # noqa: ARG002, N802
        self._differs(f"role {args['role']} has another administrator", "no such change: the contract has no way to it")

    # State

    @property
    def _rules(self) -> Mapping[str, Any]:
        return self._parameters or {}

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
        uavs, vehicles = sum(bool(s.selected) for s in sessions), sum(len(s.selected) for s in sessions)
        self._expect("selected UAVs", args["selectedUAVs"], uavs)
        self._expect("selected vehicles", args["selectedVehicles"], vehicles)
        return uavs, vehicles

    def _expect_match(self, member: str, by: str) -> None:
        """Rater and rated were matched in the UAV's last finished session, and the match was not used before."""
        rates_uav = member in self._uavs
        name, vehicle = (member, by) if rates_uav else (by, member)
        uav = self._uavs[name]
        ended = uav.session.proposals and not self._current(uav)
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
        places = [i for i in session.selected if session.proposals[i].vehicle == vehicle]
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
