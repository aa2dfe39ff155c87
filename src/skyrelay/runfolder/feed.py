"""The live feed: what a control room is told of a fleet, step by step, as JSON texts.

One `Header` comes first, then one `Record` for each step, in the order of the steps; agents publish the same texts on
the bus under `live_key`. Rows are lists and not objects: a
city's 10,000 vehicles stay under half a megabyte a step.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrelay.core.errors import RunFolderError
from skyrelay.core.untrusted import parse_json
from skyrelay.runfolder.schema import Grid, Measure, Positive, Text

LONGEST_MESSAGE = 16 * 2**20
"""Bytes of a header or record; longer ones are neither sent nor taken."""
MAX_VEHICLES = 100_000
MAX_UAVS = 10_000
MAX_EVENTS = 10_000
MAX_POINTS = 500_000
"""Of all streets together, and of all buildings."""

Id = Annotated[str, Field(min_length=1, max_length=256)]
Line = Annotated[list[Measure], Field(max_length=MAX_POINTS)]
"""x, y, x, y... [m]."""


def live_key(contract: str, kind: str = "*") -> str:
    """Where the feed is published on the bus: ``header`` or ``record``; the default is both."""
    return f"skyrelay/{contract}/live/{kind}"


class Vehicle(NamedTuple):
    """A connected vehicle at a step: position [m], the UAV that serves it ("" where none does), in its range."""

    id: Id
    x: Measure
    y: Measure
    uav: Annotated[str, Field(max_length=256)] = ""
    covered: bool = False


class Uav(NamedTuple):
    """A UAV at a step.

    Position [m]; its zone, 0 for one that has landed; battery [%]; whether it was selected; and how old the news of it
    is [s], None where it is not known.
    """

    id: Id
    x: Measure
    y: Measure
    zone: Annotated[int, Field(ge=0, le=1_000_000)]
    battery: Measure
    selected: bool
    age: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None


class Event(NamedTuple):
    """An event of the contract: its block, its name, and its arguments as name, value, name, value..."""

    block: Annotated[int, Field(ge=0)]
    name: Annotated[str, Field(max_length=100)]
    arguments: Annotated[list[Annotated[str, Field(max_length=100_000)]], Field(max_length=100)]


class Alert(NamedTuple):
    """What somebody should look at: the member or zone it is about ("" for the whole), and one line of text."""

    kind: Literal["late-allocation", "silent-uav", "low-battery", "no-quorum", "other"]
    about: Annotated[str, Field(max_length=256)]
    text: Annotated[str, Field(max_length=500)]


class Building(NamedTuple):
    """Corners x, y, x, y... [m] and height [m]."""

    corners: Line
    height: Positive


class Header(BaseModel):
    """What stays the same over a feed.

    Attributes:
        session: the same as long as steps count on from one another; another one starts the page afresh.
        reserve: at or below it a UAV leaves [%].
        charging: x, y, radius of each charging point [m].
        streets: each a line [m].
    """

    model_config = ConfigDict(frozen=True)

    format: Literal["skyrelay-live-1"] = "skyrelay-live-1"
    session: Annotated[str, Field(min_length=1, max_length=100)]
    name: Text
    step_seconds: Positive
    period_steps: Annotated[int, Field(ge=1)]
    range_m: Positive
    reserve: Annotated[float, Field(ge=0, le=100)] = 0.0
    grid: Grid
    charging: Annotated[list[tuple[Measure, Measure, Positive]], Field(max_length=10_000)] = []
    buildings: Annotated[list[Building], Field(max_length=MAX_POINTS)] = []
    streets: Annotated[list[Line], Field(max_length=MAX_POINTS)] = []


class Record(BaseModel):
    """One step."""

    model_config = ConfigDict(frozen=True)

    step: Annotated[int, Field(ge=0, le=2**31 - 1)]
    vehicles: Annotated[list[Vehicle], Field(max_length=MAX_VEHICLES)]
    uavs: Annotated[list[Uav], Field(max_length=MAX_UAVS)]
    events: Annotated[list[Event], Field(max_length=MAX_EVENTS)] = []
    alerts: Annotated[list[Alert], Field(max_length=MAX_EVENTS)] = []


def read_header(message: bytes | str) -> Header:
    """A header that came from outside.

    Raises:
        RunFolderError: it is too long or deep, no JSON, or a key or value does not fit.
    """
    return _read(message, Header)


def read_record(message: bytes | str) -> Record:
    """A record that came from outside.

    Raises:
        RunFolderError: as `read_header`.
    """
    return _read(message, Record)


_Message = TypeVar("_Message", bound=BaseModel)


def _read(message: bytes | str, kind: type[_Message]) -> _Message:
    place = f"live feed: {kind.__name__.lower()}"
    try:
        parse_json(message, size=LONGEST_MESSAGE, depth=8)
        return kind.model_validate_json(message, strict=True)  # strict in JSON's own types: true is no number
    except ValidationError as error:
        fault = error.errors()[0]
        at = ".".join(map(str, fault["loc"]))
        raise RunFolderError(
            f"{place}: {at}" if at else place, fault["input"], fault["msg"].removeprefix("Input should be ")
        ) from None
    except ValueError as error:
        raise RunFolderError(place, None, f"JSON ({error})") from error
