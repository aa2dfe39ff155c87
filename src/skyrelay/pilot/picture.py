"""The fleet as an onlooker knows it by what the chain says and members send. No input, no output."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from skyrelay.airspace.flight import in_range, in_sight
from skyrelay.airspace.law import Law
from skyrelay.chain.abi import Event
from skyrelay.core.scenario import Coordination
from skyrelay.pilot.fleet_clock import FleetClock
from skyrelay.protocol.messages import Beacon
from skyrelay.runfolder import feed
from skyrelay.runfolder.feed import LOW_BATTERY, Alert, Record

MOST_WAITING = 100_000
"""Events that no record has held yet."""
MOST_EARLY = 64
"""Beacons of one member that wait for their steps to begin; the newest make room."""
KEPT_PERIODS = 2
"""A vehicle that nobody serves is shown for so long where it last told the chain that it was [periods]."""
NO_BLOCK = 20.0
"""So long after a period began a chain that works has mined something of it [s]."""


@dataclass
class _Member:
    """What is known of a member: position [m], when it said so [s], and when it told the chain [step]."""

    position: tuple[float, float] | None = None
    time: float = -np.inf
    told: int = 0
    zone: int = 0
    battery: float = 0.0
    heard: bool = False


@dataclass
class _Said:
    """Alerts that hold: each is said once, and again when it has been over in between."""

    low: set[str] = field(default_factory=set)
    silent: set[str] = field(default_factory=set)
    all_silent: bool = False
    no_block: bool = False


class Picture:
    """Puts together what is heard.

    A step begins when more than half of the UAVs in the air are in it by their own clocks (`FleetClock`).

    Args:
        law: of the area.
        flight: the scenario's section of steps and periods.
        names: of members, by address; others are called by theirs.

    Attributes:
        uavs, vehicles: addresses that the chain knows.
        step: the newest that has begun, or -1.
    """

    def __init__(self, law: Law, flight: Coordination, names: Mapping[str, str]) -> None:
        self.uavs: dict[str, _Member] = {}
        self.vehicles: dict[str, _Member] = {}
        self.step = -1
        self._law, self._flight, self._names = law, flight, names
        self._period = flight.period_steps
        self._held: dict[str, list[str]] = {}
        self._fleet = FleetClock()
        self._on_chain = 0  # the period that the chain is in
        self._early: dict[str, deque[Beacon]] = {}
        self._events: deque[tuple[int, Event]] = deque(maxlen=MOST_WAITING)
        self._alerts: deque[Alert] = deque(maxlen=feed.MAX_EVENTS)
        self._said = _Said()
        self._latest = 0
        self._now = -np.inf  # the clock, as long as it is in the step that has begun [s]
        self._mined = -np.inf  # [s], on the members' clock

    @property
    def clock(self) -> float:
        """The time that the fleet is in [s]; -inf before any."""
        return self._fleet.time

    @property
    def end(self) -> float:
        """Of the run [s]: no member can be any later."""
        return self._flight.steps * self._law.seconds

    @property
    def news(self) -> bool:
        """Whether there is an event or an alert that no record has told."""
        return bool(self._alerts or self._events)

    @property
    def behind(self) -> bool:
        """Whether UAVs are in a later step than the newest that has begun."""
        return self._step_of(self.clock) > self.step

    def name(self, address: str) -> str:
        """Of a member."""
        return self._names.get(address, address)

    def alert(self, kind: feed.AlertKind, about: str, text: str) -> None:
        """Something to look at; it goes out with the next record."""
        self._alerts.append(Alert(kind, about[:256], text[:500]))

    # The chain

    def hear(self, event: Event) -> None:
        """An event of the contract: of the step after the newest one that has begun, as in a run's record."""
        match event.name:
            case "UAVRegistered":
                self.uavs.setdefault(event.args["uav"], _Member())
                self._fleet.join(event.args["uav"])
            case "UAVZoneUpdated":
                (self._fleet.join if event.args["to"] else self._fleet.leave)(event.args["uav"])
            case "VehicleRegistered":
                self.vehicles.setdefault(event.args["vehicle"], _Member())
            case "ZoneListsReset":
                self._on_chain = max(self._on_chain, event.args["period"] - 1)
            case "ZoneAllocated" if self.step >= 0:
                # What a step more or less says is how far apart chain and beacons are heard.
                late = (self.step + 1) % self._period
                again = self._flight.reselect_steps
                if late not in (0, 1, self._period - 1) and not (again and late % again in (0, 1, again - 1)):
                    zone = event.args["zone"]
                    text = f"zone {zone} was allocated {late} steps after its period began"
                    self.alert("late-allocation", str(zone), text)
        self._events.append((self.step + 1, event))

    def _learn(self, step: int, event: Event) -> None:
        """What an event of a step that is told changes."""
        args = event.args
        match event.name:
            case "UAVRegistered" | "UAVUpdated" if args["uav"] in self.uavs:
                uav = self.uavs[args["uav"]]
                if not uav.heard:  # its beacons are newer, and not rounded
                    uav.position, uav.battery = (args["x"] / 10, args["y"] / 10), args["battery"] / 100
            case "UAVZoneUpdated" if args["uav"] in self.uavs:
                self._zone(args["uav"], args["to"])
            case "VehicleRegistered" | "VehicleUpdated" if args["vehicle"] in self.vehicles:
                vehicle = self.vehicles[args["vehicle"]]
                vehicle.told = step
                if not vehicle.heard or vehicle.time < step * self._law.seconds:
                    vehicle.position = (args["x"] / 10, args["y"] / 10)
            case "ZoneListsReset":
                here = [address for address in self._held if self.uavs[address].zone == args["zone"]]
                for address in here:
                    del self._held[address]
            case "UAVAllocated" if args["uav"] in self.uavs:
                self._held[args["uav"]] = [vehicle for vehicle in args["selected"] if vehicle in self.vehicles]
                # It was not at work before: its silence counts from here.
                self.uavs[args["uav"]].time = max(self.uavs[args["uav"]].time, self._now)

    def mined(self) -> None:
        """The chain has a new block."""
        self._mined, self._said.no_block = self.clock, False

    def _zone(self, address: str, zone: int) -> None:
        uav = self.uavs[address]
        if uav.zone and not zone:
            self._held.pop(address, None)
            if not self._law.places:  # where there are some it is on its way there
                name = self.name(address)
                self.alert("low-battery", name, f"{name} has landed, its battery at {uav.battery:.1f} %")
        uav.zone = zone

    # The bus

    def take(self, beacon: Beacon, heard: float) -> None:
        """A beacon that was let in.

        Args:
            heard: when, by the onlooker's own clock [s].
        """
        if beacon.sender in self.uavs:
            between = (self.step + 1) % self._period == 0  # all wait for the chain, and who does not is alone
            patience = max(self._law.patience, NO_BLOCK) if between else self._law.patience
            most = (self._on_chain + 1) * self._period * self._law.seconds
            self._fleet.hear(beacon.sender, beacon.time, heard, patience, most)
            if not self.behind:
                self._now = self.clock
        self._sort(beacon)

    def advance(self) -> None:
        """Begin the step that the UAVs are in by now."""
        self._now = self.clock
        self.step = self._step_of(self._now)
        waiting, self._early = self._early, {}
        for beacons in waiting.values():
            for beacon in beacons:
                self._sort(beacon)

    def _sort(self, beacon: Beacon) -> None:
        """What belongs to a step that has begun is told; what does not waits."""
        if self._step_of(beacon.time) <= self.step:
            self._apply(beacon)
        else:
            self._early.setdefault(beacon.sender, deque(maxlen=MOST_EARLY)).append(beacon)

    def _step_of(self, time: float) -> int:
        return -1 if time == -np.inf else max(0, min(round(time / self._law.seconds), 2**31 - 1))

    def _apply(self, beacon: Beacon) -> None:
        member = (self.uavs if beacon.to is None else self.vehicles).get(beacon.sender)
        if member is None or beacon.time < member.time:
            return
        member.position, member.time, member.heard = beacon.position, beacon.time, True
        if beacon.to is None:
            member.battery = beacon.battery
            self._watch(beacon.sender, member)

    def _watch(self, address: str, uav: _Member) -> None:
        """Whether a UAV's battery has become low."""
        if uav.battery > self._law.energy.reserve + LOW_BATTERY:
            self._said.low.discard(address)
        elif address not in self._said.low:
            self._said.low.add(address)
            name = self.name(address)
            self.alert("low-battery", name, f"{name} has {uav.battery:.1f} % left")

    def _silence(self) -> None:
        """Which of the UAVs at work has not been heard for too long."""
        if self._now == -np.inf:
            return
        for address in self._held:
            uav, patience = self.uavs[address], self._law.patience
            if uav.time == -np.inf:
                uav.time = self._now  # it was selected before anybody was heard
            if self._now - uav.time <= patience:
                self._said.silent.discard(address)
            elif address not in self._said.silent:
                self._said.silent.add(address)
                name = self.name(address)
                self.alert("silent-uav", name, f"{name} has not been heard for more than {patience:g} s")

    def judge(self, since_block: float, since_beacon: float) -> None:
        """Look whether the chain stands still, or all UAVs are silent.

        Args:
            since_block, since_beacon: how long ago the last was heard of, by the onlooker's own clock [s].
        """
        step, said = self.step + 1, self._said
        if step <= 0 or step >= self._flight.steps:
            return
        # Between two periods all wait for the chain; and where they do not, a period has passed without a block.
        waits = step % self._period == 0 and min(since_block, since_beacon) > NO_BLOCK
        passed = self.clock - self._mined > self._period * self._law.seconds + self._law.patience
        if (waits or (np.isfinite(self._mined) and passed)) and not said.no_block:
            said.no_block = True
            self.alert("no-quorum", "", "no block though a period has begun: the validators may have no quorum")
        quiet = step % self._period != 0 and since_beacon > self._law.patience
        if quiet and not said.all_silent:
            self.alert("silent-uav", "", f"no UAV has been heard for {self._law.patience:g} s")
        said.all_silent = quiet

    # The record

    def record(self, *, ahead: bool = False) -> Record:
        """The newest step, with the events and alerts that have come since the last record.

        Args:
            ahead: also with the events of the step that has not begun, and then as that step's.
        """
        until = max(self._latest, self.step + ahead)
        events = []
        while self._events and self._events[0][0] <= until:
            step, event = self._events.popleft()
            self._latest = max(self._latest, step)
            self._learn(step, event)
            events.append(feed.Event(event.block, event.name, feed.arguments_of(event.args, self._names)))
        self._silence()
        alerts = list(self._alerts)
        self._alerts.clear()
        self._latest = max(self._latest, self.step)
        return Record(
            step=self._latest,
            vehicles=self._vehicles()[: feed.MAX_VEHICLES],
            uavs=self._uavs()[: feed.MAX_UAVS],
            events=events[-feed.MAX_EVENTS :],
            alerts=alerts,
        )

    def _vehicles(self) -> list[feed.Vehicle]:
        owner = {vehicle: uav for uav, vehicles in self._held.items() for vehicle in vehicles}
        served, rows = [], []
        for address, vehicle in self.vehicles.items():
            uav = owner.get(address)
            if vehicle.position is None or not self._there(vehicle, uav is not None):
                continue
            air = None if uav is None else self.uavs[uav].position
            served.append((vehicle.position, air))
            rows.append((self.name(address), *vehicle.position, "" if uav is None else self.name(uav)))
        covered = self._covered(served)
        return [feed.Vehicle(*row, covered=near) for row, near in zip(rows, covered.tolist(), strict=True)]

    def _there(self, vehicle: _Member, is_served: bool) -> bool:
        """A served vehicle sends beacons; of any other there is what it told the chain."""
        if is_served and vehicle.heard and vehicle.time > vehicle.told * self._law.seconds:
            return self._now - vehicle.time <= self._law.patience
        return self.step - vehicle.told <= KEPT_PERIODS * self._period

    def _covered(self, pairs: list[tuple[tuple[float, float], tuple[float, float] | None]]) -> npt.NDArray[np.bool_]:
        """Of each vehicle's position and its UAV's, whether they are in range and in sight."""
        near = np.zeros(len(pairs), dtype=bool)
        rows = [row for row, (_, air) in enumerate(pairs) if air is not None]
        if rows:
            ground, air = np.array([pairs[row][0] for row in rows]), np.array([pairs[row][1] for row in rows])
            near[rows] = in_range(air, ground, self._law.reach)
            if self._law.walls is not None:
                near[rows] &= in_sight(ground, air, self._law.walls)
        return near

    def _uavs(self) -> list[feed.Uav]:
        rows = []
        for address, uav in self.uavs.items():
            if uav.position is None:
                continue
            selected = bool(self._held.get(address)) and uav.zone > 0
            age = max(0.0, self._now - uav.time) if uav.zone and uav.heard else None
            rows.append(feed.Uav(self.name(address), *uav.position, uav.zone, uav.battery, selected, age))
        return rows
