"""The process sequence (Section "Process Sequence Diagram") as tables of states and messages.

An agent steps by what the contract's events say, never by what it has merely asked for, so that one that is started
again stands where it stood once it has read them. A message that the table does not allow raises, so no transition can
escape it; the diagrams of the docs are drawn from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Generic, TypeVar

from skyrelay.core.errors import ProtocolError


class VehicleState(Enum):
    """Where a vehicle stands in the sequence."""

    NEW = "new"
    IDLE = "registered, no open proposal"
    CHOOSING = "has read its zone's UAVs"
    PROPOSED = "proposal submitted"
    SERVED = "served by a UAV"
    UNSERVED = "not served in this period so far"
    GONE = "left the area"


class VehicleMessage(Enum):
    """What a vehicle sends to the contract or learns from it."""

    REGISTER = "registerVehicle()"
    UPDATE = "updateVehicleInfo()"
    GIVE_UP = "updateVehicleInfo() of another zone"
    READ_ZONE = "getZoneUAV(), getUAVInfo()"
    PROPOSE = "submitVehSelection()"
    ABSTAIN = "no candidate"
    ACCEPTED = "accepted by allocateZone()"
    REJECTED = "rejected by allocateZone()"
    DISPLACED = "displaced by a better proposal, or its UAV has left"
    RESET = "resetListsForZone()"
    LEAVE = "leaves the area"


class UavState(Enum):
    """Where a UAV stands in the sequence."""

    NEW = "new"
    AVAILABLE = "registered, hovering"
    SELECTED = "has vehicles, no policy yet"
    FLYING = "flies the zone's policy"
    CHARGING = "away to be charged"
    RETIRED = "battery spent"


class UavMessage(Enum):
    """What a UAV sends to the contract or the store, or learns from them."""

    REGISTER = "registerUAV()"
    UPDATE = "updateUAVInfo()"
    SELECTED = "selected by allocateZone()"
    UNSELECTED = "no vehicle left"
    MODEL_VERIFIED = "determineMDRLModel(), fetched by CID, hash and card checked"
    RESET = "resetListsForZone()"
    CHARGE = "updateUAVZone(0), where there are charging places"
    RETURN = "updateUAVZone()"
    RETIRE = "updateUAVZone(0)"


class ZoneState(Enum):
    """Where a zone's selection stands."""

    COLLECTING = "proposals are open"
    ALLOCATED = "UAVs have chosen"
    COORDINATING = "a policy is assigned, the team flies"
    RESELECTING = "proposals for what has fallen free are open, the team flies"


class ZoneMessage(Enum):
    """What the zone's coordinator sends to the contract."""

    ALLOCATE = "allocateZone()"
    OPEN_ROUND = "another round of proposals"
    DETERMINE_MODEL = "determineMDRLModel()"
    RESET = "resetListsForZone()"


StateT = TypeVar("StateT", bound=Enum)
MessageT = TypeVar("MessageT", bound=Enum)
Table = Mapping[tuple[StateT, MessageT], StateT]

V, VM = VehicleState, VehicleMessage
VEHICLE: Table[VehicleState, VehicleMessage] = {
    (V.NEW, VM.REGISTER): V.IDLE,
    (V.IDLE, VM.UPDATE): V.IDLE,
    (V.IDLE, VM.READ_ZONE): V.CHOOSING,
    (V.CHOOSING, VM.UPDATE): V.CHOOSING,
    (V.CHOOSING, VM.PROPOSE): V.PROPOSED,
    (V.CHOOSING, VM.ABSTAIN): V.UNSERVED,
    (V.PROPOSED, VM.ACCEPTED): V.SERVED,
    (V.PROPOSED, VM.REJECTED): V.UNSERVED,
    (V.SERVED, VM.DISPLACED): V.UNSERVED,
    (V.PROPOSED, VM.GIVE_UP): V.UNSERVED,
    (V.SERVED, VM.GIVE_UP): V.UNSERVED,
    (V.UNSERVED, VM.READ_ZONE): V.CHOOSING,
    (V.IDLE, VM.RESET): V.IDLE,
    (V.PROPOSED, VM.RESET): V.IDLE,
    (V.SERVED, VM.RESET): V.IDLE,
    (V.UNSERVED, VM.RESET): V.IDLE,
    (V.IDLE, VM.LEAVE): V.GONE,
    (V.PROPOSED, VM.LEAVE): V.GONE,
    (V.SERVED, VM.LEAVE): V.GONE,
    (V.UNSERVED, VM.LEAVE): V.GONE,
    (V.GONE, VM.RESET): V.GONE,
    (V.GONE, VM.UPDATE): V.IDLE,
}

