"""A run folder as `skyrelay run` leaves it, read and checked: nothing of the live run is needed to draw it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrelay.core.errors import RunFolderError, ScenarioError
from skyrelay.core.scenario import Scenario, load_scenario
from skyrelay.core.zones import ZoneGrid

Table = Mapping[str, npt.NDArray[Any]]
"""Columns of equal length, by name; text columns hold ``str`` objects."""

Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Measure = Annotated[float, Field(allow_inf_nan=False)]

_NEEDED: dict[str, dict[str, pa.DataType]] = {
    "vehicles.parquet": {
        "step": pa.int32(),
        "vehicle": pa.string(),
        "x": pa.float64(),
        "y": pa.float64(),
        "zone": pa.int32(),
        "uav": pa.string(),
        "covered": pa.bool_(),
        "static_uav": pa.string(),
        "static_covered": pa.bool_(),
    },
    "uavs.parquet": {
        "step": pa.int32(),
        "uav": pa.string(),
        "x": pa.float64(),
        "y": pa.float64(),
        "zone": pa.int32(),
        "selected": pa.bool_(),
        "battery": pa.float64(),
        "static_x": pa.float64(),
        "static_y": pa.float64(),
        "static_zone": pa.int32(),
        "static_selected": pa.bool_(),
    },
    "metrics.parquet": {
        "step": pa.int32(),
        "zone": pa.int32(),
        "vehicles": pa.int32(),
        "covered": pa.int32(),
        "coverage": pa.float64(),
        "connectivity": pa.float64(),
        "connectivity_neighbor": pa.float64(),
        "served_mbps": pa.float64(),
        "energy_percent": pa.float64(),
        "static_coverage": pa.float64(),
        "static_connectivity": pa.float64(),
    },
    "proposals.parquet": {
        "period": pa.int32(),
        "round": pa.int32(),
        "zone": pa.int32(),
        "vehicle": pa.string(),
        "uav": pa.string(),
        "qou": pa.float64(),
        "demand_kbps": pa.int32(),
        "accepted": pa.bool_(),
    },
    "events.parquet": {
        "block": pa.int64(),
        "tx": pa.int32(),
        "log": pa.int32(),
        "step": pa.int32(),
        "name": pa.string(),
        "args": pa.string(),
    },
    "accounts.parquet": {
        "name": pa.string(),
        "address": pa.string(),
    },
}
_POSITIONS = {"vehicles.parquet": ("x", "y"), "uavs.parquet": ("x", "y", "static_x", "static_y")}


class Grid(BaseModel):
    """`ZoneGrid` as ``summary.json`` has it."""

    model_config = ConfigDict(frozen=True)

    x0: Measure
    y0: Measure
    side: Positive
    columns: Annotated[int, Field(ge=1)]
    rows: Annotated[int, Field(ge=1)]


class Summary(BaseModel):
    """What the report reads of ``summary.json``; a measure is None where there was nothing to measure."""

    model_config = ConfigDict(frozen=True, protected_namespaces=())

    name: str
    seed: int
    vehicles: Count
    uavs: Count
    zones: Count
    periods: Count
    steps: Annotated[int, Field(ge=1)]
    served: Count
    mean_qou: Measure | None
    mean_qov: Measure | None
    coverage: Measure | None
    connectivity: Measure | None
    connectivity_neighbor: Measure | None
    static_coverage: Measure | None
    static_connectivity: Measure | None
    transactions: Count
    gas_used: Count
    blocks: Count
    chain_seconds: Measure
    wall_seconds: Measure
    model_cids: list[str] | dict[str, str]
    chain_head: str
    contract: str
    grid: Grid
    range_m: Positive
    step_seconds: Positive
    period_steps: Annotated[int, Field(ge=1)]
    attribution: str = Field("", description="whose vehicle trace was replayed, and under which licence")


@dataclass(frozen=True)
class Run:
    """A run folder in memory.

    Attributes:
        path: of the folder.
        scenario: as resolved when the run was made.
        summary: of ``summary.json``.
        vehicles, uavs, metrics, proposals, events, accounts: columns of the Parquet files of these names; positions in
            m, battery and energy in %, QoU 0-100, step and period counted from 0; ``uav`` is "" for an unserved
            vehicle; ``zone`` is 0 for a UAV that has landed and, in ``metrics``, for the whole area; ``static_*`` is
            the comparator, the same fleet hovering; ``events.args`` is JSON, an object by event.
    """

    path: Path
    scenario: Scenario
    summary: Summary
    vehicles: Table
    uavs: Table
    metrics: Table
    proposals: Table
    events: Table
    accounts: Table

    @property
    def grid(self) -> ZoneGrid:
        """The zones."""
        return ZoneGrid(**self.summary.grid.model_dump())

    def metric(self, name: str, zone: int = 0) -> npt.NDArray[np.float64]:
        """[steps + 1] values of a metric in a zone (0: the whole area), NaN where there is none."""
        values = np.full(self.summary.steps + 1, np.nan)
        rows = self.metrics["zone"] == zone
        values[self.metrics["step"][rows]] = self.metrics[name][rows]
        return values


def read_run(path: Path) -> Run:
    """Read and check a run folder.

    Raises:
        RunFolderError: a file is missing or cannot be read, or a key, column or value is missing or does not fit.
    """
    if not path.is_dir():
        raise RunFolderError("run folder", str(path), "a folder that `skyrelay run` has left")
    scenario = _read_scenario(path / "scenario.toml")
    summary = _read_summary(path / "summary.json")
    tables = {Path(name).stem: _read_table(path / name, columns) for name, columns in _NEEDED.items()}
    run = Run(path, scenario, summary, **tables)
    _check(run)
    return run


def _read_scenario(path: Path) -> Scenario:
    if not path.is_file():
        raise RunFolderError(path, None, "a file of the run folder; it is not there")
    try:
        return load_scenario(path)
    except ScenarioError as error:
        raise RunFolderError(error.place, error.value, error.expected) from error


def _read_summary(path: Path) -> Summary:
    try:
        return Summary.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise RunFolderError(path, None, "a file of the run folder; it is not there") from None
    except ValidationError as error:
        fault = error.errors()[0]
        place = ": ".join([str(path), ".".join(map(str, fault["loc"]))]) if fault["loc"] else path
        if fault["type"] == "missing":
            raise RunFolderError(place, None, "this key; it is missing") from None
        raise RunFolderError(place, fault["input"], fault["msg"].removeprefix("Input should be ")) from None
    except (OSError, ValueError) as error:
        raise RunFolderError(path, None, f"readable JSON ({error})") from error


def _read_table(path: Path, columns: Mapping[str, pa.DataType]) -> Table:
    try:
        # Through an open file, so that the folder's own name is never taken for a partition of the data.
        with path.open("rb") as file:
            table = pq.read_table(file)
    except FileNotFoundError:
        raise RunFolderError(path, None, "a file of the run folder; it is not there") from None
    except (OSError, pa.ArrowException) as error:
        raise RunFolderError(path, None, f"readable Parquet ({' '.join(str(error).split())})") from error
    read: dict[str, npt.NDArray[Any]] = {}
    for name, kind in columns.items():
        if name not in table.column_names:
            raise RunFolderError(path, ", ".join(table.column_names), f"a column {name!r} among its columns")
        try:
            column = table[name].cast(kind)
        except pa.ArrowException:
            raise RunFolderError(f"{path}: {name}", str(table[name].type), f"a column of {kind}") from None
        if column.null_count:
            row = pc.index(column.is_null(), True).as_py()
            raise RunFolderError(f"{path}: {name}[{row}]", "null", f"a value of {kind}")
        read[name] = column.to_numpy(zero_copy_only=False)
    for name in _POSITIONS.get(path.name, ()):
        if not np.isfinite(read[name]).all():
            row = int(np.argmin(np.isfinite(read[name])))
            raise RunFolderError(f"{path}: {name}[{row}]", float(read[name][row]), "a finite position [m]")
    return read


def _check(run: Run) -> None:
    """What one file says must fit what another says."""
    steps, zones = run.summary.steps, run.summary.grid.columns * run.summary.grid.rows
    for table, name, low, high, meaning in (
        ("vehicles", "step", 0, steps, "a step of the run"),
        ("vehicles", "zone", 0, zones, "a zone of the grid"),
        ("uavs", "step", 0, steps, "a step of the run"),
        ("uavs", "zone", 0, zones, "a zone of the grid"),
        ("uavs", "static_zone", 0, zones, "a zone of the grid"),
        ("metrics", "step", 0, steps, "a step of the run"),
        ("metrics", "zone", 0, zones, "a zone of the grid, or 0"),
    ):
        column = getattr(run, table)[name]
        wrong = (column < low) | (column > high)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise RunFolderError(
                f"{run.path / table}.parquet: {name}[{row}]", int(column[row]), f"{meaning} ({low} to {high})"
            )
    fleet = set(run.uavs["uav"])
    for table, name in (("vehicles", "uav"), ("vehicles", "static_uav"), ("proposals", "uav")):
        unknown = sorted(set(getattr(run, table)[name]) - fleet - {""})
        if unknown:
            raise RunFolderError(f"{run.path / table}.parquet: {name}", unknown[0], "a UAV of uavs.parquet")
