"""What the contract's events say of a run, period by period, in the units of the run's tables.

The run's record is written from it, and the audit works it out again from the chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from skyrelay.chain.abi import Event
from skyrelay.chain.client import DECIMETRES, HUNDREDTHS
from skyrelay.chain.proof.reference import SETTLER

_OPENS_SELECTION = {"VehSelectionSubmitted", "UAVAllocated", "ZoneAllocated", "ModelAssigned"}

Row = dict[str, Any]


@dataclass
class Period:
    """One selection period.

    Attributes:
        fleet, members: the records when its proposals opened, by name: the columns of the tables of these names. A
            vehicle that has not written its own by then is a member once it has, or has proposed by an older one.
        told: who of them wrote the record at the period's first step; others' is older.
        versions: by UAV that has changed its record from the period's first step on, every one that it has had since;
            None for one in no zone.
        proposals: in the order of submission, with their round and what became of them.
        renewed: of those that were made within the period, by their order, the records that they went by: the
            vehicle's and the UAV's.
    """

    fleet: dict[str, Row] = field(default_factory=dict)
    members: dict[str, Row] = field(default_factory=dict)
    told: set[str] = field(default_factory=set)
    versions: dict[str, list[Row | None]] = field(default_factory=dict)
    proposals: list[Row] = field(default_factory=list)
    renewed: dict[int, tuple[Row, Row]] = field(default_factory=dict)
    _given_up: set[int] = field(default_factory=set)  # orders of proposals that were accepted until the vehicle left
    _served: list[tuple[int, dict[str, str]]] = field(default_factory=list)

    @property
    def served(self) -> dict[str, str]:
        """UAV by vehicle, in the end."""
        return self._served[-1][1] if self._served else {}

    def served_at(self, step: int) -> dict[str, str]:
        """UAV by vehicle, as far as a step's row may show; one who allocates late changes it in mid-period."""
        return next((served for at, served in reversed(self._served) if at <= step), {})

    def settle(self, held: Mapping[str, set[str]], step: int) -> None:
        """A vehicle is served by the UAV that it asked last, if that UAV holds it."""
        last = {row["vehicle"]: number for number, row in enumerate(self.proposals)}
        valid = [(number, row) for number, row in enumerate(self.proposals) if row["order"] not in self._given_up]
        for number, row in valid:
            row["accepted"] = last[row["vehicle"]] == number and row["vehicle"] in held.get(row["uav"], ())
        if self._served and self._served[-1][0] == step:
            self._served.pop()
        self._served.append((step, {row["vehicle"]: row["uav"] for _, row in valid if row["accepted"]}))

    def give_up(self, vehicle: str, uav: str) -> None:
        """A vehicle has left: its proposal keeps what became of it until then."""
        rows = [row for row in self.proposals if row["vehicle"] == vehicle and row["uav"] == uav]
        self._given_up |= {row["order"] for row in rows}


