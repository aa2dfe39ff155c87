"""The scenario file (TOML): every default and every unit of a run stands here, and only here."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from skyrelay.core import plugins
from skyrelay.core.errors import ScenarioError
from skyrelay.core.untrusted import parse_toml, read_json

# Strict: `true` is no number, nor is "3"; a whole number is still taken where a fraction may stand.
Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True)]
Share = Annotated[Real, Field(ge=0, le=1)]
Percent = Annotated[Real, Field(ge=0, le=100)]
Text = Annotated[str, Field(min_length=1, max_length=4096)]

# The contract holds positions in an int32 of 0.1 m, payments in a uint32 of cents per Mbit/s, the altitude in a uint16
# of metres, and no more UAVs in a zone than a uint16 counts; a run's tables hold bandwidths in an int32 of kbit/s.
UINT16, UINT32 = 2**16 - 1, 2**32 - 1
FARTHEST = 1_000_000.0
"""Largest length on the ground [m]."""
MBPS = (2**31 - 1) / 1000
LEAST_DEMAND = 0.002
"""Asked for [Mbit/s]: the score of 1 kbit/s at the highest QoV is above the tables' int64."""
MAX_ZONES = 10_000
MAX_POSITIONS = 200_000_000
"""Vehicles and UAVs times steps: more than that no machine that this was made for keeps in memory."""
NAME = r"^[^/\\\x00-\x1f\x7f]+$"
"""A run's name is a folder's, too."""
MAX_SCENARIO = 16 * 2**20
"""Longest scenario file that is parsed [bytes]."""
MAX_CHARGING_POINTS = 100
"""A UAV's way to each is an action of its own, of which a run's tables have an int8."""

Length = Annotated[Real, Field(ge=0.1, le=FARTHEST)]
Speed = Annotated[Real, Field(ge=0, le=1000)]
Bandwidth = Annotated[Real, Field(ge=0, le=MBPS)]
Payment = Annotated[Real, Field(ge=0, le=UINT32)]
PerMinute = Annotated[Real, Field(ge=0, le=6000)]


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
            # A third coordinate is the ground's height (RFC 7946, 3.1.1): the ground is flat here.
            ring = [point[:2] if len(point) == 3 else point for point in geometry["coordinates"][0]]
            buildings.append({"polygon": ring, "height": height})
    except (KeyError, TypeError) as error:
        raise ValueError("a GeoJSON FeatureCollection, each feature with a geometry and a property height") from error
    return buildings


