"""The record of a run: the columns of its tables and the keys of its summary, defined here and nowhere else."""

from __future__ import annotations

from typing import Annotated

import pyarrow as pa
from pydantic import BaseModel, ConfigDict, Field

_F32, _F64, _I32, _I64, _TEXT = pa.float32(), pa.float64(), pa.int32(), pa.int64(), pa.string()

SCHEMAS: dict[str, pa.Schema] = {
    # One row for each connected vehicle that is there at a step; uav is "" where nobody serves it. carried: of what it
    # asks for, what its link to its UAV holds; delivered: of that, what gets where it is wanted.
    # static_*, here and below: the same for the comparator, the same fleet that hovers.
    "vehicles": pa.schema(
        {
            "step": _I32,
            "vehicle": _TEXT,
            "x": _F64,
            "y": _F64,
            "zone": _I32,
            "demand_kbps": _I32,
            "uav": _TEXT,
            "covered": pa.bool_(),
            "carried_kbps": _F64,
            "delivered_kbps": _F64,
            "static_uav": _TEXT,
            "static_covered": pa.bool_(),
            "static_carried_kbps": _F64,
            "static_delivered_kbps": _F64,
        }
    ),
    # One row for each UAV at a step; the action is the one that led to the step; zone 0 for one that has landed.
    "uavs": pa.schema(
        {
            "step": _I32,
            "uav": _TEXT,
            "x": _F64,
            "y": _F64,
            "zone": _I32,
            "selected": pa.bool_(),
            "battery": _F32,
            "action": pa.int8(),
            "static_x": _F64,
            "static_y": _F64,
            "static_zone": _I32,
            "static_selected": pa.bool_(),
        }
    ),
    # One row for each zone with a team at a step, and one with zone 0 for the whole area. connected: vehicles that are
    # there, and demand what they ask for; vehicles: those that the zone's UAVs serve, wherever these vehicles are by
    # now, and carried and delivered what these get.
    "metrics": pa.schema(
        {
            "step": _I32,
            "time": _F64,
            "zone": _I32,
            "connected": _I32,
            "vehicles": _I32,
            "covered": _I32,
            "coverage": _F64,
            "connectivity": _F64,
            "connectivity_neighbor": _F64,
            "demand_mbps": _F64,
            "served_mbps": _F64,
            "carried_mbps": _F64,
            "delivered_mbps": _F64,
            "energy_percent": _F64,
            "static_vehicles": _I32,
            "static_covered": _I32,
            "static_coverage": _F64,
            "static_connectivity": _F64,
            "static_served_mbps": _F64,
            "static_carried_mbps": _F64,
            "static_delivered_mbps": _F64,
        }
    ),
    # One row for each submitVehSelection(), in the order of submission.
    "proposals": pa.schema(
        {
            "period": _I32,
            "round": _I32,
            "zone": _I32,
            "vehicle": _TEXT,
            "uav": _TEXT,
            "qou": _F64,
            "qov": _I64,
            "score": _I64,
            "demand_kbps": _I32,
            "accepted": pa.bool_(),
            "order": _I32,
        }
    ),
    # The QoU of every candidate that a vehicle weighed in a period's first round.
    "candidates": pa.schema({"period": _I32, "vehicle": _TEXT, "uav": _TEXT, "qou": _F64}),
    # The UAVs' records on the chain when a period's proposals opened.
    "fleet": pa.schema(
        {
            "period": _I32,
            "uav": _TEXT,
            "zone": _I32,
            "x": _F64,
            "y": _F64,
            "bandwidth_kbps": _I32,
            "battery": _F64,
            "reputation": _F64,
        }
    ),
    # The vehicles' records on the chain when a period's proposals opened.
    "members": pa.schema(
        {
            "period": _I32,
            "vehicle": _TEXT,
            "zone": _I32,
            "x": _F64,
            "y": _F64,
            "demand_kbps": _I32,
            "payment": _F64,
            "reputation": _F64,
        }
    ),
    # Whose account an address is; kind is vehicle, uav or party.
    "accounts": pa.schema({"name": _TEXT, "address": _TEXT, "kind": _TEXT}),
    # One row for each agreement of a vehicle with its UAV for a period, where vehicles pay; in thousandths of a cent.
    # price: of the full period, locked of the deposit; due: by what was carried; signed: by the vehicle's last receipt;
    # paid: by the contract.
    "payments": pa.schema(
        {
            "period": _I32,
            "zone": _I32,
            "vehicle": _TEXT,
            "uav": _TEXT,
            "price": _I64,
            "due": _I64,
            "signed": _I64,
            "paid": _I64,
        }
    ),
    # The corners of each street in order, for the page; streets are numbered from 0. Not there where none were named.
    "streets": pa.schema({"street": _I32, "x": _F64, "y": _F64}),
    # One row for each UAV that is away to be charged at a step; state is "under way", "waiting" (landed, and all places
    # are taken), "charging" or "full". Not there where the scenario has no charging places.
    "charging": pa.schema({"step": _I32, "uav": _TEXT, "point": _TEXT, "state": _TEXT, "battery": _F32}),
    # Every event of the contract; args is a JSON object.
    "events": pa.schema({"block": _I64, "tx": _I32, "log": _I32, "step": _I32, "name": _TEXT, "args": _TEXT}),
}

