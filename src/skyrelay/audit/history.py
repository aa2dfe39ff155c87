"""What the contract's events say of a run, period by period, in the units of the run's tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from skyrelay.chain.abi import Event

DECIMETRES = 10
HUNDREDTHS = 100
_OPENS_SELECTION = {"VehSelectionSubmitted", "UAVAllocated", "ZoneAllocated", "ModelAssigned"}


@dataclass
class Period:
    """One selection period.

    Attributes:
        fleet, members: the records when its proposals opened, by name: the columns of the tables of these names.
        proposals: in the order of submission, with their round and what became of them.
    """

    fleet: dict[str, dict[str, Any]] = field(default_factory=dict)
    members: dict[str, dict[str, Any]] = field(default_factory=dict)
    proposals: list[dict[str, Any]] = field(default_factory=list)

    @property
    def served(self) -> dict[str, str]:
        """UAV by vehicle."""
        return {row["vehicle"]: row["uav"] for row in self.proposals if row["accepted"]}


@dataclass
class History:
    """All periods, and what outlives them.

    Attributes:
        demands: [kbit/s] by the vehicle's name, of those that ever proposed.
        zones: by UAV, the steps at which its zone changed, each with the new one; 0 where it left.
        models: ids that were assigned.
        cids: by model id, as the contract has them.
        roles: accounts that were ever granted one.
        registered: addresses by kind.
        parameters: that the contract was deployed with.
    """

    periods: list[Period]
    demands: dict[str, int] = field(default_factory=dict)
    zones: dict[str, list[tuple[int, int]]] = field(default_factory=dict)
    models: set[str] = field(default_factory=set)
    cids: dict[str, bytes] = field(default_factory=dict)
    roles: set[str] = field(default_factory=set)
    registered: dict[str, list[str]] = field(default_factory=lambda: {"uav": [], "vehicle": []})
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def landed(self) -> int:
        """How many UAVs left."""
        return sum(changes[-1][1] == 0 for changes in self.zones.values())

    def station(self, uav: str, step: int) -> int:
        """The zone that a UAV last had up to a step, whether or not it has landed since; 0 for an unknown one."""
        changes = self.zones.get(uav, [])
        past = [zone for number, (at, zone) in enumerate(changes) if zone and (at <= step or number == 0)]
        return past[-1] if past else 0

    def zone_at(self, uav: str, step: int) -> int:
        """A UAV's zone in a step's row; a change between two periods shows in the next row, a landing at once."""
        changes = self.zones.get(uav, [])
        past = [zone for number, (at, zone) in enumerate(changes) if number == 0 or at + (zone > 0) <= step]
        return past[-1] if past else 0


def history(
    events: Sequence[Event], steps: Sequence[int], names: Mapping[str, str], periods: int, period_steps: int
) -> History:
    """Follow the events.

    Args:
        events, steps: in the chain's order, each with the step of the run at which it was mined.
        names: of the members, by address; one that has none goes by its address.
        periods, period_steps: of the run.
    """
    told = History([Period() for _ in range(periods)])
    uavs: dict[str, dict[str, Any]] = {}
    vehicles: dict[str, dict[str, Any]] = {}
    reported: dict[int, set[str]] = {}
    opened = -1

    def open_periods(last: int) -> None:
        """Take down the records of the periods up to ``last`` that have not been."""
        nonlocal opened
        while opened < min(last, periods - 1):
            opened += 1
            there = reported.get(opened * period_steps, set())
            told.periods[opened].fleet = {name: dict(row) for name, row in uavs.items() if row["zone"]}
            told.periods[opened].members = {name: dict(row) for name, row in vehicles.items() if name in there}

    def note(vehicle: str, args: Mapping[str, Any], step: int) -> None:
        """A vehicle's record, by itself or with the proposal that it signed, as its period has it."""
        vehicles[vehicle] |= {
            "x": args["x"] / DECIMETRES,
            "y": args["y"] / DECIMETRES,
            "zone": args["zone"],
            "payment": float(args["payment"]),
        }
        reported.setdefault(step, set()).add(vehicle)
        if opened >= 0 and step == opened * period_steps:
            told.periods[opened].members[vehicle] = dict(vehicles[vehicle])

    held: dict[str, set[str]] = {}
    settled = 0
    rounds: dict[int, int] = {}
    for event, step in zip(events, steps, strict=True):
        args = event.args
        period = step // period_steps
        if step > period * period_steps or event.name in _OPENS_SELECTION:
            open_periods(period)
        elif period:
            open_periods(period - 1)
        match event.name:
            case "Deployed":
                told.parameters = args["parameters"]
            case "RoleGranted":
                told.roles.add(args["account"])
            case "ModelRegistered":
                told.cids[args["modelId"]] = bytes.fromhex(args["cid"][2:])
            case "ModelAssigned":
                told.models.add(args["modelId"])
            case "UAVRegistered" | "UAVUpdated":
                name = names.get(args["uav"], args["uav"])
                if event.name == "UAVRegistered":
                    told.registered["uav"].append(args["uav"])
                    uavs[name] = {"zone": 0, "reputation": args["reputation"] / HUNDREDTHS}
                uavs[name] |= {
                    "x": args["x"] / DECIMETRES,
                    "y": args["y"] / DECIMETRES,
                    "bandwidth_kbps": args["bandwidth"],
                    "battery": args["battery"] / HUNDREDTHS,
                }
            case "UAVZoneUpdated":
                name = names.get(args["uav"], args["uav"])
                uavs[name]["zone"] = args["to"]
                told.zones.setdefault(name, []).append((step, args["to"]))
            case "VehicleRegistered" | "VehicleUpdated":
                name = names.get(args["vehicle"], args["vehicle"])
                if event.name == "VehicleRegistered":
                    told.registered["vehicle"].append(args["vehicle"])
                    vehicles[name] = {"reputation": args["reputation"] / HUNDREDTHS}
                note(name, args, step)
            case "ReputationSet" | "MemberRated":
                name = names.get(args["member"], args["member"])
                (uavs if name in uavs else vehicles)[name]["reputation"] = args["reputation"] / HUNDREDTHS
            case "ZoneListsReset":
                rounds[args["zone"]] = args["round"]
            case "VehSelectionSubmitted" if period < periods:
                vehicle, uav = names.get(args["vehicle"], args["vehicle"]), names.get(args["uav"], args["uav"])
                note(vehicle, args, step)
                told.demands[vehicle] = args["demand"]
                told.periods[period].proposals.append(
                    {
                        "period": period,
                        "round": args["round"] - rounds.get(args["zone"], 1) + 1,
                        "zone": args["zone"],
                        "vehicle": vehicle,
                        "uav": uav,
                        "qov": args["qov"],
                        "score": args["score"],
                        "demand_kbps": args["demand"],
                        "accepted": False,
                    }
                )
            case "UAVAllocated":
                if period != settled:  # nothing is held from one period to the next
                    held, settled = {}, period
                held[names.get(args["uav"], args["uav"])] = {names.get(v, v) for v in args["selected"]}
        if event.name == "UAVAllocated" and period < periods:
            _settle(told.periods[period].proposals, held)
    open_periods(periods - 1)
    order = 0
    for one in told.periods:
        for row in one.proposals:
            row["order"] = order
            order += 1
    return told


def _settle(proposals: list[dict[str, Any]], held: Mapping[str, set[str]]) -> None:
    """A vehicle is served by the UAV that it asked last, if that UAV holds it."""
    last = {row["vehicle"]: number for number, row in enumerate(proposals)}
    for number, row in enumerate(proposals):
        row["accepted"] = last[row["vehicle"]] == number and row["vehicle"] in held.get(row["uav"], ())
