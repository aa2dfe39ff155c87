"""What a lock-step world and the hosts of its agents say to each other, as JSON on the bus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrelay.airspace.flight import ACTIONS
from skyrelay.core.errors import BusError
from skyrelay.core.scenario import MAX_CHARGING_POINTS
from skyrelay.pilot.bus import LONGEST_QUESTION
from skyrelay.protocol.messages import Beacon, Fix, Phase, Tick
from skyrelay.protocol.vehicle import Choice

Number = Annotated[float, Field(allow_inf_nan=False)]
Position = tuple[Number, Number]
Address = Annotated[str, Field(pattern=r"^0x[0-9a-f]{40}$")]
Count = Annotated[int, Field(ge=0, le=2**53)]


class _Message(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    def encode(self) -> bytes:
        """As it goes over the bus."""
        return self.model_dump_json().encode()


MessageT = TypeVar("MessageT", bound=_Message)


def decode(kind: type[MessageT], content: bytes) -> MessageT:
    """A message from the bus.

    Raises:
        BusError: it is none of this kind.
    """
    if len(content) > LONGEST_QUESTION:
        raise BusError("bus", f"a message of {len(content)} bytes", f"at most {LONGEST_QUESTION}")
    try:
        return kind.model_validate_json(content)
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(str(part) for part in fault["loc"])
        raise BusError(f"bus: {kind.__name__.lower()}: {place}", fault["input"], fault["msg"]) from None


def topic(beacon: Beacon) -> str:
    """For whom a beacon is: a zone's number, or a UAV's address."""
    return beacon.to or str(beacon.zone)


class FixMessage(_Message):
    """A `Fix`."""

    position: Position | None
    battery: Number
    speed: Number

    @classmethod
    def of(cls, fix: Fix) -> FixMessage:
        """A fix's."""
        return cls(position=fix.position, battery=fix.battery, speed=fix.speed)


class TickMessage(_Message):
    """What it is time for, to one host.

    Attributes:
        phase, period, round, step, time: of the tick.
        sent: how many beacons of this step others have sent on each topic (`topic`).
    """

    phase: str
    period: Count
    round: Count
    step: Count
    time: Number
    sent: dict[str, Count] = {}

    @classmethod
    def of(cls, tick: Tick, sent: Mapping[str, int]) -> TickMessage:
        """A tick's."""
        return cls(
            phase=tick.phase.name,
            period=tick.period,
            round=tick.round,
            step=tick.step,
            time=tick.time,
            sent=dict(sent),
        )

    def tick(self) -> Tick:
        """The tick.

        Raises:
            BusError: there is no such phase.
        """
        if self.phase not in Phase.__members__:
            raise BusError("bus: phase", self.phase, f"one of: {', '.join(Phase.__members__)}")
        return Tick(Phase[self.phase], self.period, self.round, self.step, self.time)


class WhereMessage(_Message):
    """Asks the world where members are.

    Attributes:
        name: of the host that asks.
    """

    name: str
    members: list[Address]


class FixesMessage(_Message):
    """What the receivers of members say.

    Attributes:
        fixes: by address.
        time: by their clock [s since 1970].
        begin: when the run begins, or began, where it goes by that clock [s since 1970].
        peers: on the bus, those that the world is linked to.
    """

    fixes: dict[Address, FixMessage]
    time: Number
    begin: Number | None = None
    peers: Annotated[list[str], Field(max_length=100_000)] = []

    def read(self) -> dict[str, Fix]:
        """The fixes."""
        return _fixes(self.fixes)


class ChoiceMessage(_Message):
    """A `Choice`."""

    uav: Address | None
    qou: Number
    weighed: dict[Address, Number]


class Reply(_Message):
    """What a host did about a tick.

    Attributes:
        moves: actions by the UAVs' addresses.
        choices: what Algorithm 1 gave its vehicles, by address.
        fixes: of its UAVs with an airframe of their own, by address.
        sent: how many beacons it sent on each topic.
        chain_seconds: that it has waited for the chain since it began [s].
    """

    moves: dict[Address, Annotated[int, Field(ge=0, lt=ACTIONS + MAX_CHARGING_POINTS)]] = {}
    choices: dict[Address, ChoiceMessage] = {}
    fixes: dict[Address, FixMessage] = {}
    sent: dict[str, Count] = {}
    chain_seconds: Number = 0.0

    def read_choices(self) -> dict[str, Choice]:
        """The choices."""
        return {address: Choice(c.uav, c.qou, c.weighed) for address, c in self.choices.items()}

    def read_fixes(self) -> dict[str, Fix]:
        """The fixes."""
        return _fixes(self.fixes)


class Report(_Message):
    """What a host has done by itself.

    Attributes:
        name: of the host.
        step: of the tick that it did it at.
    """

    name: str
    step: Count
    reply: Reply


def _fixes(messages: Mapping[str, FixMessage]) -> dict[str, Fix]:
    return {address: Fix(fix.position, fix.battery, fix.speed) for address, fix in messages.items()}
