"""The vehicle's agent: registers, keeps its record true, runs Algorithm 1, proposes, and tells its UAV where it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from skyrelay.chain.abi import Event
from skyrelay.chain.client import DECIMETRES, VehicleRecord
from skyrelay.core.entities import FloatArray, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.core.zones import ZoneGrid
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.messages import (
    Advised,
    Beacon,
    Command,
    Fix,
    LeftOut,
    Message,
    Mined,
    Offer,
    Phase,
    Propose,
    ReadZone,
    Refused,
    RegisterVehicle,
    SendBeacon,
    Tick,
    UpdateVehicle,
    ZoneRead,
)
from skyrelay.protocol.sequence import VEHICLE, Machine, VehicleMessage, VehicleState
from skyrelay.protocol.zone_view import ZoneView
from skyrelay.selection.handover import Trigger
from skyrelay.selection.proposal import propose
from skyrelay.selection.quality import are_candidates, pair_qou

_BOUND = frozenset({VehicleState.PROPOSED, VehicleState.SERVED})
"""The chain holds something of the vehicle, which only the chain ends."""


@dataclass(frozen=True)
class Choice:
    """What Algorithm 1, or the method in its place, gave.

    Attributes:
        uav: address of the chosen UAV; None where there is no candidate left.
        qou: of the chosen UAV [0-100]; 0 where there is none.
        weighed: QoU of every candidate by its address.
    """

    uav: str | None
    qou: float
    weighed: dict[str, float]


class VehicleAgent(Agent):
    """One connected vehicle.

    Args:
        name: its id.
        address: its account on the chain.
        demand: [kbit/s].
        payment: [cents per Mbit/s].
        grid: of the zones.
        settings: of the selection (weights, maxima, candidates).
        signs: whether it signs its proposals, its record with them, for others to hand in; what is left out, and a
            record without a proposal, it sends itself.
        tells: whether it sends its record itself all the same: dispatch, which is before the proposals, goes by it.
    """

    HEARS: ClassVar[frozenset[str]] = frozenset({"UAVAllocated", "UAVSubmissionReset", "ZoneListsReset"})

    def __init__(
        self,
        name: str,
        address: str,
        demand: int,
        payment: int,
        grid: ZoneGrid,
        settings: Settings,
        *,
        signs: bool = False,
        tells: bool = False,
    ) -> None:
        super().__init__(name, address)
        self.machine = Machine(f"vehicle {name}", VEHICLE, VehicleState.NEW)
        self.uav: str | None = None
        """Address of the UAV that serves it, or that it has proposed to."""
        self.choice: Choice | None = None
        """What Algorithm 1 gave last in this period; for the record."""
        self._demand, self._payment = demand, payment
        self._grid, self._settings = grid, settings
        self._fix = Fix(None)
        self._refused_by: set[str] = set()
        self._served_by: str | None = None
        self._trigger, self._triggered = Trigger(), False  # whether it may leave who served it, in this period
        self._advised: str | None = None
        self._table: VehicleTable | None = None
        self._zone = 0
        self._signs, self._tells = signs, tells
        self._record: VehicleRecord | None = None
        """Of this period, which the contract does not have yet."""
        self._told: VehicleRecord | None = None
        """What the contract has."""
        self._next: Propose | None = None
        """To be proposed once the contract has the record that is under way."""
        self._closed = False  # the period before is over, and none has begun
        self._reselects = False  # within a period: it asks those with room alone
        self._last = ""
        self._lost = False  # its UAV has left, or given all its vehicles up

    @property
    def state(self) -> VehicleState:
        """Where it stands in the sequence."""
        return self.machine.state

    def receive(self, message: Message) -> Sequence[Command]:
        """Take a message; see `Agent.receive`."""
        match message:
            case Fix():
                self._fix = message
            case Tick():
                return self._at(message)
            case Advised(uav):
                self._advised = uav
            case Event():
                self._hear(message)
            case ZoneRead(view):
                return self._tell_record() if view is None else self._choose(view)
            case LeftOut(offer):
                self._answered(message)
                self._next = offer.proposal
                return self._call(UpdateVehicle(offer.record))
            case Mined() | Refused():
                self._answered(message)
                proposal, self._next = self._next, None
                if self.state is not VehicleState.CHOOSING:
                    return ()
                if isinstance(message, Mined) and proposal is not None:
                    return self._call(proposal)
                self.machine.advance(VehicleMessage.ABSTAIN)  # refused, or its record told and nobody to ask
        return ()

    # The clock

    def _at(self, tick: Tick) -> Sequence[Command]:
        match tick.phase:
            case Phase.CLOSE if self.state not in _BOUND and not self._closed:
                self._end_period()
            case Phase.REPORT:
                self._closed = self._reselects = False
                return self._report()
            case Phase.LEAVE:
                self._reselects = True
                self._refused_by &= {self._last}  # the contract takes no proposal to the same UAV again at once
                return self._report() if self.state in {VehicleState.NEW, VehicleState.GONE} else self._leave()
            case Phase.PROPOSE if self.state in {VehicleState.IDLE, VehicleState.UNSERVED}:
                if self._reselects:
                    self._look()
                return (ReadZone(self._zone),) if self._zone else ()
            case Phase.BEACON if self.state is VehicleState.SERVED:
                return self._beacon(self.uav, tick.time)
            case Phase.BEACON if self.state is VehicleState.UNSERVED and self._fix.position is not None:
                return self._beacon(None, tick.time)
        return ()

    def _beacon(self, to: str | None, now: float) -> Sequence[Command]:
        """Tell its UAV, or every UAV of its zone, where it is and what it asks for."""
        fix, zone = self._fix, self._zone
        return (SendBeacon(Beacon(self.address, zone, to, fix.position, now, fix.speed, asks=float(self._demand))),)

    def _report(self) -> Sequence[Command]:
        """Tell the contract where it is, to 0.1 m; or note that it has left the area."""
        if self._fix.position is None:
            if self.machine.allows(VehicleMessage.LEAVE):
                self.machine.advance(VehicleMessage.LEAVE)
                self.uav = None
            return ()
        record = self._here(*self._fix.position)
        if self.state is VehicleState.NEW:
            return self._call(RegisterVehicle(record))
        if not self.machine.allows(VehicleMessage.UPDATE):
            return ()
        if not self._signs or self._tells or not record.zone:
            return self._call(UpdateVehicle(record))
        self.machine.advance(VehicleMessage.UPDATE)
        self._record = record
        self._note_record(record)
        return ()

    def _here(self, x: float, y: float) -> VehicleRecord:
        """Its record at a place [m]."""
        zone = int(self._grid.zone_of(_one(x), _one(y))[0])
        return VehicleRecord(np.round(x, 1).item(), np.round(y, 1).item(), self._payment, zone)

    # Within a period

    def _leave(self) -> Sequence[Command]:
        """One whose trip is over gives its UAV up, so that another can have it; one whose UAV left is without one."""
        if self._lost and self.state in _BOUND:
            served = self.state is VehicleState.SERVED
            self.machine.advance(VehicleMessage.DISPLACED if served else VehicleMessage.REJECTED)
            self.uav = None
        if self._fix.position is not None:
            return ()
        if self.state in _BOUND and self._told is not None:
            return self._call(UpdateVehicle(replace(self._told, zone=0)))
        if self.state is VehicleState.UNSERVED:
            self.machine.advance(VehicleMessage.LEAVE)
        return ()

    def _look(self) -> None:
        """Where it is now is what it asks by; the contract hears of it with a proposal, or not at all."""
        if self._fix.position is None:
            self._zone = 0
            return
        record = self._here(*self._fix.position)
        self._record = None if record == self._told else record
        self._note_record(record)

    # The chain

    def _hear(self, event: Event) -> None:
        args = event.args
        match event.name:
            case "VehicleRegistered":
                self.machine.advance(VehicleMessage.REGISTER)
                self._note_told(args)
            case "VehicleUpdated":
                gives_up = self.state in _BOUND  # or the contract would have refused it
                self.machine.advance(VehicleMessage.GIVE_UP if gives_up else VehicleMessage.UPDATE)
                self._note_told(args)
                if gives_up:
                    self.uav = None
                    self._leave()
            case "VehSelectionSubmitted":
                if self.state is not VehicleState.CHOOSING:  # read before this agent was started again
                    self.machine.advance(VehicleMessage.READ_ZONE)
                self.machine.advance(VehicleMessage.PROPOSE)
                self.uav, self._record, self._lost = args["uav"], None, False
                self._told = _record(args)
            case "UAVAllocated" if args["uav"] == self.uav and self.state in _BOUND:
                self._learn(self.address in args["selected"])
            case "UAVSubmissionReset" if args["uav"] == self.uav:
                self._lost = True
            case "ZoneListsReset" if args["zone"] == self._zone and not self._closed:
                self._end_period()

    def _note_told(self, args: Mapping[str, Any]) -> None:
        """What the contract has now, by an event of it."""
        self._told, self._record = _record(args), None
        self._note_record(self._told)

    def _note_record(self, record: VehicleRecord) -> None:
        """What the contract has, or gets with the next proposal, is what Algorithm 1 goes by."""
        self._zone = record.zone
        self._closed = False
        # Algorithm 1 weighs the UAVs alone, so the vehicle's own reputation does not matter here.
        self._table = VehicleTable(
            ids=(self.name,),
            x=_one(record.x),
            y=_one(record.y),
            zone=np.array([self._zone], dtype=np.int64),
            demand=_one(self._demand),
            payment=_one(self._payment),
            reputation=_one(0.0),
        )

    def _learn(self, selected: bool) -> None:
        """What allocateZone() decided, or that a better proposal has displaced it."""
        if self.state is VehicleState.SERVED:
            if selected:
                return
            self.machine.advance(VehicleMessage.DISPLACED)
        else:
            self.machine.advance(VehicleMessage.ACCEPTED if selected else VehicleMessage.REJECTED)
        if not selected and self.uav is not None:
            self._refused_by.add(self.uav)
            self._last = self.uav
            self.uav = None

    def _end_period(self) -> None:
        """resetListsForZone() has closed its zone's period, or it is over and there was nothing to close."""
        self._closed = True
        self._served_by = self.uav if self.state is VehicleState.SERVED else None
        if self.machine.allows(VehicleMessage.RESET):
            self.machine.advance(VehicleMessage.RESET)
        self.uav = self.choice = self._advised = None
        self._lost = False
        self._refused_by.clear()

    # Algorithm 1

    def _choose(self, view: ZoneView) -> Sequence[Command]:
        """Algorithm 1 over the zone's UAVs, leaving out those that refused it in this period.

        With `selection.hysteresis` the UAV that served it in the last period is asked again unless another is so much
        better, with `selection.time_to_trigger` for so long: every hand-over costs the user the link.
        """
        if self._table is None:
            raise RuntimeError("a vehicle reports before it chooses")
        self.machine.advance(VehicleMessage.READ_ZONE)
        closed = np.array([address in self._refused_by for address in view.uavs.ids], dtype=bool)
        if self._reselects:
            closed |= view.room < self._demand
        column = int(propose(self._table, view.uavs, self._settings, closed[None])[0])
        columns = np.arange(len(view.uavs.ids))
        pairs = (self._table, view.uavs, np.zeros_like(columns), columns, self._settings)
        qou = np.where(are_candidates(*pairs), pair_qou(*pairs), -np.inf)
        if self._settings.method != "two-sided":
            column = self._as_advised(view)
        elif not self._reselects:
            column = self._or_stay(column, qou, view)
        weighed = {
            address: float(score) for address, score in zip(view.uavs.ids, qou, strict=True) if np.isfinite(score)
        }
        if column < 0:
            self.choice = Choice(None, 0.0, weighed)
            wishes = () if self._reselects else self._tell_record()
            if not wishes:
                self.machine.advance(VehicleMessage.ABSTAIN)
            return wishes
        self.choice = Choice(view.uavs.ids[column], float(qou[column]), weighed)
        proposal = Propose(view.uavs.ids[column], self._demand, view.round)
        if self._signs:
            return self._call(Offer(proposal, self._signed(view)))
        if self._record is None:
            return self._call(proposal)
        self._next = proposal
        return self._call(UpdateVehicle(self._record))

    def _tell_record(self) -> Sequence[Command]:
        """One that has nothing to sign tells the contract where it is by itself."""
        return () if self._record is None else self._call(UpdateVehicle(self._record))

    def _signed(self, view: ZoneView) -> VehicleRecord:
        """The record that its proposal is signed with."""
        assert self._table is not None  # noqa: S101  (it has one, or it would not choose)
        return VehicleRecord(float(self._table.x[0]), float(self._table.y[0]), self._payment, view.zone)

    def _as_advised(self, view: ZoneView) -> int:
        """The column of the UAV that another method than Algorithm 1 gave; -1 where there is none, or no more."""
        if self._advised is None or self._advised in self._refused_by:
            return -1
        return view.uavs.ids.index(self._advised) if self._advised in view.uavs.ids else -1

    def _or_stay(self, column: int, qou: FloatArray, view: ZoneView) -> int:
        """The best UAV's column, or that of the one before."""
        hysteresis, patience = self._settings.hysteresis, self._settings.time_to_trigger
        if (hysteresis == 0.0 and patience == 0) or column < 0:
            return column
        if self._served_by not in view.uavs.ids or self._served_by in self._refused_by:
            return column
        before = view.uavs.ids.index(self._served_by)
        if not qou[before] > 0.0:
            return column
        if self.choice is None:  # once a period
            better = np.flatnonzero(qou > qou[before] + hysteresis)
            self._triggered = self._trigger.note(self._served_by, [view.uavs.ids[uav] for uav in better]) >= patience
        return before if qou[before] + hysteresis >= qou[column] or not self._triggered else column


def _record(args: Mapping[str, Any]) -> VehicleRecord:
    """A vehicle's record as an event of the contract has it."""
    return VehicleRecord(args["x"] / DECIMETRES, args["y"] / DECIMETRES, args["payment"], args["zone"])


def _one(value: float) -> FloatArray:
    return np.array([value], dtype=np.float64)
