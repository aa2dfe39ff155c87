"""The live feed: what a control room is told of a fleet, step by step, as JSON texts.

One `Header` comes first, then one `Record` for each step, in the order of the steps. Rows are lists and not objects: a
city's 10,000 vehicles stay under half a megabyte a step.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import AsyncIterator, Iterable, Mapping
from dataclasses import asdict
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrelay.core.errors import RunFolderError
from skyrelay.core.resolved import charging_points
from skyrelay.core.scenario import Scenario
from skyrelay.core.untrusted import parse_json
from skyrelay.core.zones import ZoneGrid
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

PAD = 25.0
"""As large a charging place on the ground is drawn [m]."""
LOW_BATTERY = 2.0
"""A battery that is at most so much above the reserve is low [%]."""


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


AlertKind = Literal["late-allocation", "silent-uav", "low-battery", "no-quorum", "other"]


class Alert(NamedTuple):
    """What somebody should look at: the member or zone it is about ("" for the whole), and one line of text."""

    kind: AlertKind
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
        places: whether UAVs land there: one without a zone is away to be charged.
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
    places: bool = False
    buildings: Annotated[list[Building], Field(max_length=MAX_POINTS)] = []
    streets: Annotated[list[Line], Field(max_length=MAX_POINTS)] = []


class Record(BaseModel):
    """One step; a second one of the same step has what came to be known of it since."""

    model_config = ConfigDict(frozen=True)

    step: Annotated[int, Field(ge=0, le=2**31 - 1)]
    vehicles: Annotated[list[Vehicle], Field(max_length=MAX_VEHICLES)]
    uavs: Annotated[list[Uav], Field(max_length=MAX_UAVS)]
    events: Annotated[list[Event], Field(max_length=MAX_EVENTS)] = []
    alerts: Annotated[list[Alert], Field(max_length=MAX_EVENTS)] = []


Feed = AsyncIterator[Header | Record]
"""One header, then a record for each step in their order; a header in between begins another session."""


def header_of(
    scenario: Scenario, grid: ZoneGrid, range_m: float, streets: Iterable[npt.NDArray[np.float64]] = ()
) -> Header:
    """The header of a scenario in its area, of a session of its own.

    Args:
        range_m: of the links, which a scenario may leave open [m].
        streets: each [P, 2] [m].
    """
    flight, energy = scenario.coordination, scenario.energy
    offset = np.array(energy.charging_point) * grid.side
    points = [np.array(grid.corner(zone)) + offset for zone in grid.ids] if energy.charge_per_minute else []
    charging = [(float(x), float(y), energy.charging_radius) for x, y in points]
    places = [(place.x, place.y, PAD) for place in charging_points(scenario, grid)]
    return Header(
        session=secrets.token_hex(8),
        name=scenario.name,
        step_seconds=flight.step_seconds,
        period_steps=flight.period_steps,
        range_m=range_m,
        reserve=energy.reserve,
        grid=Grid(**asdict(grid)),
        charging=places or charging,
        places=bool(places),
        buildings=[
            Building([value for corner in building.polygon for value in corner], building.height)
            for building in scenario.obstacles.buildings
        ],
        streets=[line.ravel().tolist() for line in streets],
    )


def arguments_of(arguments: Mapping[str, Any], names: Mapping[str, str]) -> list[str]:
    """An event's arguments as text: name, value, name, value...; an account is called by its name."""
    return [part for name, value in arguments.items() for part in (name, _text(value, names))]


def _text(value: Any, names: Mapping[str, str]) -> str:
    if isinstance(value, str):
        return names.get(value, value)
    if isinstance(value, list | tuple):
        return ", ".join(_text(item, names) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{name} {_text(item, names)}" for name, item in value.items())
    return json.dumps(value)


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
