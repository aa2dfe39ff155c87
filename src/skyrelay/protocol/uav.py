"""The UAV's agent: registers, keeps its record true, gets its zone's policy by CID, and decides alone how it flies."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from skyrelay.airspace.charging import Habit, to_point
from skyrelay.airspace.law import Law
from skyrelay.airspace.sight import Sight
from skyrelay.chain.abi import Event
from skyrelay.chain.client import Model, UavRecord
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.beacon import SKEW
from skyrelay.protocol.messages import (
    Beacon,
    ChangeZone,
    Command,
    Decide,
    Decided,
    FetchModel,
    Fix,
    Message,
    Mined,
    ModelFetched,
    ModelRead,
    Move,
    Phase,
    ReadModel,
    ReadStation,
    Refused,
    RegisterUav,
    SendBeacon,
    StationRead,
    Tick,
    UpdateUav,
)
from skyrelay.protocol.model_card import address_of, require_same_card
from skyrelay.protocol.rule import Decider, Rule
from skyrelay.protocol.sequence import UAV, Machine, UavMessage, UavState
from skyrelay.store.cid import Cid

_ON_THE_BOOKS = frozenset({UavState.AVAILABLE, UavState.CHARGING})
"""Who tells the contract where it is and what its battery has, before a selection."""
_EQUIPPED = frozenset({UavState.AVAILABLE, UavState.SELECTED})
"""Who fetches what its zone flies by: without vehicles, too, since it may be for UAVs that seek some."""


class UavAgent(Agent):
    """One UAV.

    Args:
        name: its id.
        address: its account on the chain.
        zone: that it is stationed in.
        altitude: [m].
        bandwidth: that it offers in a period [kbit/s].
        law: of the area that it flies in.
        load: from a policy file's bytes, or a rule's card, to what decides, checked to fit.
    """

    HEARS: ClassVar[frozenset[str]] = frozenset({"UAVAllocated", "UAVZoneUpdated", "ModelAssigned", "ZoneListsReset"})

    def __init__(
        self,
        name: str,
        address: str,
        zone: int,
        altitude: float,
        bandwidth: int,
        law: Law,
        load: Callable[[bytes], Decider],
    ) -> None:
        super().__init__(name, address)
        self.machine = Machine(f"UAV {name}", UAV, UavState.NEW)
        self.policy: Decider | None = None
        self._station, self._altitude, self._bandwidth = zone, altitude, bandwidth
        self._law, self._load = law, load
        self._zone = 0
        self._fix = Fix(None, 100.0)  # a battery that nobody has told of is not low
        self._model: str | None = None  # that the contract has assigned to its zone in this period
        self._read: Model | None = None  # it, as the contract had it when last asked
        self._loaded: Cid | None = None
        self._vehicles: Sequence[str] = ()
        self._asked: dict[str, int] = {}  # of it in this period, by vehicle [kbit/s]
        self._team: set[str] = set()
        self._beacons: dict[str, Beacon] = {}
        self._time = math.inf  # until a tick says
        self._decisions = 0  # since it was last selected

    @property
    def state(self) -> UavState:
        """Where it stands in the sequence."""
        return self.machine.state

    @property
    def tuned_in(self) -> int:
        """Its zone, while it flies there."""
        return self._zone

    def receive(self, message: Message) -> Sequence[Command]:
        """Take a message; see `Agent.receive`.

        Raises:
            ModelError: a policy's card does not fit a UAV, or is not what the contract says; or the model is retired.
        """
        match message:
            case Fix():
                self._fix = message
            case Tick():
                return self._at(message)
            case Beacon():
                self._note_beacon(message)
            case Decided(action):
                return (Move(self._apart(action)),)
            case Event():
                return self._hear(message)
            case StationRead(zone):
                # A rule that has its own say in charging takes from the plan of all only where it is needed.
                if zone is None or (zone == 0 and not self._rotates):
                    return ()
                return self._call(ChangeZone(zone))
            case ModelRead(model) if model.model_id == self._model:
                self._read = model
                return self._equip(model)
            case ModelFetched(cid, content) if self._read is not None and cid == address_of(self._read):
                self.policy, self._loaded = self._load(content), cid
                return self._ready(self._read, self.policy)
            case Mined() | Refused():
                self._answered(message)
        return ()

    # The clock

    def _at(self, tick: Tick) -> Sequence[Command]:
        self._time = tick.time
        match tick.phase:
            case Phase.JOIN | Phase.REPORT if self.state is UavState.NEW:
                return self._report(RegisterUav, self._station)
            case Phase.CLOSE if self.state not in {UavState.SELECTED, UavState.FLYING}:
                self._end_period()
            case Phase.LAND if self.machine.allows(UavMessage.RETIRE) and self._must_leave():
                return self._call(ChangeZone(0))
            case Phase.REPORT if self.state in _ON_THE_BOOKS:
                return self._report(UpdateUav)
            case Phase.RESELECT if self._has_room() and self.machine.allows(UavMessage.UPDATE):
                return self._report(UpdateUav)
            case Phase.DISPATCH if self.state in _ON_THE_BOOKS:
                return self._ask_station()
            case Phase.BEACON if self._zone:
                if self.state is UavState.SELECTED and self._model is not None:
                    # One that was started again has its policy to load before it can fly.
                    return (*self._beacon(tick.time), ReadModel(self._model))
                return self._beacon(tick.time)
            case Phase.DECIDE if (home := self._home()) is not None:
                return (Move(home),)
            case Phase.DECIDE if (way := self._way_in()) is not None:
                return (Move(self._apart(way)),)
            case Phase.DECIDE if self.state is UavState.FLYING and self.policy is not None:
                place = self._fix.position  # without one it hovers: it may be anywhere
                if place is None:
                    return ()
                self._decisions += 1
                return (Decide(self.policy, self._sight(place, tick.time)),)
            case Phase.DECIDE if self.state is UavState.AVAILABLE and isinstance(self.policy, Rule):
                if self.policy.seeks and self._model is not None and self._fix.position is not None:
                    return (Decide(self.policy, self._sight(self._fix.position, tick.time)),)
        return ()

    def _has_room(self) -> bool:
        """Whether a vehicle without a UAV that it heard lately, and can reach, asks for no more than it has left."""
        place = self._fix.position
        if not self._zone or place is None:
            return False
        room = self._bandwidth - sum(self._asked.get(vehicle, 0) for vehicle in self._vehicles)
        seeking = [beacon for beacon in self._beacons.values() if beacon.to is None and 0.0 < beacon.asks <= room]
        heard = self._last_of([beacon.sender for beacon in seeking], self._time)
        places = np.array([beacon.position for beacon in heard if beacon.position is not None]).reshape(-1, 2)
        return bool((np.hypot(*(places - place).T) <= self._law.reach).any())

    def _apart(self, action: int) -> int:
        """What has been decided, but for coming too near to another UAV of the zone that it heard lately."""
        if self._fix.position is None:
            return action
        uavs = [sender for sender, beacon in self._beacons.items() if beacon.to is None and not beacon.asks]
        heard = self._last_of([sender for sender in uavs if sender != self.address], self._time)
        places = [beacon.position for beacon in heard if beacon.position is not None]
        return self._law.apart(action, self._zone, self._fix.position, np.array(places).reshape(-1, 2))

    # Charging

    @property
    def _habit(self) -> Habit:
        """When it goes to be charged, and comes back; a rule may have its own."""
        return self.policy.habit if isinstance(self.policy, Rule) and self.policy.habit else Habit()

    @property
    def _rotates(self) -> bool:
        """Whether it goes by the plan of all, and not by what it, or its rule, finds."""
        return self._law.rotates and not (isinstance(self.policy, Rule) and self.policy.habit)

    def _must_leave(self) -> bool:
        """Whether its battery lasts no longer: for the way to a charging point, where there are such."""
        if not self._law.places:
            return self._fix.battery <= self._law.energy.reserve
        place = self._fix.position
        return (
            self._zone > 0 and place is not None and self._law.must_charge(self._fix.battery, place, self._habit.spare)
        )

    def _home(self) -> int | None:
        """The action that leads to a charging point and stays there; None of one that need not go.

        By its battery alone, too: however slow the chain is, no UAV waits for it in the air.
        """
        law, place = self._law, self._fix.position
        if not law.places or place is None:
            return None
        if self.state is not UavState.CHARGING and not self._must_leave():
            return None
        return to_point(int(law.places.nearest(np.array([place]))[0][0]))

    def _ask_station(self) -> Sequence[Command]:
        """Which zone it flies in next: by the plan of all, or of its own accord once it is charged."""
        away = self.state is UavState.CHARGING
        if not (away or self._zone):
            return ()
        if self._rotates or (self._law.dispatch and not away):
            return (ReadStation(self._law),)
        if away and self._fix.battery >= self._habit.enough:
            return self._call(ChangeZone(self._station))
        return ()

    def _way_in(self) -> int | None:
        """Of a UAV that comes from another zone: the action that brings it nearest to its own; None inside it."""
        if not self._zone or self._fix.position is None:
            return None
        return self._law.way_in(self._zone, self._fix.position)

    def _report(self, kind: type[RegisterUav | UpdateUav], zone: int = 0) -> Sequence[Command]:
        """Tell the contract where it is; nothing without a fix, so that the contract goes by the last one."""
        if self._fix.position is None:
            return ()
        x, y = self._fix.position
        return self._call(kind(UavRecord(x, y, self._altitude, self._fix.battery, self._bandwidth, zone)))

    def _beacon(self, now: float) -> Sequence[Command]:
        """Tell the zone where it is, if it knows."""
        fix = self._fix
        if fix.position is None:
            return ()
        return (SendBeacon(Beacon(self.address, self._zone, None, fix.position, now, fix.speed, fix.battery)),)

    # The chain

    def _hear(self, event: Event) -> Sequence[Command]:
        args = event.args
        match event.name:
            case "UAVRegistered":
                self.machine.advance(UavMessage.REGISTER)
            case "UAVUpdated":
                self.machine.advance(UavMessage.UPDATE)
            case "UAVZoneUpdated" if args["uav"] == self.address:
                self._zone = args["to"]
                self._station = self._zone or self._station
                if not self._zone:
                    self._model, self._vehicles = None, ()
                    self._team.clear()
                    self.machine.advance(UavMessage.CHARGE if self._law.places else UavMessage.RETIRE)
                elif self.state is UavState.CHARGING:
                    self.machine.advance(UavMessage.RETURN)
            case "UAVZoneUpdated" if args["from"] == self._zone:
                self._team.discard(args["uav"])
            case "VehSelectionSubmitted":
                self._asked[args["vehicle"]] = args["demand"]
            case "VehSelectionWithdrawn" if args["vehicle"] in self._vehicles:
                self._learn([vehicle for vehicle in self._vehicles if vehicle != args["vehicle"]])
            case "UAVAllocated" if args["uav"] == self.address:
                self._learn(args["selected"])
            case "UAVAllocated" if args["zone"] == self._zone:
                (self._team.add if args["selected"] else self._team.discard)(args["uav"])
            case "ModelAssigned" if args["zone"] == self._zone and self.state in _EQUIPPED:
                self._model = args["modelId"]
                return (ReadModel(self._model),)
            case "ZoneListsReset" if args["zone"] == self._zone:
                self._end_period()
        return ()

    def _learn(self, vehicles: Sequence[str]) -> None:
        """Whom allocateZone() has selected for it so far in this period."""
        self._vehicles = vehicles
        if vehicles:
            self.machine.advance(UavMessage.SELECTED)
        elif self.machine.allows(UavMessage.UNSELECTED):
            self.machine.advance(UavMessage.UNSELECTED)

    def _end_period(self) -> None:
        """resetListsForZone() has closed its zone's period, or it is over and there was nothing to close."""
        if self.machine.allows(UavMessage.RESET):
            self.machine.advance(UavMessage.RESET)
        self._model, self._vehicles = None, ()
        self._asked.clear()
        self._team.clear()

    # The policy

    def _equip(self, model: Model) -> Sequence[Command]:
        """Fetch the policy that the contract names unless it is on board; it must be what the contract says of it."""
        cid = address_of(model)
        if self.policy is None or cid != self._loaded:
            return (FetchModel(cid),)
        self.policy = self._load(self.policy.content)  # once a period: what was signed for a time may be over it
        return self._ready(model, self.policy)

    def _ready(self, model: Model, policy: Decider) -> Sequence[Command]:
        require_same_card(model, policy.card)
        if self.state is UavState.SELECTED:
            self.machine.advance(UavMessage.MODEL_VERIFIED)
            self._decisions = 0
        return ()

    # The flight

    def _note_beacon(self, beacon: Beacon) -> None:
        """The newest of each sender; one from the future would be newer than all that is true."""
        if beacon.time > self._time + SKEW:
            return
        last = self._beacons.get(beacon.sender)
        if last is None or beacon.time >= last.time:
            self._beacons[beacon.sender] = beacon

    def _sight(self, place: tuple[float, float], now: float) -> Sight:
        """What it knows now: of its mates and vehicles what they last said, if that is not too long ago.

        A mate may have flown on since: by so much its link is held shorter than the range.
        """
        team = [
            (beacon.position, self._law.speed * max(now - beacon.time, 0.0))
            for beacon in self._last_of(sorted(self._team), now)
            if beacon.position is not None
        ]
        own = _told(self._last_of(self._vehicles, now))
        seeking = {beacon.sender: beacon for beacon in self._beacons.values() if beacon.asks and beacon.to is None}
        seekers = _told(self._last_of(sorted(seeking.keys() - set(self._vehicles)), now))
        return Sight(
            law=self._law,
            zone=self._zone,
            own=place,
            team=tuple(position for position, _ in team),
            margins=tuple(margin for _, margin in team),
            vehicles=tuple(place for place, _ in own),
            battery=self._fix.battery,
            uav=self.name,
            decisions=self._decisions - 1,
            selected=self.state is UavState.FLYING,
            demands=tuple(asked for _, asked in own),
            seekers=tuple(place for place, _ in seekers),
            sought=tuple(asked for _, asked in seekers),
        )

    def _last_of(self, members: Sequence[str], now: float) -> list[Beacon]:
        """The last beacons of members that still count."""
        beacons = (self._beacons[member] for member in members if member in self._beacons)
        return [beacon for beacon in beacons if now - beacon.time <= self._law.patience]


def _told(beacons: Sequence[Beacon]) -> list[tuple[tuple[float, float], float]]:
    """Where vehicles say that they are, and what each asks for."""
    return [(beacon.position, beacon.asks) for beacon in beacons if beacon.position is not None]
