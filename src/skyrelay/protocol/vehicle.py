"""The vehicle's agent: registers, keeps its record true, runs Algorithm 1, proposes, and tells its UAV where it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

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
    """

    HEARS: ClassVar[frozenset[str]] = frozenset({"UAVAllocated", "ZoneListsReset"})

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
        self._signs = signs
        self._record: VehicleRecord | None = None
        """Of this period, which the contract does not have yet."""
        self._left_out: Propose | None = None
        self._closed = False  # the period before is over, and none has begun

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
                self._left_out = offer.proposal
                return self._call(UpdateVehicle(offer.record))
            case Mined() | Refused():
                self._answered(message)
                left_out, self._left_out = self._left_out, None
                if self.state is not VehicleState.CHOOSING:
                    return ()
                if isinstance(message, Mined) and left_out is not None:
                    return self._call(left_out)
                self.machine.advance(VehicleMessage.ABSTAIN)  # refused, or its record told and nobody to ask
        return ()

    # The clock

    def _at(self, tick: Tick) -> Sequence[Command]:
        match tick.phase:
            case Phase.CLOSE if self.state not in _BOUND and not self._closed:
                self._end_period()
            case Phase.REPORT:
                self._closed = False
                return self._report()
            case Phase.PROPOSE if self.state in {VehicleState.IDLE, VehicleState.UNSERVED} and self._zone:
                return (ReadZone(self._zone),)
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
        x, y = self._fix.position
        zone = int(self._grid.zone_of(_one(x), _one(y))[0])
        record = VehicleRecord(np.round(x, 1).item(), np.round(y, 1).item(), self._payment, zone)
        if self.state is VehicleState.NEW:
            return self._call(RegisterVehicle(record))
        if not self.machine.allows(VehicleMessage.UPDATE):
            return ()
        if not self._signs or not zone:
            return self._call(UpdateVehicle(record))
        self.machine.advance(VehicleMessage.UPDATE)
        self._record = record
        self._note_record(round(record.x * DECIMETRES), round(record.y * DECIMETRES), zone)
        return ()

    # The chain

    def _hear(self, event: Event) -> None:
        args = event.args
        match event.name:
            case "VehicleRegistered":
                self.machine.advance(VehicleMessage.REGISTER)
                self._note_record(args["x"], args["y"], args["zone"])
            case "VehicleUpdated":
                self.machine.advance(VehicleMessage.UPDATE)
                self._note_record(args["x"], args["y"], args["zone"])
                self._record = None
            case "VehSelectionSubmitted":
                if self.state is not VehicleState.CHOOSING:  # read before this agent was started again
                    self.machine.advance(VehicleMessage.READ_ZONE)
                self.machine.advance(VehicleMessage.PROPOSE)
                self.uav, self._record = args["uav"], None
            case "UAVAllocated" if args["uav"] == self.uav and self.state in _BOUND:
                self._learn(self.address in args["selected"])
            case "ZoneListsReset" if args["zone"] == self._zone and not self._closed:
                self._end_period()

    def _note_record(self, x: int, y: int, zone: int) -> None:
        """What the contract has, or gets with the next proposal, is what Algorithm 1 goes by [0.1 m]."""
        self._zone = zone
        self._closed = False
        # Algorithm 1 weighs the UAVs alone, so the vehicle's own reputation does not matter here.
        self._table = VehicleTable(
            ids=(self.name,),
            x=_one(x / DECIMETRES),
            y=_one(y / DECIMETRES),
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
            self.uav = None

    def _end_period(self) -> None:
        """resetListsForZone() has closed its zone's period, or it is over and there was nothing to close."""
        self._closed = True
        self._served_by = self.uav if self.state is VehicleState.SERVED else None
        if self.machine.allows(VehicleMessage.RESET):
            self.machine.advance(VehicleMessage.RESET)
        self.uav = self.choice = self._advised = None
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
        refused = np.array([[address in self._refused_by for address in view.uavs.ids]], dtype=bool)
        column = int(propose(self._table, view.uavs, self._settings, refused)[0])
        columns = np.arange(len(view.uavs.ids))
        pairs = (self._table, view.uavs, np.zeros_like(columns), columns, self._settings)
        qou = np.where(are_candidates(*pairs), pair_qou(*pairs), -np.inf)
        column = self._or_stay(column, qou, view) if self._settings.method == "two-sided" else self._as_advised(view)
        weighed = {
            address: float(score) for address, score in zip(view.uavs.ids, qou, strict=True) if np.isfinite(score)
        }
        if column < 0:
            self.choice = Choice(None, 0.0, weighed)
            wishes = self._tell_record()
            if not wishes:
                self.machine.advance(VehicleMessage.ABSTAIN)
            return wishes
        self.choice = Choice(view.uavs.ids[column], float(qou[column]), weighed)
        proposal = Propose(view.uavs.ids[column], self._demand, view.round)
        return self._call(Offer(proposal, self._told(view)) if self._signs else proposal)

    def _tell_record(self) -> Sequence[Command]:
        """One that has nothing to sign tells the contract where it is by itself."""
        return () if self._record is None else self._call(UpdateVehicle(self._record))

    def _told(self, view: ZoneView) -> VehicleRecord:
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


def _one(value: float) -> FloatArray:
    return np.array([value], dtype=np.float64)
