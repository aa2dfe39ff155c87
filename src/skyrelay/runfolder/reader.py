"""A run folder read by someone who trusts none of it: sizes bounded, types and values checked, before they are used.

What one file says must fit what the others say; whether it is true is for `skyrelay audit` to find out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import ValidationError

from skyrelay.core.errors import RunFolderError, ScenarioError
from skyrelay.core.scenario import Scenario, load_scenario
from skyrelay.core.untrusted import parse_json
from skyrelay.core.zones import ZoneGrid
from skyrelay.runfolder.folder import SCENARIO, SUMMARY
from skyrelay.runfolder.schema import CHARGING_STATES, OPTIONAL, POSITIONS, RATES, SCHEMAS, Summary

Table = Mapping[str, npt.NDArray[Any]]
"""Columns of equal length, by name; text columns hold ``str`` objects."""

MAX_TEXT_FILE = 16 * 2**20
MAX_TABLE_FILE = 2**30
MAX_TABLE = 4 * 2**30
MAX_ROWS = 2**26
MAX_TEXT = 2**20
"""Bytes of a text file, of a table as it lies there and unpacked, rows, and bytes of one text in a table."""


@dataclass(frozen=True)
class Run:
    """A run folder in memory.

    Attributes:
        path: of the folder.
        scenario: as resolved when the run was made.
        summary: of ``summary.json``.
        vehicles, uavs, metrics, proposals, events, accounts, streets, charging: columns of the Parquet files of these
            names; positions in m, battery and energy in %, QoU 0-100, step and period counted from 0; ``uav`` is "" for
            an unserved vehicle; ``zone`` is 0 for a UAV that has landed or is away to be charged and, in ``metrics``,
            for the whole area; ``static_*`` is the comparator, the same fleet hovering; ``events.args`` is JSON, an
            object by event.
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
    streets: Table
    charging: Table

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
    require_folder(path)
    scenario = read_scenario(path)
    summary = read_summary(path)
    names = ("vehicles", "uavs", "metrics", "proposals", "events", "accounts", "streets", "charging")
    run = Run(path, scenario, summary, **{name: read_table(path, name) for name in names})
    _check(run)
    return run


def require_folder(path: Path) -> None:
    """Raises RunFolderError where there is no folder."""
    if not path.is_dir():
        raise RunFolderError("run folder", str(path), "a folder that `skyrelay run` has left")


def read_scenario(folder: Path) -> Scenario:
    """The scenario as resolved.

    Raises:
        RunFolderError: the file is missing, or has a key or value that does not fit.
    """
    path = folder / SCENARIO
    _bounded_size(path, MAX_TEXT_FILE)
    try:
        return load_scenario(path)
    except ScenarioError as error:
        raise RunFolderError(error.place, error.value, error.expected) from error


def read_summary(folder: Path) -> Summary:
    """``summary.json``.

    Raises:
        RunFolderError: the file is missing or no JSON, or a key is missing or does not fit.
    """
    path = folder / SUMMARY
    _bounded_size(path, MAX_TEXT_FILE)
    try:
        return Summary.model_validate(parse_json(path.read_bytes(), size=MAX_TEXT_FILE))
    except ValidationError as error:
        fault = error.errors()[0]
        place = ": ".join([str(path), ".".join(map(str, fault["loc"]))]) if fault["loc"] else path
        if fault["type"] == "missing":
            raise RunFolderError(place, None, "this key; it is missing") from None
        raise RunFolderError(place, fault["input"], fault["msg"].removeprefix("Input should be ")) from None
    except (OSError, ValueError) as error:
        raise RunFolderError(path, None, f"readable JSON ({error})") from error


def read_rows(folder: Path, name: str, **where: object) -> list[dict[str, Any]]:
    """A small table row by row, or of any table the rows where these columns have these values.

    Raises:
        RunFolderError: as `read_table`.
    """
    table = read_table(folder, name)
    wanted = [table[column] == value for column, value in where.items()]
    columns = [(column[np.all(wanted, axis=0)] if wanted else column).tolist() for column in table.values()]
    return [dict(zip(table, row, strict=True)) for row in zip(*columns, strict=True)]