U, UM = UavState, UavMessage
UAV: Table[UavState, UavMessage] = {
    (U.NEW, UM.REGISTER): U.AVAILABLE,
    (U.AVAILABLE, UM.UPDATE): U.AVAILABLE,
    (U.AVAILABLE, UM.SELECTED): U.SELECTED,
    (U.SELECTED, UM.SELECTED): U.SELECTED,
    (U.SELECTED, UM.UNSELECTED): U.AVAILABLE,
    (U.SELECTED, UM.UPDATE): U.SELECTED,
    (U.SELECTED, UM.MODEL_VERIFIED): U.FLYING,
    (U.FLYING, UM.UPDATE): U.FLYING,
    (U.FLYING, UM.SELECTED): U.FLYING,
    (U.FLYING, UM.UNSELECTED): U.AVAILABLE,
    (U.AVAILABLE, UM.RESET): U.AVAILABLE,
    (U.SELECTED, UM.RESET): U.AVAILABLE,
    (U.FLYING, UM.RESET): U.AVAILABLE,
    (U.AVAILABLE, UM.CHARGE): U.CHARGING,
    (U.SELECTED, UM.CHARGE): U.CHARGING,
    (U.FLYING, UM.CHARGE): U.CHARGING,
    (U.CHARGING, UM.UPDATE): U.CHARGING,
    (U.CHARGING, UM.RESET): U.CHARGING,
    (U.CHARGING, UM.RETURN): U.AVAILABLE,
    (U.AVAILABLE, UM.RETIRE): U.RETIRED,
    (U.SELECTED, UM.RETIRE): U.RETIRED,
    (U.FLYING, UM.RETIRE): U.RETIRED,
    (U.RETIRED, UM.RESET): U.RETIRED,
}

Z, ZM = ZoneState, ZoneMessage
ZONE: Table[ZoneState, ZoneMessage] = {
    (Z.COLLECTING, ZM.ALLOCATE): Z.ALLOCATED,
    (Z.ALLOCATED, ZM.OPEN_ROUND): Z.COLLECTING,
    (Z.ALLOCATED, ZM.DETERMINE_MODEL): Z.COORDINATING,
    (Z.ALLOCATED, ZM.RESET): Z.COLLECTING,
    (Z.COORDINATING, ZM.OPEN_ROUND): Z.RESELECTING,
    (Z.COORDINATING, ZM.RESET): Z.COLLECTING,
    (Z.RESELECTING, ZM.ALLOCATE): Z.COORDINATING,
    (Z.RESELECTING, ZM.RESET): Z.COLLECTING,
}


class Machine(Generic[StateT, MessageT]):
    """One member's place in its table."""

    def __init__(self, name: str, table: Table[StateT, MessageT], start: StateT) -> None:
        self.name = name
        self.state = start
        self._table = table

    def allows(self, message: MessageT) -> bool:
        """Whether the table has such a step from the present state."""
        return (self.state, message) in self._table

    def advance(self, message: MessageT) -> None:
        """Follow one message.

        Raises:
            ProtocolError: the table has no such step from the present state; nothing has changed.
        """
        step = self._table.get((self.state, message))
        if step is None:
            allowed = ", ".join(m.value for (state, m) in self._table if state is self.state) or "nothing"
            raise ProtocolError(f"{self.name} ({self.state.value})", message.value, f"one of: {allowed}")
        self.state = step


def to_mermaid(table: Table[StateT, MessageT], start: StateT) -> str:
    """The table as a Mermaid state diagram, for the docs."""
    lines = ["stateDiagram-v2", f"    [*] --> {start.name}"]
    lines += [f"    {state.name} --> {step.name}: {message.value}" for (state, message), step in table.items()]
    return "\n".join(lines) + "\n"