OPTIONAL = frozenset({"charging", "payments", "streets"})
"""Tables that are written only where they have rows."""

CHARGING_STATES = frozenset({"under way", "waiting", "charging", "full"})
"""What the table ``charging`` says that a UAV does."""

POSITIONS: dict[str, tuple[str, ...]] = {
    "vehicles": ("x", "y"),
    "uavs": ("x", "y", "static_x", "static_y"),
    "fleet": ("x", "y"),
    "members": ("x", "y"),
    "streets": ("x", "y"),
}
"""Columns that hold a place [m], a finite number."""

RATES: dict[str, tuple[str, ...]] = {
    "vehicles": ("demand_kbps", "carried_kbps", "delivered_kbps", "static_carried_kbps", "static_delivered_kbps"),
}
"""Columns that hold a rate: a finite number that is not negative."""

MAX_STEPS = 10_000_000

Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Measure = Annotated[float, Field(allow_inf_nan=False)]
Side = Annotated[int, Field(ge=1, le=1000)]
Text = Annotated[str, Field(max_length=1000)]


class Grid(BaseModel):
    """`skyrelay.core.zones.ZoneGrid` as ``summary.json`` has it."""

    model_config = ConfigDict(frozen=True, strict=True)

    x0: Measure
    y0: Measure
    side: Positive
    columns: Side
    rows: Side


class Summary(BaseModel):
    """``summary.json``; a measure is None where there was nothing to measure."""

    model_config = ConfigDict(frozen=True, strict=True, protected_namespaces=())

    name: Text
    seed: int
    vehicles: Count
    vehicles_per_period: Measure
    uavs: Count
    zones: Count
    periods: Count
    steps: Annotated[int, Field(ge=1, le=MAX_STEPS)]
    served: Count
    served_per_period: Measure
    static_served_per_period: Measure
    mean_qou: Measure | None
    mean_qov: Measure | None
    connected: Measure | None
    in_range: Measure | None
    in_range_share: Measure | None
    coverage: Measure | None
    connectivity: Measure | None
    connectivity_neighbor: Measure | None
    served_mbps: Measure | None
    demand_mbps: Measure | None
    carried_mbps: Measure | None
    delivered_mbps: Measure | None
    carried_share: Measure | None
    delivered_share: Measure | None
    fairness: Measure | None
    handovers: Count
    outage_p95_seconds: Measure | None
    static_in_range: Measure | None
    static_in_range_share: Measure | None
    static_coverage: Measure | None
    static_connectivity: Measure | None
    static_served_mbps: Measure | None
    static_carried_mbps: Measure | None
    static_delivered_mbps: Measure | None
    static_carried_share: Measure | None
    static_delivered_share: Measure | None
    static_fairness: Measure | None
    static_handovers: Count
    static_outage_p95_seconds: Measure | None
    energy_percent: Measure | None
    uavs_retired: Count
    charged_share: Measure | None = Field(None, description="of the time of the UAVs that they are away to be charged")
    waiting_seconds: Measure | None = Field(None, description="that a UAV has waited for a charging place on average")
    lowest_battery: Measure | None = Field(None, description="of all UAVs at all steps [%]")
    transactions: Count
    gas_used: Count
    blocks: Count
    chain_head: Text
    contract: Text
    chain_url: Text | None
    chain_id: Annotated[int, Field(ge=1, le=2**63 - 37)] | None = Field(None, description="of a node's chain")
    model_cids: Annotated[list[Text], Field(max_length=10_000)]
    decided_by: list[Text] = Field([], max_length=10_000, description="policy or rule that each CID names")
    selected_by: str = Field("", max_length=1000, description="method, and what of it the contract has checked")
    range_m: Positive
    step_seconds: Positive
    period_steps: Annotated[int, Field(ge=1)]
    grid: Grid
    trace_notes: list[str] = Field([], max_length=100, description="what was made of the trace's file")
    attribution: str = Field("", max_length=10_000, description="whose trace was replayed, and under which licence")
    chain_seconds: Measure
    wall_seconds: Measure
