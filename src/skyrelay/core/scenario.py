"""The scenario file (TOML): every default and every unit of a run stands here, and only here."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from skyrelay.core.errors import ScenarioError
from skyrelay.core.untrusted import read_json

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Percent = Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]


def _ordered(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ValueError("the lower bound first, then the upper")
    return bounds


def _ring(corners: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Counter-clockwise and open, whichever way it was given."""
    if len(corners) > 1 and corners[0] == corners[-1]:
        corners = corners[:-1]
    area = sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True))
    if len(corners) < 3 or area == 0:
        raise ValueError("at least three corners that are not in one line")
    return corners if area > 0 else corners[::-1]


def read_buildings(path: Path) -> list[dict[str, Any]]:
    """The polygons of a GeoJSON file, each with its property ``height``; coordinates are metres of the run's area.

    Raises:
        ValueError: naming what was expected of the file.
    """
    try:
        tree = read_json(path)
    except OSError as error:
        raise ValueError(f"a readable GeoJSON file ({error.strerror})") from error
    except ValueError as error:
        raise ValueError(f"a GeoJSON file ({error})") from error
    buildings = []
    try:
        for number, feature in enumerate(tree["features"]):
            geometry, height = feature["geometry"], feature["properties"]["height"]
            if geometry["type"] != "Polygon" or len(geometry["coordinates"]) != 1:
                raise ValueError(f"in features[{number}] a Polygon of one ring (no courtyards)")
            buildings.append({"polygon": geometry["coordinates"][0], "height": height})
    except (KeyError, TypeError) as error:
        raise ValueError("a GeoJSON FeatureCollection, each feature with a geometry and a property height") from error
    return buildings


