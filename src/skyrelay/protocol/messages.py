"""What an agent is told, and what it wants done: all that passes between an agent and the world.

An agent does nothing itself. Whoever hosts it hands it messages and carries out the commands that it answers with, in
one process or on several hosts (`skyrelay.protocol.host`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from skyrelay.airspace.law import Law
from skyrelay.airspace.sight import Sight
from skyrelay.chain.abi import ContractError, Event
from skyrelay.chain.client import Model, UavRecord, VehicleRecord
from skyrelay.protocol.rule import Decider
from skyrelay.protocol.zone_view import ZoneView
from skyrelay.store.cid import Cid


class Phase(Enum):
    """What it is time for; in a period in this order, the last three once for each of its steps.

    Those of `RESELECTION` stand within a period.
    """

    JOIN = "UAVs that are not registered do so"
    CLOSE = "the coordinators end the period before"
    REPORT = "everyone tells the contract where it is"
    DISPATCH = "UAVs go where bandwidth lacks, to be charged, and back, as the scenario has it"
    RATE = "the consortium's authority gives new members their reputation"
    PROPOSE = "vehicles without a UAV propose; once a round"
    ALLOCATE = "the coordinators have the proposals decided; once a round"
    DETERMINE = "the coordinators ask for each team's policy"
    LEAVE = "within a period: vehicles whose trip is over give their UAV up, those that came register"
    RESELECT = "within a period: UAVs with room for somebody tell the contract where they are; new members are rated"
    BEACON = "everyone tells those around where it is"
    DECIDE = "UAVs choose their moves"
    LAND = "UAVs whose battery lasts no longer leave"


RESELECTION = (Phase.LEAVE, Phase.RESELECT, Phase.PROPOSE, Phase.ALLOCATE, Phase.DETERMINE)
"""A selection again within a period, of those alone that have no UAV."""


# Messages


@dataclass(frozen=True, slots=True)
class Tick:
    """The clock.

    Attributes:
        phase: what it is time for.
        period, round, step: counted from 0, from 1, from 0.
        time: since the run's start [s].
    """

    phase: Phase
    period: int = 0
    round: int = 1
    step: int = 0
    time: float = 0.0


@dataclass(frozen=True, slots=True)
class Fix:
    """What the member's own receiver says.

    Attributes:
        position: [m]; None outside the area.
        battery: of a UAV [0-100].
        speed: [m/s].
    """

    position: tuple[float, float] | None
    battery: float = 0.0
    speed: float = 0.0


@dataclass(frozen=True, slots=True)
class Beacon:
    """Where a member is, as it tells those around.

    Attributes:
        sender: its address.
        zone: a UAV's, and that of a vehicle's UAV.
        to: the UAV that serves the vehicle; None for a UAV, or a vehicle without one: these tell their zone.
        position: [m]; None from a vehicle that has left the area.
        time: when it was there [s].
        speed: [m/s].
        battery: of a UAV [0-100].
        asks: what a vehicle asks for [kbit/s]; 0 of a UAV.
    """

    sender: str
    zone: int
    to: str | None
    position: tuple[float, float] | None
    time: float
    speed: float = 0.0
    battery: float = 0.0
    asks: float = 0.0


@dataclass(frozen=True, slots=True)
class Advised:
    """The UAV that a method outside of the contract gives a vehicle in this period; None for none.

    Only who selects by such a method (`selection.method`) hears it: Algorithm 1 asks nobody.
    """

    uav: str | None


@dataclass(frozen=True, slots=True)
class ZoneRead:
    """Answers `ReadZone`; None of a zone that no UAV ever entered."""

    view: ZoneView | None


@dataclass(frozen=True, slots=True)
class StationRead:
    """Answers `ReadStation`: the zone that the UAV goes to, 0 to be charged; None where it stays."""

    zone: int | None


@dataclass(frozen=True, slots=True)
class ModelRead:
    """Answers `ReadModel`: the model as the contract has it."""

    model: Model


@dataclass(frozen=True, slots=True)
class ModelFetched:
    """Answers `FetchModel`: the model's bytes, which the store has hashed again."""

    cid: Cid
    content: bytes