def read_table(folder: Path, name: str) -> Table:
    """The columns of a table that `SCHEMAS` names; those of numbers with a fraction as 64-bit floats.

    An optional table that is not there has no rows.

    Raises:
        RunFolderError: the file is missing, too large or no Parquet, or a column is missing or does not fit.
    """
    path = folder / f"{name}.parquet"
    schema = SCHEMAS[name]
    if name in OPTIONAL and not path.exists():
        nothing = {field.name: pa.array([], _read_as(field.type)) for field in schema}
        return {name: column.to_numpy(zero_copy_only=False) for name, column in nothing.items()}
    _bounded_size(path, MAX_TABLE_FILE)
    texts = [field.name for field in schema if pa.types.is_string(field.type)]
    try:
        # Through an open file, so that the folder's own name is never taken for a partition of the data. Texts stay
        # numbers into a list of distinct ones: a small file cannot become many copies of a long text.
        with path.open("rb") as file:
            _check_shape(path, _open(file, []), schema)
            read = _open(file, texts).read(columns=schema.names, use_threads=False)
        table = {field.name: _column(path, read[field.name], field) for field in schema}
    except (OSError, pa.ArrowException, ValueError) as error:
        raise RunFolderError(path, None, f"readable Parquet ({' '.join(str(error).split())})") from error
    for column in POSITIONS.get(name, ()):
        finite = np.isfinite(table[column])
        if not finite.all():
            row = int(np.argmin(finite))
            raise RunFolderError(f"{path}: {column}[{row}]", float(table[column][row]), "a finite position [m]")
    for column in RATES.get(name, ()):
        rates = np.isfinite(table[column]) & (table[column] >= 0)
        if not rates.all():
            row = int(np.argmin(rates))
            raise RunFolderError(f"{path}: {column}[{row}]", float(table[column][row]), "a rate of 0 kbit/s or more")
    return table


def _bounded_size(path: Path, most: int) -> None:
    if not path.is_file():
        raise RunFolderError(path, None, "a file of the run folder; it is not there")
    size = path.stat().st_size
    if size > most:
        raise RunFolderError(path, f"{size:,} bytes", f"at most {most:,} bytes")


def _open(file: BinaryIO, texts: list[str]) -> pq.ParquetFile:
    return pq.ParquetFile(
        file,
        read_dictionary=texts,
        page_checksum_verification=True,
        thrift_string_size_limit=MAX_TEXT,
        thrift_container_size_limit=MAX_TEXT,
    )


def _check_shape(path: Path, parquet: pq.ParquetFile, schema: pa.Schema) -> None:
    """What the file says of itself, before any of its pages is unpacked."""
    metadata = parquet.metadata
    if metadata.num_rows > MAX_ROWS:
        raise RunFolderError(path, f"{metadata.num_rows:,} rows", f"at most {MAX_ROWS:,} rows")
    size = sum(metadata.row_group(group).total_byte_size for group in range(metadata.num_row_groups))
    if not 0 <= size <= MAX_TABLE:
        raise RunFolderError(path, f"{size:,} bytes unpacked", f"at most {MAX_TABLE:,} bytes")
    found = parquet.schema_arrow
    for field in schema:
        places = found.get_all_field_indices(field.name)
        if len(places) != 1:
            names = ", ".join(found.names)
            raise RunFolderError(path, names, f"a column {field.name!r} among its columns{', once' * bool(places)}")
        kind = found.field(places[0]).type
        if not _fits(kind, field.type):
            raise RunFolderError(f"{path}: {field.name}", str(kind), f"a column of {_read_as(field.type)}")


def _fits(found: pa.DataType, wanted: pa.DataType) -> bool:
    """Whether a column of one plain type may be read as another, if its values allow."""
    if pa.types.is_string(wanted):
        inner = found.value_type if pa.types.is_dictionary(found) else found
        return bool(pa.types.is_string(inner) or pa.types.is_large_string(inner))
    if pa.types.is_boolean(wanted):
        return bool(pa.types.is_boolean(found))
    return bool(pa.types.is_integer(found) or (pa.types.is_floating(wanted) and pa.types.is_floating(found)))