class History:
    """All periods, and what outlives them.

    Args:
        names: of the members, by address; one that has none goes by its address.
        periods, period_steps: of the run.
        reselections: steps within periods at which vehicles ask again; a step's row is written before.

    Attributes:
        demands: [kbit/s] by the vehicle's name, of those that ever proposed.
        zones: by UAV, the steps at which its zone changed, each with the new one, 0 where it left, and the step whose
            row shows it first.
        models: ids that were assigned.
        cids: by model id, as the contract has them.
        roles: accounts that were ever granted one.
        registered: addresses by kind.
        parameters: that the contract was deployed with.
    """

    def __init__(
        self,
        names: Mapping[str, str],
        periods: int,
        period_steps: int,
        reselections: frozenset[int] = frozenset(),
    ) -> None:
        self._reselections = reselections
        self.periods = [Period() for _ in range(periods)]
        self.demands: dict[str, int] = {}
        self.zones: dict[str, list[tuple[int, int, int]]] = {}
        self.models: set[str] = set()
        self.cids: dict[str, bytes] = {}
        self.roles: set[str] = set()
        self.registered: dict[str, list[str]] = {"uav": [], "vehicle": []}
        self.parameters: Mapping[str, Any] = {}
        self._names, self._period_steps = names, period_steps
        self._uavs: dict[str, Row] = {}
        self._vehicles: dict[str, Row] = {}
        self._reported: dict[str, int] = {}  # the step at which each member last told its record
        self._told_at = 0  # the last step at which a UAV did
        self._opened = -1  # the last period whose records have been taken down
        self._held: dict[str, set[str]] = {}
        self._settled = 0  # the period that it is of
        self._rounds: dict[int, int] = {}
        self._submitted = 0

    @property
    def landed(self) -> int:
        """How many UAVs left."""
        return sum(changes[-1][1] == 0 for changes in self.zones.values())

    def station(self, uav: str, step: int) -> int:
        """The zone that a UAV last had up to a step, whether or not it has landed since; 0 for an unknown one."""
        changes = self.zones.get(uav, [])
        past = [zone for number, (at, zone, _) in enumerate(changes) if zone and (at <= step or number == 0)]
        return past[-1] if past else 0

    def zone_at(self, uav: str, step: int) -> int:
        """A UAV's zone in a step's row; a change between two periods shows in the next row, a landing at once."""
        changes = self.zones.get(uav, [])
        past = [zone for number, (_, zone, shown) in enumerate(changes) if number == 0 or shown <= step]
        return past[-1] if past else 0

    def hear(self, event: Event, step: int) -> None:
        """The next event of the chain, with the step of the run that it belongs to."""
        args, number = event.args, step // self._period_steps
        if step > number * self._period_steps or event.name in _OPENS_SELECTION:
            self.open(number)
        elif number:
            self.open(number - 1)
        period = self.periods[number] if number < len(self.periods) else None
        match event.name:
            case "Deployed":
                self.parameters = args["parameters"]
            case "RoleGranted" if args["role"] != SETTLER:  # which a contract has, and no account
                self.roles.add(args["account"])
            case "ModelRegistered":
                self.cids[args["modelId"]] = bytes.fromhex(args["cid"][2:])
            case "ModelAssigned":
                self.models.add(args["modelId"])
            case "UAVRegistered" | "UAVUpdated" | "UAVZoneUpdated":
                self._note_uav(event, step)
            case "VehicleRegistered" | "VehicleUpdated":
                vehicle = self._name(args["vehicle"])
                if event.name == "VehicleRegistered":
                    self.registered["vehicle"].append(args["vehicle"])
                    self._vehicles[vehicle] = {"reputation": args["reputation"] / HUNDREDTHS}
                self._note_vehicle(vehicle, args, step)
            case "ReputationSet" | "MemberRated":
                member = self._name(args["member"])
                if member in self._uavs:
                    self._change_uav(member, {"reputation": args["reputation"] / HUNDREDTHS}, step)
                else:
                    self._vehicles[member]["reputation"] = args["reputation"] / HUNDREDTHS
            case "ZoneListsReset":
                self._rounds[args["zone"]] = args["round"]
            case "VehSelectionSubmitted" if period is not None:
                self._note_proposal(period, args, step)
            case "UAVAllocated":
                if number != self._settled:  # nothing is held from one period to the next
                    self._held, self._settled = {}, number
                self._held[self._name(args["uav"])] = {self._name(vehicle) for vehicle in args["selected"]}
                if period is not None:
                    period.settle(self._held, step + (step in self._reselections))
            case "VehSelectionWithdrawn" if period is not None:
                vehicle, uav = self._name(args["vehicle"]), self._name(args["uav"])
                self._held.get(uav, set()).discard(vehicle)
                period.give_up(vehicle, uav)
                period.settle(self._held, step + (step in self._reselections))

    def open(self, last: int) -> None:
        """Take down the records of the periods up to ``last`` that have not been."""
        while self._opened < min(last, len(self.periods) - 1):
            self._opened += 1
            begin = self._opened * self._period_steps
            period = self.periods[self._opened]
            period.fleet = {name: dict(row) for name, row in self._uavs.items() if row["zone"]}
            period.told = {name for name, step in self._reported.items() if step == begin}
            period.members = {name: dict(row) for name, row in self._vehicles.items() if name in period.told}

    # Within

    def _name(self, address: str) -> str:
        return self._names.get(address, address)

    def _note_uav(self, event: Event, step: int) -> None:
        """A UAV's record, or its zone."""
        args, uav = event.args, self._name(event.args["uav"])
        if event.name == "UAVZoneUpdated":
            # Who leaves at the end of a step is gone in its row; who does after the reports shows it in the next.
            shown = step + (args["to"] > 0 or (self._told_at == step > 0))
            self.zones.setdefault(uav, []).append((step, args["to"], shown))
            self._change_uav(uav, {"zone": args["to"]}, step)
            return
        record = {
            "x": args["x"] / DECIMETRES,
            "y": args["y"] / DECIMETRES,
            "bandwidth_kbps": args["bandwidth"],
            "battery": args["battery"] / HUNDREDTHS,
        }
        if event.name == "UAVRegistered":
            self.registered["uav"].append(args["uav"])
            self._uavs[uav] = {"zone": 0}
            record |= {"reputation": args["reputation"] / HUNDREDTHS}
        self._reported[uav] = self._told_at = step
        self._change_uav(uav, record, step)

    def _change_uav(self, uav: str, change: Row, step: int) -> None:
        number = step // self._period_steps
        row = self._uavs[uav]
        before = dict(row) if row["zone"] else None
        row |= change
        if number < len(self.periods):
            versions = self.periods[number].versions.setdefault(uav, [before])
            versions.append(dict(row) if row["zone"] else None)

    def _note_vehicle(self, vehicle: str, args: Mapping[str, Any], step: int, *, told: bool = True) -> None:
        """A vehicle's record, by itself or with the proposal that it signed, as its period has it."""
        self._vehicles[vehicle] |= {
            "x": args["x"] / DECIMETRES,
            "y": args["y"] / DECIMETRES,
            "zone": args["zone"],
            "payment": float(args["payment"]),
        }
        if not told:
            return
        self._reported[vehicle] = step
        if self._opened >= 0 and step == self._opened * self._period_steps:
            self.periods[self._opened].members[vehicle] = dict(self._vehicles[vehicle])
            self.periods[self._opened].told.add(vehicle)

    def _note_proposal(self, period: Period, args: Mapping[str, Any], step: int) -> None:
        vehicle = self._name(args["vehicle"])
        before = dict(self._vehicles[vehicle])
        self._note_vehicle(vehicle, args, step, told=False)
        if self._vehicles[vehicle] != before:
            self._note_vehicle(vehicle, args, step)  # it came with the proposal
        if step in self._reselections:
            period.renewed[self._submitted] = dict(self._vehicles[vehicle]), dict(self._uavs[self._name(args["uav"])])
        else:
            period.members.setdefault(vehicle, dict(self._vehicles[vehicle]))
        self.demands[vehicle] = args["demand"]
        period.proposals.append(
            {
                "period": step // self._period_steps,
                "round": args["round"] - self._rounds.get(args["zone"], 1) + 1,
                "zone": args["zone"],
                "vehicle": vehicle,
                "uav": self._name(args["uav"]),
                "qov": args["qov"],
                "score": args["score"],
                "demand_kbps": args["demand"],
                "accepted": False,
                "order": self._submitted,
            }
        )
        self._submitted += 1