@dataclass(frozen=True, slots=True)
class Decided:
    """Answers `Decide`: the action, 0 to 8."""

    action: int


@dataclass(frozen=True, slots=True)
class Mined:
    """A call of the agent is in a block; its events came before."""

    call: ChainCall | Offer


@dataclass(frozen=True, slots=True)
class Refused:
    """The contract refused a call of the agent."""

    call: ChainCall
    error: ContractError


@dataclass(frozen=True, slots=True)
class LeftOut:
    """What the agent signed is not on the chain: the relayer did not hand it in, or the contract passed it over."""

    call: Offer


Message: TypeAlias = (
    Tick
    | Fix
    | Advised
    | Event
    | Beacon
    | ZoneRead
    | StationRead
    | ModelRead
    | ModelFetched
    | Decided
    | Mined
    | Refused
    | LeftOut
)


# Commands: calls of the contract


@dataclass(frozen=True, slots=True)
class RegisterVehicle:
    """registerVehicle()."""

    record: VehicleRecord


@dataclass(frozen=True, slots=True)
class UpdateVehicle:
    """updateVehicleInfo()."""

    record: VehicleRecord


@dataclass(frozen=True, slots=True)
class Propose:
    """submitVehSelection() to a UAV, for a demand [kbit/s] in a round of its zone."""

    uav: str
    demand: int
    round: int


@dataclass(frozen=True, slots=True)
class Offer:
    """A proposal that the vehicle signs together with its record, for a relayer to hand in: submitSigned()."""

    proposal: Propose
    record: VehicleRecord


@dataclass(frozen=True, slots=True)
class RegisterUav:
    """registerUAV()."""

    record: UavRecord


@dataclass(frozen=True, slots=True)
class UpdateUav:
    """updateUAVInfo()."""

    record: UavRecord


@dataclass(frozen=True, slots=True)
class ChangeZone:
    """updateUAVZone(): it flies in another zone from now on; in 0 it has left."""

    zone: int


@dataclass(frozen=True, slots=True)
class AllocateZone:
    """allocateZone(): the next piece of Algorithm 2, of about so many proposals."""

    zone: int
    proposals: int


@dataclass(frozen=True, slots=True)
class DetermineModel:
    """determineMDRLModel()."""

    zone: int


@dataclass(frozen=True, slots=True)
class ResetZone:
    """resetListsForZone()."""

    zone: int


@dataclass(frozen=True, slots=True)
class SetReputations:
    """setReputations() of members [0-100], by address."""

    reputations: dict[str, float]


ChainCall: TypeAlias = (
    RegisterVehicle
    | UpdateVehicle
    | Propose
    | RegisterUav
    | UpdateUav
    | ChangeZone
    | AllocateZone
    | DetermineModel
    | ResetZone
    | SetReputations
)


# Commands: the rest


@dataclass(frozen=True, slots=True)
class ReadZone:
    """getZoneUAV() and getUAVInfo() of a zone."""

    zone: int


@dataclass(frozen=True, slots=True)
class ReadStation:
    """Where the UAV goes by `skyrelay.protocol.rotation`: worked out by the host for all its UAVs at once."""

    law: Law


@dataclass(frozen=True, slots=True)
class ReadModel:
    """getModel()."""

    model: str


@dataclass(frozen=True, slots=True)
class FetchModel:
    """A model's bytes from the store."""

    cid: Cid


@dataclass(frozen=True, slots=True)
class SendBeacon:
    """A beacon to those around."""

    beacon: Beacon


@dataclass(frozen=True, slots=True)
class Decide:
    """What the policy, or the rule, answers to what the UAV sees."""

    policy: Decider
    sight: Sight


@dataclass(frozen=True, slots=True)
class Move:
    """Fly one step: 0 stays, 1 to 8 are the headings, from 9 on straight to a charging point, to land there."""

    action: int


Command: TypeAlias = ChainCall | Offer | ReadZone | ReadStation | ReadModel | FetchModel | SendBeacon | Decide | Move
