"""The zone coordinator: has proposals decided every period, asks for the policy, and closes the period."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from skyrelay.chain.abi import Event
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.messages import (
    AllocateZone,
    Command,
    DetermineModel,
    Message,
    Mined,
    Phase,
    Refused,
    ResetZone,
    Tick,
)
from skyrelay.protocol.sequence import ZONE, Machine, ZoneMessage, ZoneState


class ZoneCoordinator(Agent):
    """The coordinator of one zone.

    Args:
        zone: its id.
        address: an account with the coordinator's role.
        proposals_per_call: largest piece of an allocation in one transaction [proposals].
    """

    HEARS: ClassVar[frozenset[str]] = frozenset(
        {"VehSelectionSubmitted", "UAVAllocated", "ZoneAllocated", "UAVZoneUpdated", "ModelAssigned", "ZoneListsReset"}
    )

    def __init__(self, zone: int, address: str, proposals_per_call: int) -> None:
        super().__init__(f"coordinator of zone {zone}", address)
        self.zone = zone
        self.machine = Machine(f"zone {zone}", ZONE, ZoneState.COLLECTING)
        self._piece = proposals_per_call
        self._undecided = False
        self._team: set[str] = set()
        self._tried: set[str] = set()  # what it has done after its time in this period, each once

    @property
    def state(self) -> ZoneState:
        """Where the zone stands in the sequence."""
        return self.machine.state

    def undone(self, phase: Phase) -> bool:
        """See `Agent.undone`; by the contract's events, whoever it was that acted."""
        match phase:
            case Phase.CLOSE | Phase.REPORT | Phase.RATE:
                return self.state is not ZoneState.COLLECTING
            case Phase.ALLOCATE:
                return self._undecided
            case Phase.DETERMINE:
                return self._lacks_model or self._is_late("allocate")
            case Phase.BEACON:
                return self._is_late("allocate") or self._is_late("determine")
        return False

    @property
    def _lacks_model(self) -> bool:
        return self.state is ZoneState.ALLOCATED and bool(self._team)

    def _is_late(self, what: str) -> bool:
        """Whether it has yet to do something whose time is over, as when it was away then."""
        left = self.undone(Phase.ALLOCATE) if what == "allocate" else self._lacks_model
        return left and what not in self._tried

    def receive(self, message: Message) -> Sequence[Command]:
        """Take a message; see `Agent.receive`."""
        match message:
            case Tick():
                return self._at(message)
            case Event():
                self._hear(message)
            case Mined(AllocateZone()):
                self._answered(message)
                return self._allocate()
            case Mined() | Refused():
                self._answered(message)
        return ()

    def _at(self, tick: Tick) -> Sequence[Command]:
        if not self.undone(tick.phase):
            return ()
        match tick.phase:
            case Phase.CLOSE | Phase.REPORT | Phase.RATE:  # late, where the first did not come
                return self._call(ResetZone(self.zone))
            case Phase.ALLOCATE:
                return self._allocate()
        if self._is_late("allocate"):
            self._tried.add("allocate")
            return self._allocate()
        self._tried.add("determine")
        return self._call(DetermineModel(self.zone))

    def _allocate(self) -> Sequence[Command]:
        """The next piece of Algorithm 2, until every proposal is decided."""
        return self._call(AllocateZone(self.zone, self._piece)) if self._undecided else ()

    def _hear(self, event: Event) -> None:
        args = event.args
        match event.name:
            case "UAVZoneUpdated" if args["from"] == self.zone:
                self._team.discard(args["uav"])
            case _ if args.get("zone") != self.zone:
                return
            case "VehSelectionSubmitted":
                if self.machine.allows(ZoneMessage.OPEN_ROUND) and not self._undecided:
                    self.machine.advance(ZoneMessage.OPEN_ROUND)
                self._undecided = True
            case "UAVAllocated":
                (self._team.add if args["selected"] else self._team.discard)(args["uav"])
            case "ZoneAllocated":
                # Where two coordinate, the second of two calls finds nothing left to decide, and says so once more.
                if self.machine.allows(ZoneMessage.ALLOCATE):
                    self.machine.advance(ZoneMessage.ALLOCATE)
                self._undecided = False
            case "ModelAssigned" if self.machine.allows(ZoneMessage.DETERMINE_MODEL):
                self.machine.advance(ZoneMessage.DETERMINE_MODEL)
            case "ZoneListsReset":
                if self.machine.allows(ZoneMessage.RESET):
                    self.machine.advance(ZoneMessage.RESET)
                self._undecided = False
                self._team.clear()
                self._tried.clear()