def _read_as(kind: pa.DataType) -> pa.DataType:
    return pa.float64() if pa.types.is_floating(kind) else kind


def _column(path: Path, column: pa.ChunkedArray, field: pa.Field) -> npt.NDArray[Any]:
    if column.null_count:
        row = pc.index(column.is_null(), True).as_py()
        raise RunFolderError(f"{path}: {field.name}[{row}]", "null", f"a value of {_read_as(field.type)}")
    if pa.types.is_string(field.type):
        return _texts(path, column, field.name)
    try:
        values: npt.NDArray[Any] = column.cast(_read_as(field.type)).to_numpy(zero_copy_only=False)
    except pa.ArrowException:
        raise RunFolderError(f"{path}: {field.name}", str(column.type), f"a column of {_read_as(field.type)}") from None
    return values


def _texts(path: Path, column: pa.ChunkedArray, name: str) -> npt.NDArray[Any]:
    """Each distinct text is one object, however often it stands there."""
    parts: list[npt.NDArray[Any]] = [np.empty(0, dtype=object)]
    for chunk in column.chunks:
        coded = chunk if pa.types.is_dictionary(chunk.type) else chunk.dictionary_encode()
        longest = pc.max(pc.binary_length(coded.dictionary)).as_py() or 0
        if longest > MAX_TEXT:
            raise RunFolderError(f"{path}: {name}", f"a text of {longest:,} bytes", f"texts of at most {MAX_TEXT:,}")
        distinct = np.array([*coded.dictionary.to_pylist(), None], dtype=object)[:-1]
        parts.append(distinct[coded.indices.to_numpy(zero_copy_only=False)])
    return np.concatenate(parts)


def _check(run: Run) -> None:
    """What one file says must fit what another says."""
    summary = run.summary
    steps, zones = summary.steps, summary.grid.columns * summary.grid.rows
    periods = -(-steps // summary.period_steps)
    for key, found, fits in (("zones", summary.zones, zones), ("periods", summary.periods, periods)):
        if found != fits:
            raise RunFolderError(f"{run.path / SUMMARY}: {key}", found, f"{fits}, as its other keys have it")
    for table, name, low, high, meaning in (
        ("vehicles", "step", 0, steps, "a step of the run"),
        ("vehicles", "zone", 0, zones, "a zone of the grid"),
        ("uavs", "step", 0, steps, "a step of the run"),
        ("uavs", "zone", 0, zones, "a zone of the grid"),
        ("uavs", "static_zone", 0, zones, "a zone of the grid"),
        ("metrics", "step", 0, steps, "a step of the run"),
        ("metrics", "zone", 0, zones, "a zone of the grid, or 0"),
        ("charging", "step", 0, steps, "a step of the run"),
        ("proposals", "period", 0, periods - 1, "a period of the run"),
    ):
        column = getattr(run, table)[name]
        wrong = (column < low) | (column > high)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise RunFolderError(
                f"{run.path / table}.parquet: {name}[{row}]", int(column[row]), f"{meaning} ({low} to {high})"
            )
    odd = sorted(set(run.charging["state"]) - CHARGING_STATES)
    if odd:
        raise RunFolderError(run.path / "charging.parquet", odd[0], f"one of {', '.join(sorted(CHARGING_STATES))}")
    street = run.streets["street"]
    if len(street) and (street[0] != 0 or not np.isin(np.diff(street), (0, 1)).all()):
        raise RunFolderError(run.path / "streets.parquet", None, "streets numbered from 0, one after the other")
    fleet = set(run.uavs["uav"])
    if len(run.uavs["uav"]) != len(fleet) * (steps + 1):  # the page has a place for each
        rows = len(run.uavs["uav"])
        raise RunFolderError(
            run.path / "uavs.parquet",
            f"{rows:,} rows",
            f"one for each of {len(fleet)} UAVs at each of {steps + 1} steps",
        )
    for table, name in (("vehicles", "uav"), ("vehicles", "static_uav"), ("proposals", "uav"), ("charging", "uav")):
        unknown = sorted(set(getattr(run, table)[name]) - fleet - {""})
        if unknown:
            raise RunFolderError(f"{run.path / table}.parquet: {name}", unknown[0], "a UAV of uavs.parquet")
