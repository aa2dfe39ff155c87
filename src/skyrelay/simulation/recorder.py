"""The tables of a run folder: their columns, and how they are gathered and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skyrelay.core.files import atomic_path

_F32, _F64, _I32, _I64, _TEXT = pa.float32(), pa.float64(), pa.int32(), pa.int64(), pa.string()

SCHEMAS: dict[str, pa.Schema] = {
    # One row for each connected vehicle that is there at a step; uav is "" where nobody serves it.
    # static_*, here and below: the same for the comparator, the same fleet that hovers.
    "vehicles": pa.schema(
        {
            "step": _I32,
            "vehicle": _TEXT,
            "x": _F32,
            "y": _F32,
            "zone": _I32,
            "uav": _TEXT,
            "covered": pa.bool_(),
            "static_uav": _TEXT,
            "static_covered": pa.bool_(),
        }
    ),
    # One row for each UAV at a step; the action is the one that led to the step; zone 0 for one that has landed.
    "uavs": pa.schema(
        {
            "step": _I32,
            "uav": _TEXT,
            "x": _F32,
            "y": _F32,
            "zone": _I32,
            "selected": pa.bool_(),
            "battery": _F32,
            "action": pa.int8(),
            "static_x": _F32,
            "static_y": _F32,
            "static_zone": _I32,
            "static_selected": pa.bool_(),
        }
    ),
    # One row for each zone with a team at a step, and one with zone 0 for the whole area.
    "metrics": pa.schema(
        {
            "step": _I32,
            "time": _F64,
            "zone": _I32,
            "vehicles": _I32,
            "covered": _I32,
            "coverage": _F64,
            "connectivity": _F64,
            "connectivity_neighbor": _F64,
            "served_mbps": _F64,
            "energy_percent": _F64,
            "static_coverage": _F64,
            "static_connectivity": _F64,
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
    # Every event of the contract; args is a JSON object.
    "events": pa.schema({"block": _I64, "tx": _I32, "log": _I32, "step": _I32, "name": _TEXT, "args": _TEXT}),
}


class Recorder:
    """Gathers rows in memory and writes each table whole."""

    def __init__(self) -> None:
        self._batches: dict[str, list[pa.RecordBatch]] = {name: [] for name in SCHEMAS}

    def add(self, table: str, **columns: Sequence[Any] | np.ndarray | float | str | bool) -> None:
        """Append rows; a scalar stands for all of them."""
        schema = SCHEMAS[table]
        lengths = {
            len(value)
            for value in columns.values()
            if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)
        }
        (count,) = lengths or {1}
        arrays = []
        for field in schema:
            value = columns.pop(field.name)
            if isinstance(value, np.ndarray | Sequence) and not isinstance(value, str):
                arrays.append(pa.array(value, field.type, from_pandas=False))
            else:
                arrays.append(pa.repeat(pa.scalar(value, field.type), count))
        if columns:
            raise KeyError(f"{table} has no column {', '.join(columns)}")
        self._batches[table].append(pa.RecordBatch.from_arrays(arrays, schema=schema))

    def table(self, name: str) -> pa.Table:
        """What has been gathered of one table."""
        return pa.Table.from_batches(self._batches[name], schema=SCHEMAS[name])

    def write(self, folder: Path) -> None:
        """Write every table as ``<name>.parquet``."""
        for name in SCHEMAS:
            with atomic_path(folder / f"{name}.parquet") as beside:
                # The checksums let the audit tell a damaged page from a changed one.
                pq.write_table(self.table(name), beside, compression="zstd", write_page_checksum=True)