def _sums_to_one(weights: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if not math.isclose(sum(weights), 1.0, abs_tol=1e-9):
        raise ValueError(f"four weights that sum to 1 (these sum to {sum(weights):g})")
    return weights


SpeedBounds = Annotated[tuple[Speed, Speed], AfterValidator(_ordered)]
BandwidthBounds = Annotated[tuple[Bandwidth, Bandwidth], AfterValidator(_ordered)]
DemandBounds = Annotated[
    tuple[Annotated[Bandwidth, Field(ge=LEAST_DEMAND)], Annotated[Bandwidth, Field(ge=LEAST_DEMAND)]],
    AfterValidator(_ordered),
]
PaymentBounds = Annotated[tuple[Payment, Payment], AfterValidator(_ordered)]
PercentBounds = Annotated[tuple[Percent, Percent], AfterValidator(_ordered)]
Weights = Annotated[tuple[Share, Share, Share, Share], AfterValidator(_sums_to_one)]


class _Section(BaseModel):
    """A frozen table of the scenario file; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Mobility(_Section):
    """Where the vehicles are."""

    source: Text = Field(
        "trace",
        description="trace: replay of floating-car data; manhattan, random-waypoint: a synthetic model; or on the "
        "command line module:function",
    )
    trace: Text = Field("bologna", description="a built-in trace, or a Parquet, CSV or XML file")
    penetration: Annotated[Real, Field(gt=0, le=1)] = Field(0.2, description="share of the trace's vehicles connected")
    start: Annotated[Real, Field(ge=0, le=1e9)] = Field(
        0.0, description="where in the trace to begin [s after its first sample]"
    )
    units: Literal["auto", "m", "km", "ft", "degrees"] = Field(
        "auto",
        description="of the trace's positions; auto: metres, or degrees where columns, format or speeds say so",
    )
    time_unit: Literal["s", "ms", "us", "ns"] = Field("s", description="of the trace's times where they are numbers")
    max_gap: Annotated[Real, Field(gt=0, le=86_400)] = Field(
        30.0, description="between samples further apart a vehicle is absent [s]"
    )
    lost_fixes: Literal["refuse", "drop"] = Field(
        "refuse", description="single samples at places that the vehicle cannot have reached"
    )
    vehicles: Annotated[Whole, Field(ge=1, le=1_000_000)] = Field(
        200, description="synthetic models: how many vehicles"
    )
    area: Annotated[Real, Field(ge=1, le=FARTHEST)] = Field(
        6000.0, description="synthetic models: side of the square area [m]"
    )
    speed: SpeedBounds = Field((4.5, 15.0), description="synthetic models: vehicle speed, uniform between [m/s]")
    turn_probability: Share = Field(0.5, description="manhattan: probability of a turn at a step")

    @field_validator("source")
    @classmethod
    def _known(cls, source: str) -> str:
        own = ("trace", "manhattan", "random-waypoint")
        if source not in own and not plugins.is_code(source) and source not in plugins.installed("skyrelay.mobility"):
            close = difflib.get_close_matches(source, own, n=1)
            hint = f"did you mean {close[0]!r}?" if close else "or on the command line module:function"
            raise ValueError(f"one of {', '.join(own)} ({hint})")
        return source


class Zones(_Section):
    """A grid of equal squares over the area."""

    columns: Annotated[Whole, Field(ge=1, le=1000)] = Field(3, description="from west to east")
    rows: Annotated[Whole, Field(ge=1, le=1000)] = Field(3, description="from south to north")

    @model_validator(mode="after")
    def _countable(self) -> Zones:
        if self.columns * self.rows > MAX_ZONES:
            raise ValueError(f"at most {MAX_ZONES:,} zones ({self.columns} x {self.rows} are more)")
        return self


class Fleet(_Section):
    """The UAVs: how many, and what they draw (Table "Simulation Setup")."""

    uavs: Annotated[Whole, Field(ge=1, le=UINT16)] = Field(40, description="how many, over all zones")
    range: Length | None = Field(
        None, description="of the UAV-vehicle and the UAV-UAV link [m]; left out: half a zone's side"
    )
    speed: Annotated[Speed, Field(gt=0)] = Field(30.0, description="[m/s]")
    separation: Annotated[Real, Field(ge=0, le=10_000)] | None = Field(
        None, description="least distance that UAVs of a zone keep [m]; left out: 30, and 0 where radio.model is disc"
    )
    altitude: Annotated[Real, Field(ge=0, le=UINT16)] = Field(100.0, description="[m]; ranges are horizontal")
    bandwidth: BandwidthBounds = Field((0.0, 20.0), description="available bandwidth, uniform between [Mbit/s]")
    battery: PercentBounds = Field((1.0, 100.0), description="at the start, uniform between [%]")
    reputation: PercentBounds = Field((1.0, 100.0), description="uniform between [0-100]")


class Demand(_Section):
    """What vehicles ask for and offer (Table "Simulation Setup")."""

    bandwidth: DemandBounds = Field((1.0, 4.0), description="requested bandwidth, uniform between [Mbit/s]")
    payment: PaymentBounds = Field((0.0, 700.0), description="uniform between [cents per Mbit/s]")
    reputation: PercentBounds = Field((1.0, 100.0), description="uniform between [0-100]")


class Selection(_Section):
    """QoU, QoV (Eq. 1, 2) and the two algorithms."""

    method: Text = Field(
        "two-sided",
        description="two-sided: by the contract; near-feasible, load-aware, nnm, optimal, nearest, random, or on the "
        "command line module:function: worked out outside, checked by the contract",
    )
    qou_weights: Weights = Field((0.25, 0.25, 0.25, 0.25), description="bandwidth, battery, reputation, closeness")
    qov_weights: Weights = Field((0.25, 0.25, 0.25, 0.25), description="demand, payment, reputation, closeness")
    max_distance: Length = Field(
        3000.0, description="of a candidate, and what distances are divided by; a run caps it at fleet.range [m]"
    )
    max_uav_bandwidth: Annotated[Bandwidth, Field(ge=0.001)] = Field(20.0, description="Max AB [Mbit/s]")
    max_demand: Annotated[Bandwidth, Field(ge=LEAST_DEMAND)] = Field(4.0, description="Max RB [Mbit/s]")
    max_payment: Annotated[Payment, Field(ge=1)] = Field(700.0, description="Max PayPerMbps [cents per Mbit/s]")
    candidates: Literal["range", "zone"] = Field(
        "range", description="range: the zone's UAVs within max_distance; zone: all of them"
    )
    rounds: Annotated[Whole, Field(ge=1, le=1000)] = Field(
        1, description="1: the paper; more: a rejected vehicle proposes again, up to deferred acceptance"
    )
    hysteresis: Percent = Field(
        0.0, description="a vehicle leaves the UAV that served it only for one with so many more points of QoU"
    )
    time_to_trigger: Annotated[Whole, Field(ge=0, le=1000)] = Field(
        0, description="and once one has had them for so many selection periods; 0: at once"
    )
    load_weight: Share = Field(0.5, description="of load-aware: share of a UAV's QoU that goes by what is asked of it")


class Coordination(_Section):
    """How the selected UAVs fly."""

    steps: Annotated[Whole, Field(ge=1, le=100_000)] = Field(100, description="moves of every UAV in the run")
    step_seconds: Annotated[Real, Field(ge=0.01, le=3600)] = Field(2.0, description="[s]")
    period_steps: Annotated[Whole, Field(ge=1, le=100_000)] = Field(20, description="moves between two selections")
    reselect_steps: Annotated[Whole, Field(ge=0, le=100_000)] = Field(
        0,
        description="moves after which, within a period, vehicles without a UAV ask again; 0: never",
    )
    policy: Text = Field(
        "auto",
        description="auto: the shipped policies that fit best; or one's name, the path of an ONNX file, a rule's name "
        "(hovering, cover, ...), or on the command line module:function",
    )
    dispatch: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="between periods UAVs go to a neighbouring zone that lacks bandwidth",
    )
    patience: Annotated[Real, Field(ge=0.01, le=86_400)] = Field(
        10.0, description="a team mate or vehicle whose last beacon is older counts as gone [s]"
    )


class Energy(_Section):
    """What flying costs (a battery of 100 % empties in 25 minutes of hovering by default)."""

    model: Literal["linear", "rotary-wing"] = Field(
        "linear", description="linear: by the two rates below; rotary-wing: power by speed (Zeng et al. 2019)"
    )
    battery: Annotated[Real, Field(ge=1, le=1e6)] = Field(
        70.0, description="what a full battery holds, for rotary-wing and for charging places [Wh]"
    )
    payload: Annotated[Real, Field(ge=0, le=100_000)] = Field(
        0.0, description="rotary-wing: what the radio and the rest on board take all the time in the air [W]"
    )
    hover_per_minute: PerMinute = Field(4.0, description="linear: [% of the battery]")
    move_per_minute: PerMinute = Field(5.0, description="linear: [% of the battery]")
    reserve: Percent = Field(3.0, description="at or below it a UAV leaves, and selection replaces it [%]")
    charge_per_minute: PerMinute = Field(
        0.0, description="what hovering at its zone's charging point gives; 0: there are none [% of the battery]"
    )
    charging_point: tuple[Share, Share] = Field(
        (0.5, 0.5), description="of every zone, from its south-west corner [zone sides]"
    )
    charging_radius: Length = Field(100.0, description="within which a UAV is charged [m]")
    places: Annotated[Whole, Field(ge=0, le=UINT16)] = Field(
        0, description="on the ground at each zone's charging point, where no [[charging]] is listed; 0: there are none"
    )
    charging_power: Annotated[Real, Field(ge=1, le=1e6)] = Field(
        300.0, description="what each of these places gives [W]"
    )
    rotation: Literal["alone", "rotate"] = Field(
        "rotate",
        description="who is charged when, at such places: rotate: by one plan that all UAVs work out; "
        "alone: each goes when it must, and comes back full",
    )

    @model_validator(mode="after")
    def _one_way_to_charge(self) -> Energy:
        """In the air at a point, or on the ground at a place."""
        if self.places and self.charge_per_minute:
            raise ValueError("energy.charge_per_minute of 0 beside energy.places: in the air, or on the ground")
        return self


class Wind(_Section):
    """The same over the whole area; UAVs counter it by their airspeed, and make less way against it."""

    speed: Speed = Field(0.0, description="of the wind, without gusts [m/s]; with them below fleet.speed")
    direction: Annotated[Real, Field(ge=0, le=360)] = Field(
        270.0, description="that it blows from, clockwise from north [degrees]"
    )
    gusts: Speed = Field(0.0, description="by how much at most it is stronger or weaker, over the time [m/s]")


Coordinate = Annotated[Real, Field(ge=-100_000_000, le=100_000_000)]
Ring = Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(max_length=10_000), AfterValidator(_ring)]


class Building(_Section):
    """What blocks the sight from a UAV to a vehicle."""

    polygon: Ring = Field(description="corners in order, x and y [m]")
    height: Annotated[Real, Field(gt=0, le=UINT16)] = Field(description="[m]")


class Obstacles(_Section):
    """What stands between UAVs and vehicles; links between UAVs are above the roofs."""

    buildings: Annotated[tuple[Building, ...], Field(max_length=100_000)] = Field(
        (), description="polygons with a height, or the name of a GeoJSON file of them [m]; none: open ground"
    )

    @field_validator("buildings", mode="before")
    @classmethod
    def _from_file(cls, value: object) -> object:
        return read_buildings(Path(value)) if isinstance(value, str) else value


class Map(_Section):
    """What the page draws beneath the vehicles; nothing is computed from it."""

    streets: Text | None = Field(
        None, description="a SUMO network (.net.xml) or a GeoJSON file of lines; left out: the vehicles' tracks"
    )


class Radio(_Section):
    """What a link carries; UAV-UAV links, and those to gateways, are in free space on channels of their own."""

    model: Literal["disc", "air-to-ground", "tr36777"] = Field(
        "disc", description="disc: the paper's, all or nothing; Al-Hourani et al. 2014; or 3GPP TR 36.777"
    )
    environment: Literal["suburban", "urban", "dense-urban", "high-rise"] = Field(
        "urban", description="air-to-ground: what stands around"
    )
    cell: Literal["UMa-AV", "UMi-AV"] = Field("UMa-AV", description="tr36777: urban macro or micro, aerial users")
    carrier: Annotated[Real, Field(ge=0.1, le=100)] = Field(2.0, description="[GHz]")
    bandwidth: Annotated[Real, Field(ge=0.001, le=10_000)] = Field(
        10.0, description="of a UAV's radio, shared among its vehicles [MHz]"
    )
    power: Annotated[Real, Field(ge=-50, le=80)] = Field(30.0, description="of a UAV, with the antennas' gains [dBm]")
    noise_figure: Annotated[Real, Field(ge=0, le=50)] = Field(7.0, description="of every receiver [dB]")
    efficiency: Annotated[Real, Field(ge=0.01, le=100)] = Field(
        7.4, description="of the best modulation and code [bit/s/Hz]"
    )
    least_sinr: Annotated[Real, Field(ge=-50, le=50)] = Field(
        -6.0, description="below which a link carries nothing [dB]"
    )
    shadowing: Annotated[Real, Field(ge=0, le=30)] | None = Field(
        None, description="its standard deviation [dB]; left out: the report's for tr36777, none for air-to-ground"
    )
    correlation: Length = Field(50.0, description="way over which shadowing's correlation falls to 1/e [m]")
    channels: Annotated[Whole, Field(ge=1, le=UINT16)] = Field(
        4, description="that UAVs take turn by turn; those on one channel disturb each other"
    )
    antenna: Annotated[Real, Field(ge=0, le=100)] = Field(1.5, description="height of a vehicle's [m]")
    link_carrier: Annotated[Real, Field(ge=0.1, le=100)] = Field(5.0, description="of UAV-UAV and gateway links [GHz]")
    link_bandwidth: Annotated[Real, Field(ge=0.001, le=10_000)] = Field(20.0, description="of each such link [MHz]")
    link_power: Annotated[Real, Field(ge=-50, le=80)] = Field(
        30.0, description="of such a link, with the antennas' gains [dBm]"
    )


class Gateway(_Section):
    """Where traffic leaves the fleet."""

    name: Text = Field(description="what it is called")
    kind: Literal["roadside-unit", "base-station"] = Field("roadside-unit", description="what it is")
    x: Coordinate = Field(description="[m]")
    y: Coordinate = Field(description="[m]")
    height: Annotated[Real, Field(ge=0, le=UINT16)] = Field(10.0, description="of its antenna [m]")
    capacity: Annotated[Bandwidth, Field(gt=0)] = Field(100.0, description="of its way on [Mbit/s]")


class ChargingPoint(_Section):
    """Where UAVs land to be charged."""

    name: Text = Field(description="what it is called")
    x: Coordinate = Field(description="[m]")
    y: Coordinate = Field(description="[m]")
    places: Annotated[Whole, Field(ge=1, le=UINT16)] = Field(1, description="how many UAVs it charges at a time")
    power: Annotated[Real, Field(ge=1, le=1e6)] = Field(300.0, description="of each place [W]")


class Payments(_Section):
    """What vehicles pay for what UAVs carry; off, as in the paper, an offer of payment only ranks."""

    enabled: bool = Field(False, description="deposits, receipts in flight, a settlement each period")
    deposit_periods: Annotated[Whole, Field(ge=2, le=1000)] = Field(
        3, description="prices of a full period that a vehicle keeps deposited; two can be locked at a time"
    )
    receipt_steps: Annotated[Whole, Field(ge=1, le=1000)] = Field(
        4, description="between two receipts [steps]: what a UAV serves on credit"
    )
    window: Annotated[Whole, Field(ge=1, le=31_536_000)] = Field(
        60, description="that a UAV has for its receipts after a period, and that a withdrawal waits [s]"
    )


class Chain(_Section):
    """Where the contract lives."""

    url: Text | None = Field(
        None, description="JSON-RPC endpoints of one chain, separated by commas; left out: the embedded chain"
    )
    chain_id: Annotated[Whole, Field(ge=1, le=2**63 - 37)] | None = Field(
        None, description="what every endpoint's chain id must be; left out: the first one's"
    )
    validators: Annotated[tuple[Text, ...], Field(max_length=1000)] | None = Field(
        None, description="addresses that must have sealed the endpoints' blocks; left out: whoever did"
    )
    keystore: Text | None = Field(
        None, description="of this host's accounts, encrypted; left out: keys of this run only"
    )
    confirmations: Annotated[Whole, Field(ge=0, le=1000)] = Field(
        0, description="blocks above a receipt's before it counts: 0 where blocks are final (QBFT)"
    )
    proposals_per_call: Annotated[Whole, Field(ge=1, le=UINT16)] = Field(
        60, description="largest piece of a zone's allocation in one transaction [proposals]"
    )
    submission: Literal["direct", "batch"] = Field(
        "direct", description="direct: vehicles send records and proposals; batch: they sign, a relayer hands many in"
    )

    allocation: Literal["strict", "proven", "optimistic"] = Field(
        "strict",
        description="strict: on the chain; proven, optimistic: vehicles sign, the coordinator tells the result, and "
        "the chain checks it at once, or there is a bond",
    )
    challenge_window: Annotated[Whole, Field(ge=1, le=UINT16)] = Field(
        8, description="of an optimistic allocation: how long a claim can be proved wrong at the least [blocks]"
    )

    @property
    def signs(self) -> bool:
        """Vehicles sign their proposals for others to hand in."""
        return self.submission == "batch" or self.allocation != "strict"

    @model_validator(mode="after")
    def _of_a_node(self) -> Chain:
        """What only a node has would be passed over in silence on the embedded chain."""
        for key in ("chain_id", "validators", "keystore"):
            if self.url is None and getattr(self, key) is not None:
                raise ValueError(f"chain.url beside chain.{key}: the embedded chain has none")
        return self


class Store(_Section):
    """Where models are kept by their content address."""

    url: Text | None = Field(None, description="Kubo RPC endpoint; left out: blocks in the run folder")
    trusted_keys: Annotated[tuple[Text, ...], Field(min_length=1, max_length=100)] | None = Field(
        None, description="public keys (PEM files): UAVs fly only what one of them has signed; left out: any policy"
    )


class Scenario(_Section):
    """A whole run, validated; see docs/reference/scenario.md."""

    name: str = Field("bologna", min_length=1, max_length=80, pattern=NAME)
    seed: Annotated[Whole, Field(ge=0, lt=2**32)] = 1
    mobility: Mobility = Mobility()
    zones: Zones = Zones()
    fleet: Fleet = Fleet()
    demand: Demand = Demand()
    selection: Selection = Selection()
    coordination: Coordination = Coordination()
    energy: Energy = Energy()
    wind: Wind = Wind()
    obstacles: Obstacles = Obstacles()
    radio: Radio = Radio()
    gateways: Annotated[tuple[Gateway, ...], Field(max_length=1000)] = ()
    charging: Annotated[tuple[ChargingPoint, ...], Field(max_length=MAX_CHARGING_POINTS)] = ()
    map: Map = Map()
    chain: Chain = Chain()
    store: Store = Store()
    payment: Payments = Payments()

    @property
    def reselections(self) -> frozenset[int]:
        """The steps within periods at which vehicles without a UAV ask again.

        By a method outside of the contract everybody is selected together: there are none.
        """
        config = self.coordination
        if not config.reselect_steps or self.selection.method != "two-sided":
            return frozenset()
        places = ((step, step % config.period_steps) for step in range(config.steps))
        return frozenset(step for step, place in places if place and place % config.reselect_steps == 0)

    @model_validator(mode="before")
    @classmethod
    def _named(cls, tree: Any) -> Any:
        """Without a name a run has its trace's, or its synthetic model's."""
        if not isinstance(tree, dict) or "name" in tree:
            return tree
        mobility = tree.get("mobility", {})
        told = dict(mobility) if isinstance(mobility, dict | Mobility) else {}
        source = told.get("source", "trace")
        name = Path(str(told.get("trace", "bologna"))).stem if source == "trace" else str(source).rpartition(":")[2]
        return tree | {"name": name} if _fits_a_name(name) else tree

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
    def _claimable(self) -> Scenario:
        """A period has six claims at the most, since a proof against one has to fit a transaction; or one proven."""
        most = {"optimistic": 6, "proven": 1}.get(self.chain.allocation, self.selection.rounds)
        if self.selection.rounds > most:
            told = f"chain.allocation = {self.chain.allocation} ({self.selection.rounds})"
            raise ValueError(f"selection.rounds of at most {most} with {told}")
        return self

    @model_validator(mode="after")
    def _against_the_wind(self) -> Scenario:
        """A UAV that cannot hold its place against the wind holds neither its zone nor its distance to others."""
        strongest, speed = self.wind.speed + self.wind.gusts, self.fleet.speed
        if strongest >= speed:
            raise ValueError(
                f"wind.speed and wind.gusts slower than fleet.speed together ({strongest:g} and {speed:g})"
            )
        if strongest and (self.energy.places or self.charging):
            raise ValueError("still air where there are charging places: the way to them is not reckoned with wind")
        return self

    @model_validator(mode="after")
    def _in_memory(self) -> Scenario:
        """A run keeps everyone's position at every step."""
        members = self.fleet.uavs + (0 if self.mobility.source == "trace" else self.mobility.vehicles)
        if members * self.coordination.steps > MAX_POSITIONS:
            raise ValueError(
                f"vehicles and UAVs times coordination.steps of at most {MAX_POSITIONS:,} "
                f"({members:,} x {self.coordination.steps:,} are more)"
            )
        return self

    @model_validator(mode="after")
    def _paid_by_the_contract(self) -> Scenario:
        """Prices are locked by what SkyRelay's own allocation has decided, and for a period of the run's clock."""
        if self.payment.enabled and self.chain.url is not None:
            raise ValueError(
                "chain.url beside payment.enabled: a node's clock is not the run's, by which prices are locked"
            )
        if self.coordination.reselect_steps and (self.payment.enabled or self.chain.allocation != "strict"):
            raise ValueError(
                f'coordination.reselect_steps of 0 with payment.enabled, or a chain.allocation that is not "strict" '
                f"({self.coordination.reselect_steps})"
            )
        if self.payment.enabled and self.chain.allocation != "strict":
            raise ValueError(f'payment.enabled with chain.allocation = "strict" ({self.chain.allocation!r})')
        return self

    @model_validator(mode="after")
    def _radio_of_the_altitude(self) -> Scenario:
        """A law has its heights."""
        altitude, radio = self.fleet.altitude, self.radio
        if radio.model == "tr36777" and not 22.5 < altitude <= 300.0:
            raise ValueError(f"fleet.altitude above 22.5 m and up to 300 m, as TR 36.777 has it ({altitude:g} m)")
        if radio.model != "disc" and altitude <= radio.antenna:
            raise ValueError(f"fleet.altitude above radio.antenna ({altitude:g} m is not above {radio.antenna:g} m)")
        if twice := _twice([gateway.name for gateway in self.gateways]):
            raise ValueError(f"gateways of different names ({twice!r} is there twice)")
        return self

    @model_validator(mode="after")
    def _charging_points(self) -> Scenario:
        """On the ground at places, or in the air at a point; each point with a name and an action of its own."""
        if self.charging and self.energy.charge_per_minute:
            raise ValueError("energy.charge_per_minute of 0 beside [[charging]]: in the air, or on the ground")
        if twice := _twice([point.name for point in self.charging]):
            raise ValueError(f"charging points of different names ({twice!r} is there twice)")
        zones = self.zones.columns * self.zones.rows
        if self.energy.places and not self.charging and zones > MAX_CHARGING_POINTS:
            raise ValueError(
                f"at most {MAX_CHARGING_POINTS} zones where energy.places has a charging point in each ({zones:,}); "
                "or [[charging]] points"
            )
        return self

    @model_validator(mode="after")
    def _above_the_roofs(self) -> Scenario:
        """UAVs see each other; and a line of sight that never rises above a roof would be no 2.5-dimensional one."""
        highest = max((building.height for building in self.obstacles.buildings), default=0.0)
        if self.obstacles.buildings and self.fleet.altitude <= highest:
            raise ValueError(f"fleet.altitude above the highest building's {highest:g} m ({self.fleet.altitude:g} m)")
        return self


def _twice(names: Sequence[str]) -> str | None:
    """The first name that is there more than once."""
    return min((name for name in names if names.count(name) > 1), default=None)


def _fits_a_name(name: object) -> bool:
    return isinstance(name, str) and len(name) <= 80 and re.search(NAME, name) is not None


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
        tree = parse_toml(text)
    except ValueError as error:
        raise ScenarioError(place, None, f"TOML ({error})") from error
    if folder is not None and "name" not in tree and _fits_a_name(Path(source).stem):
        tree["name"] = Path(source).stem
    for override in overrides:
        _override(tree, override)
    replaced = {override.partition("=")[0].strip() for override in overrides}
    if folder is None and "name" not in replaced and replaced & {"mobility.source", "mobility.trace"}:
        del tree["name"]  # a built-in scenario on other streets is no longer what its name says
    if seed is not None:
        tree["seed"] = seed
    if folder is not None:
        _place_buildings(tree, folder, overrides)
    scenario = validate(tree, place)
    if folder is None:
        return scenario
    # Paths in a file are relative to that file, not to where the command was called.
    mobility, coordination, drawn = scenario.mobility, scenario.coordination, scenario.map
    if _is_file(folder / mobility.trace) and "mobility.trace" not in replaced:
        mobility = mobility.model_copy(update={"trace": str(folder / mobility.trace)})
    if _is_file(folder / coordination.policy):
        coordination = coordination.model_copy(update={"policy": str(folder / coordination.policy)})
    if drawn.streets and "map.streets" not in replaced:
        drawn = drawn.model_copy(update={"streets": str(folder / drawn.streets)})
    return scenario.model_copy(update={"mobility": mobility, "coordination": coordination, "map": drawn})


def _is_file(path: Path) -> bool:
    """Whether it is one; what cannot be a path (too long, say) is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def _place_buildings(tree: dict[str, Any], folder: Path, overrides: Sequence[str]) -> None:
    """The file of buildings that a scenario's file names, relative to that file."""
    section = tree.get("obstacles")
    if not isinstance(section, dict) or not isinstance(name := section.get("buildings"), str):
        return
    if _is_file(folder / name) and "obstacles.buildings" not in {o.partition("=")[0].strip() for o in overrides}:
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
    for section in ("gateways", "charging"):
        for item in getattr(scenario, section):
            lines += ["", f"[[{section}]]", tomli_w.dumps(item.model_dump()).rstrip()]
    return "\n".join(lines) + "\n"


def _inline(value: object) -> str:
    """A number, a string or a building as TOML on one line."""
    import tomli_w

    if isinstance(value, Building):
        corners = ", ".join(f"[{x}, {y}]" for x, y in value.polygon)
        return f"{{polygon = [{corners}], height = {value.height}}}"
    return tomli_w.dumps({"value": value}).rstrip("\n").removeprefix("value = ")


def _read(source: str | Path) -> tuple[str, str, Path | None]:
    """Place, text, and the folder that relative paths start from."""
    path = Path(source)
    if str(source) in builtin_scenarios():
        return f"{source}.toml", (files("skyrelay.data") / "scenarios" / f"{source}.toml").read_text("utf-8"), None
    try:
        with path.open("rb") as file:
            content = file.read(MAX_SCENARIO + 1)
        if len(content) > MAX_SCENARIO:
            raise ScenarioError(str(path), None, f"at most {MAX_SCENARIO:,} bytes")
        # Editors on Windows begin a file with a byte-order mark, and TOML's reader takes it for a key.
        return str(path), content.decode("utf-8-sig"), path.resolve().parent
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a name with a NUL
        reason = error.strerror if isinstance(error, OSError) else "UTF-8 text"
        names = ", ".join(builtin_scenarios())
        raise ScenarioError("scenario", str(source), f"a readable TOML file ({reason}) or one of: {names}") from error


def _override(tree: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    key = key.strip()
    if not equals or not key:
        raise ScenarioError("--set", override, "key=value, e.g. --set fleet.uavs=20")
    try:
        value = parse_toml(f"value = {text}")["value"]
    except ValueError:
        value = text.strip()  # a bare word is a string, so that the shell needs no nested quotes
    *sections, last = key.split(".")
    for section in sections:
        tree = tree.setdefault(section, {})
        if not isinstance(tree, dict):
            raise ScenarioError("--set", override, f"a table at {section!r}, not a value")
    tree[last] = value
    if isinstance(value, str):
        plugins.allow(value)  # code that is named here is named by the user, not by a file


def _suggest(key: str) -> str:
    """The closest known key, or the keys of that section."""
    import difflib

    model: Any = Scenario
    *sections, last = key.split(".")
    for section in sections:
        # Below a list there are buildings, gateways or charging points; their place in it is no key.
        if not section.isdigit():
            listed = {"buildings": Building, "gateways": Gateway, "charging": ChargingPoint}
            model = listed.get(section) or model.model_fields[section].annotation
    names = list(model.model_fields)
    close = difflib.get_close_matches(last, names, n=1)
    return f"did you mean {close[0]!r}?" if close else "one of " + ", ".join(names)