def _sums_to_one(weights: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if not math.isclose(sum(weights), 1.0, abs_tol=1e-9):
        raise ValueError(f"four weights that sum to 1 (these sum to {sum(weights):g})")
    return weights


Bounds = Annotated[
    tuple[Annotated[float, Field(ge=0, allow_inf_nan=False)], Annotated[float, Field(ge=0, allow_inf_nan=False)]],
    AfterValidator(_ordered),
]
PercentBounds = Annotated[tuple[Percent, Percent], AfterValidator(_ordered)]
Weights = Annotated[tuple[Share, Share, Share, Share], AfterValidator(_sums_to_one)]


class _Section(BaseModel):
    """A frozen table of the scenario file; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Mobility(_Section):
    """Where the vehicles are."""

    source: Literal["trace", "manhattan", "random-waypoint"] = Field(
        "trace", description="replay of floating-car data, or a synthetic model"
    )
    trace: str = Field("bologna", min_length=1, description="a built-in trace, or a Parquet, CSV or XML file")
    penetration: Annotated[float, Field(gt=0, le=1)] = Field(0.2, description="share of the trace's vehicles connected")
    start: Annotated[float, Field(ge=0, allow_inf_nan=False)] = Field(
        0.0, description="where in the trace to begin [s after its first sample]"
    )
    units: Literal["auto", "m", "km", "ft", "degrees"] = Field(
        "auto",
        description="of the trace's positions; auto: metres, or degrees where columns, format or speeds say so",
    )
    time_unit: Literal["s", "ms", "us", "ns"] = Field("s", description="of the trace's times where they are numbers")
    max_gap: Annotated[float, Field(gt=0, le=86_400)] = Field(
        30.0, description="between samples further apart a vehicle is absent [s]"
    )
    lost_fixes: Literal["refuse", "drop"] = Field(
        "refuse", description="single samples at places that the vehicle cannot have reached"
    )
    vehicles: Annotated[int, Field(ge=1, le=1_000_000)] = Field(200, description="synthetic models: how many vehicles")
    area: Positive = Field(6000.0, description="synthetic models: side of the square area [m]")
    speed: Bounds = Field((4.5, 15.0), description="synthetic models: vehicle speed, uniform between [m/s]")
    turn_probability: Share = Field(0.5, description="manhattan: probability of a turn at a step")


class Zones(_Section):
    """A grid of equal squares over the area."""

    columns: Annotated[int, Field(ge=1, le=1000)] = Field(3, description="from west to east")
    rows: Annotated[int, Field(ge=1, le=1000)] = Field(3, description="from south to north")


class Fleet(_Section):
    """The UAVs: how many, and what they draw (Table "Simulation Setup")."""

    uavs: Annotated[int, Field(ge=1)] = Field(40, description="how many, over all zones")
    range: Positive | None = Field(
        None, description="of the UAV-vehicle and the UAV-UAV link [m]; left out: half a zone's side"
    )
    speed: Positive = Field(30.0, description="[m/s]")
    altitude: Annotated[float, Field(ge=0, le=65535)] = Field(100.0, description="[m]; ranges are horizontal")
    bandwidth: Bounds = Field((0.0, 20.0), description="available bandwidth, uniform between [Mbit/s]")
    battery: PercentBounds = Field((1.0, 100.0), description="at the start, uniform between [%]")
    reputation: PercentBounds = Field((1.0, 100.0), description="uniform between [0-100]")


class Demand(_Section):
    """What vehicles ask for and offer (Table "Simulation Setup")."""

    bandwidth: Bounds = Field((1.0, 4.0), description="requested bandwidth, uniform between [Mbit/s]")
    payment: Bounds = Field((0.0, 700.0), description="uniform between [cents per Mbit/s]")
    reputation: PercentBounds = Field((1.0, 100.0), description="uniform between [0-100]")


class Selection(_Section):
    """QoU, QoV (Eq. 1, 2) and the two algorithms."""

    qou_weights: Weights = Field((0.25, 0.25, 0.25, 0.25), description="bandwidth, battery, reputation, closeness")
    qov_weights: Weights = Field((0.25, 0.25, 0.25, 0.25), description="demand, payment, reputation, closeness")
    max_distance: Positive = Field(
        3000.0, description="of a candidate, and what distances are divided by; a run caps it at fleet.range [m]"
    )
    max_uav_bandwidth: Positive = Field(20.0, description="Max AB [Mbit/s]")
    max_demand: Positive = Field(4.0, description="Max RB [Mbit/s]")
    max_payment: Positive = Field(700.0, description="Max PayPerMbps [cents per Mbit/s]")
    candidates: Literal["range", "zone"] = Field(
        "range", description="range: the zone's UAVs within max_distance; zone: all of them"
    )
    rounds: Annotated[int, Field(ge=1, le=1000)] = Field(
        1, description="1: the paper; more: a rejected vehicle proposes again, up to deferred acceptance"
    )
    hysteresis: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)] = Field(
        0.0, description="a vehicle leaves the UAV that served it only for one with so many more points of QoU"
    )


class Coordination(_Section):
    """How the selected UAVs fly."""

    steps: Annotated[int, Field(ge=1)] = Field(100, description="moves of every UAV in the run")
    step_seconds: Positive = Field(2.0, description="[s]")
    period_steps: Annotated[int, Field(ge=1)] = Field(20, description="moves between two selections")
    policy: str = Field("auto", min_length=1, description="auto: the shipped policies; or the path of an ONNX file")
    patience: Positive = Field(10.0, description="a team mate or vehicle whose last beacon is older counts as gone [s]")


class Energy(_Section):
    """What flying costs (a battery of 100 % empties in 25 minutes of hovering by default)."""

    model: Literal["linear", "rotary-wing"] = Field(
        "linear", description="linear: by the two rates below; rotary-wing: power by speed (Zeng et al. 2019)"
    )
    battery: Annotated[float, Field(ge=1, le=1e6, allow_inf_nan=False)] = Field(
        70.0, description="rotary-wing: what a full battery holds [Wh]"
    )
    hover_per_minute: Annotated[float, Field(ge=0, allow_inf_nan=False)] = Field(
        4.0, description="linear: [% of the battery]"
    )
    move_per_minute: Annotated[float, Field(ge=0, allow_inf_nan=False)] = Field(
        5.0, description="linear: [% of the battery]"
    )
    reserve: Percent = Field(3.0, description="at or below it a UAV leaves, and selection replaces it [%]")
    charge_per_minute: Annotated[float, Field(ge=0, allow_inf_nan=False)] = Field(
        0.0, description="what hovering at its zone's charging point gives; 0: there are none [% of the battery]"
    )
    charging_point: tuple[Share, Share] = Field(
        (0.5, 0.5), description="of every zone, from its south-west corner [zone sides]"
    )
    charging_radius: Positive = Field(100.0, description="within which a UAV is charged [m]")


Coordinate = Annotated[float, Field(allow_inf_nan=False)]
Ring = Annotated[tuple[tuple[Coordinate, Coordinate], ...], AfterValidator(_ring)]


class Building(_Section):
    """What blocks the sight from a UAV to a vehicle."""

    polygon: Ring = Field(description="corners in order, x and y [m]")
    height: Positive = Field(description="[m]")


class Obstacles(_Section):
    """What stands between UAVs and vehicles; links between UAVs are above the roofs."""

    buildings: tuple[Building, ...] = Field(
        (), description="polygons with a height, or the name of a GeoJSON file of them [m]; none: open ground"
    )

    @field_validator("buildings", mode="before")
    @classmethod
    def _from_file(cls, value: object) -> object:
        return read_buildings(Path(value)) if isinstance(value, str) else value


class Chain(_Section):
    """Where the contract lives."""

    url: str | None = Field(
        None, description="JSON-RPC endpoints of one chain, separated by commas; left out: the embedded chain"
    )
    chain_id: Annotated[int, Field(ge=1)] | None = Field(
        None, description="what every endpoint's chain id must be; left out: the first one's"
    )
    validators: tuple[str, ...] | None = Field(
        None, description="addresses that must have sealed the endpoints' blocks; left out: whoever did"
    )
    keystore: str | None = Field(
        None, description="of this host's accounts, encrypted; left out: keys of this run only"
    )
    confirmations: Annotated[int, Field(ge=0, le=1000)] = Field(
        0, description="blocks above a receipt's before it counts: 0 where blocks are final (QBFT)"
    )
    proposals_per_call: Annotated[int, Field(ge=1)] = Field(
        60, description="largest piece of a zone's allocation in one transaction [proposals]"
    )


class Store(_Section):
    """Where models are kept by their content address."""

    url: str | None = Field(None, description="Kubo RPC endpoint; left out: blocks in the run folder")


class Scenario(_Section):
    """A whole run, validated; see docs/reference/scenario.md."""

    name: str = Field("bologna", min_length=1, max_length=80, pattern=r"^[^/\\\x00-\x1f\x7f]+$")
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1
    mobility: Mobility = Mobility()
    zones: Zones = Zones()
    fleet: Fleet = Fleet()
    demand: Demand = Demand()
    selection: Selection = Selection()
    coordination: Coordination = Coordination()
    energy: Energy = Energy()
    obstacles: Obstacles = Obstacles()
    chain: Chain = Chain()
    store: Store = Store()

    @model_validator(mode="after")
    def _within_maxima(self) -> Scenario:
        """What is drawn may not exceed what it is divided by in Eq. 1 and 2; the contract would refuse it."""
        for key, largest, name, maximum in (
            ("fleet.bandwidth", self.fleet.bandwidth[1], "max_uav_bandwidth", self.selection.max_uav_bandwidth),
            ("demand.bandwidth", self.demand.bandwidth[1], "max_demand", self.selection.max_demand),
            ("demand.payment", self.demand.payment[1], "max_payment", self.selection.max_payment),
        ):
            if largest > maximum:
                raise ValueError(f"{key} of at most selection.{name} ({largest:g} is above {maximum:g})")
        return self

    @model_validator(mode="after")
    def _above_the_roofs(self) -> Scenario:
        """UAVs see each other; and a line of sight that never rises above a roof would be no 2.5-dimensional one."""
        highest = max((building.height for building in self.obstacles.buildings), default=0.0)
        if self.obstacles.buildings and self.fleet.altitude <= highest:
            raise ValueError(f"fleet.altitude above the highest building's {highest:g} m ({self.fleet.altitude:g} m)")
        return self


def builtin_scenarios() -> list[str]:
    """Names of the scenarios inside the package."""
    folder = files("skyrelay.data") / "scenarios"
    return sorted(Path(item.name).stem for item in folder.iterdir() if item.name.endswith(".toml"))


def load_scenario(source: str | Path = "bologna", overrides: Sequence[str] = (), seed: int | None = None) -> Scenario:
    """Read, override and validate a scenario.

    Args:
        source: a built-in scenario's name or the path of a TOML file.
        overrides: ``key=value`` with a dotted key and a TOML value, e.g. ``fleet.uavs=20``.
        seed: replaces the file's seed.
    Raises:
        ScenarioError: the file is not there or not TOML, or a key or value does not fit; every fault has its line.
    """
    place, text, folder = _read(source)
    try:
        tree: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(place, None, f"TOML ({error})") from error
    for override in overrides:
        _override(tree, override)
    if seed is not None:
        tree["seed"] = seed
    if folder is not None:
        _place_buildings(tree, folder, overrides)
    scenario = validate(tree, place)
    if folder is None:
        return scenario
    # Paths in a file are relative to that file, not to where the command was called.
    mobility, coordination = scenario.mobility, scenario.coordination
    if (folder / mobility.trace).is_file() and "mobility.trace" not in {o.partition("=")[0].strip() for o in overrides}:
        mobility = mobility.model_copy(update={"trace": str(folder / mobility.trace)})
    if (folder / coordination.policy).is_file():
        coordination = coordination.model_copy(update={"policy": str(folder / coordination.policy)})
    return scenario.model_copy(update={"mobility": mobility, "coordination": coordination})


def _place_buildings(tree: dict[str, Any], folder: Path, overrides: Sequence[str]) -> None:
    """The file of buildings that a scenario's file names, relative to that file."""
    section = tree.get("obstacles")
    if not isinstance(section, dict) or not isinstance(name := section.get("buildings"), str):
        return
    if (folder / name).is_file() and "obstacles.buildings" not in {o.partition("=")[0].strip() for o in overrides}:
        section["buildings"] = str(folder / name)


def validate(tree: Mapping[str, Any], place: str = "scenario") -> Scenario:
    """A scenario from a parsed tree.

    Raises:
        ScenarioError: naming the first key that does not fit (and how many more do not).
    """
    try:
        return Scenario.model_validate(tree)
    except ValidationError as error:
        faults = error.errors()
        first = faults[0]
        key = ".".join(str(part) for part in first["loc"])
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        if first["type"] == "extra_forbidden":
            raise ScenarioError(f"{place}: {key}", None, f"a known key: {_suggest(key)}{more}") from None
        expected = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
        at = f"{place}: {key}" if key else place
        raise ScenarioError(at, first["input"] if key else None, expected + more) from None


def to_toml(scenario: Scenario) -> str:
    """The scenario with every default spelled out, as TOML that `load_scenario` reads back to the same scenario."""
    import tomli_w

    return tomli_w.dumps(scenario.model_dump(mode="json", exclude_none=True))


def to_commented_toml(scenario: Scenario) -> str:
    """The scenario as TOML with every key's meaning and unit beside it; `load_scenario` reads it too."""
    import tomli_w

    lines = [tomli_w.dumps({"name": scenario.name, "seed": scenario.seed}).rstrip()]
    for section in Scenario.model_fields:
        model = getattr(scenario, section)
        if not isinstance(model, _Section):
            continue
        lines += ["", f"# {(type(model).__doc__ or '').strip()}", f"[{section}]"]
        for key, described in type(model).model_fields.items():
            value = getattr(model, key)
            if isinstance(value, tuple):
                text = f"{key} = [{', '.join(map(_inline, value))}]"
            elif value is None:
                text = f"# {key} ="
            else:
                text = tomli_w.dumps({key: value}).rstrip()
            lines.append(f"{text}  # {described.description}" if described.description else text)
    return "\n".join(lines) + "\n"


def _inline(value: object) -> str:
    """A number or a building as TOML on one line."""
    if isinstance(value, Building):
        corners = ", ".join(f"[{x}, {y}]" for x, y in value.polygon)
        return f"{{polygon = [{corners}], height = {value.height}}}"
    return str(value)


def _read(source: str | Path) -> tuple[str, str, Path | None]:
    """Place, text, and the folder that relative paths start from."""
    path = Path(source)
    if str(source) in builtin_scenarios():
        return f"{source}.toml", (files("skyrelay.data") / "scenarios" / f"{source}.toml").read_text("utf-8"), None
    try:
        return str(path), path.read_text(encoding="utf-8"), path.resolve().parent
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        names = ", ".join(builtin_scenarios())
        raise ScenarioError("scenario", str(source), f"a readable TOML file ({reason}) or one of: {names}") from error


def _override(tree: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    key = key.strip()
    if not equals or not key:
        raise ScenarioError("--set", override, "key=value, e.g. --set fleet.uavs=20")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()  # a bare word is a string, so that the shell needs no nested quotes
    *sections, last = key.split(".")
    for section in sections:
        tree = tree.setdefault(section, {})
        if not isinstance(tree, dict):
            raise ScenarioError("--set", override, f"a table at {section!r}, not a value")
    tree[last] = value


def _suggest(key: str) -> str:
    """The closest known key, or the keys of that section."""
    import difflib

    model: Any = Scenario
    *sections, last = key.split(".")
    for section in sections:
        # Below a list there are buildings only; their place in it is no key.
        model = Building if section.isdigit() else model.model_fields[section].annotation
    names = list(model.model_fields)
    close = difflib.get_close_matches(last, names, n=1)
    return f"did you mean {close[0]!r}?" if close else "one of " + ", ".join(names)
