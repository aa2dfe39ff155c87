"""Tables: CSV with commas, semicolons or tabs, and Parquet, under SUMO's column names or plain ones."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from skyrelay.core.errors import TraceError
from skyrelay.mobility.formats.samples import MAX_SAMPLES, Samples, counted, open_bytes

MAX_HEADER = 64 * 1024
ROLES = {
    "time": ("time", "timestep_time", "timestamp"),
    "id": ("id", "vehicle_id", "vehicle"),
    "x": ("x", "vehicle_x"),
    "y": ("y", "vehicle_y"),
    "longitude": ("lon", "longitude", "lng", "vehicle_lon"),
    "latitude": ("lat", "latitude", "vehicle_lat"),
    "speed": ("speed", "vehicle_speed"),
}
"""What a column may be called, in any case; SUMO's tables put the element's name before the attribute's."""
_SUMO_PLACE = ("vehicle_lane", "vehicle_edge")


def read_csv(path: Path) -> Samples:
    """Read a CSV file; everything is text until it is known what it stands for, so that ids stay what they are."""
    with open_bytes(path) as stream:
        first = stream.readline(MAX_HEADER)
    try:
        header = first.decode("utf-8-sig").rstrip("\r\n")
    except UnicodeDecodeError:
        raise TraceError(f"{path}: row 1", None, "text in UTF-8") from None
    delimiter = max(",;\t", key=header.count)
    names = next(csv.reader([header], delimiter=delimiter), [])
    columns = _columns(names, path)
    wanted = [*columns.values(), *(name for name in names if name.strip().lower() in _SUMO_PLACE)]
    with open_bytes(path) as stream:
        table = pyarrow.csv.read_csv(
            stream,
            parse_options=pyarrow.csv.ParseOptions(delimiter=delimiter, newlines_in_values='"' in header),
            convert_options=pyarrow.csv.ConvertOptions(
                include_columns=wanted, column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False
            ),
        )
    return _samples(table, columns, "", path)


def read_parquet(path: Path) -> Samples:
    """Read a Parquet file."""
    file = pq.ParquetFile(path)
    if file.metadata.num_rows > MAX_SAMPLES:
        raise TraceError(path, f"{file.metadata.num_rows} rows", f"at most {MAX_SAMPLES}")
    names = file.schema_arrow.names
    columns = _columns(names, path)
    wanted = [*columns.values(), *(name for name in names if name.strip().lower() in _SUMO_PLACE)]
    table = file.read(columns=wanted)
    metadata = table.schema.metadata or {}
    attribution = "; ".join(
        metadata[key].decode("utf-8", "replace") for key in (b"attribution", b"source", b"license") if key in metadata
    )
    return _samples(table, columns, attribution, path)


def _columns(names: Sequence[str], path: Path) -> dict[str, str]:
    """The column of each role.

    Raises:
        TraceError: a role has no column, or more than one.
    """
    columns: dict[str, str] = {}
    for role, known in ROLES.items():
        found = [name for name in names if name.strip().lower() in known]
        if len(found) > 1:
            raise TraceError(path, ", ".join(found), f"one column for the {role}")
        if found:
            columns[role] = found[0]
    if "x" in columns and "y" in columns:
        columns.pop("longitude", None)
        columns.pop("latitude", None)
    wanted = ("time", "id", *(("longitude", "latitude") if "longitude" in columns else ("x", "y")))
    for role in wanted:
        if role not in columns:
            shown = ", ".join(names)[:200] or "no columns"
            raise TraceError(path, shown, f"a column {role!r} among its columns (or {', '.join(ROLES[role][1:])})")
    return {role: columns[role] for role in (*wanted, "speed") if role in columns}


def _samples(table: pa.Table, columns: dict[str, str], attribution: str, path: Path) -> Samples:
    """The columns under their roles, without rows of a time alone and without pedestrians."""
    if table.num_rows > MAX_SAMPLES:
        raise TraceError(path, f"{table.num_rows} rows", f"at most {MAX_SAMPLES}")
    geographic = "longitude" in columns
    names = {"longitude": "x", "latitude": "y"}
    notes = []
    kept = table
    # SUMO writes a row with the time alone for a step without traffic.
    blank = [_is_blank(kept[columns[role]]) for role in columns if role not in {"time", "speed"}]
    nobody = blank[0]
    for other in blank[1:]:
        nobody = pc.and_(nobody, other)
    if pc.any(nobody).as_py():
        kept = kept.filter(pc.invert(nobody))
    # Vehicles are on a lane; pedestrians are on an edge, and SUMO's tables put both under the vehicles' names.
    places = {name.strip().lower(): name for name in kept.column_names}
    if all(name in places for name in _SUMO_PLACE):
        lane, edge = (_is_blank(kept[places[name]]) for name in _SUMO_PLACE)
        on_foot = pc.and_(lane, pc.invert(edge))
        if walkers := pc.sum(on_foot).as_py():
            kept = kept.filter(pc.invert(on_foot))
            notes.append(f"{counted(walkers, 'row')} of pedestrians left out (on an edge, on no lane)")
    renamed = pa.table({names.get(role, role): kept[column] for role, column in columns.items()})
    return Samples(renamed, geographic, attribution, tuple(notes))


def _is_blank(column: pa.ChunkedArray) -> pa.ChunkedArray:
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        return pc.fill_null(pc.equal(pc.utf8_length(pc.utf8_trim_whitespace(column)), 0), True)
    return pc.is_null(column)
