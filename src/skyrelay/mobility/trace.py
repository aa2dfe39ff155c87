"""Floating-car data from files: Parquet, CSV or XML, in SUMO's names or the short ones (time, id, x, y)."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast
from xml.etree.ElementTree import ParseError, iterparse

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from skyrelay.core.entities import FloatArray
from skyrelay.core.errors import TraceError

COLUMNS = ("time", "id", "x", "y")
# SUMO's CSV and Parquet outputs prefix the element's name.
_SUMO_NAMES = {"timestep_time": "time", "vehicle_id": "id", "vehicle_x": "x", "vehicle_y": "y"}
SMALLEST_EXTENT = 1.0
"""A trace that spans less than this [m] is taken for degrees, or for nothing that moves."""


@dataclass(frozen=True)
class Trace:
    """Samples sorted by vehicle, then time.

    Attributes:
        ids: [V] vehicle ids, sorted.
        vehicle: [M] row of ``ids`` that a sample belongs to.
        time: [M] [s], rising within a vehicle.
        x, y: [M] position [m].
        attribution: what the file says of its source and licence, or an empty text.
    """

    ids: tuple[str, ...]
    vehicle: npt.NDArray[np.int64]
    time: FloatArray
    x: FloatArray
    y: FloatArray
    attribution: str

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Smallest x, smallest y, largest x, largest y [m]."""
        return float(self.x.min()), float(self.y.min()), float(self.x.max()), float(self.y.max())


def read_trace(path: Path) -> Trace:
    """Read a trace, whatever of the three formats it is in (by its ending; ``.xml.gz`` too).

    Raises:
        TraceError: the file cannot be read, lacks a column, is empty, or has a value that is no number, a time that is
            not finite, or two samples of one vehicle at one time.
    """
    suffixes = [suffix.lower() for suffix in path.suffixes]
    try:
        if suffixes[-1:] == [".parquet"]:
            table = pq.read_table(path)
        elif suffixes[-1:] == [".csv"]:
            table = _read_csv(path)
        elif suffixes[-1:] == [".xml"] or suffixes[-2:] == [".xml", ".gz"]:
            table = _read_xml(path)
        else:
            raise TraceError(path, "".join(path.suffixes) or "no ending", "a .parquet, .csv, .xml or .xml.gz file")
    except FileNotFoundError:
        raise TraceError(path, None, "a file that exists") from None
    except (OSError, pa.ArrowException, ParseError, EOFError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise TraceError(path, None, f"floating-car data that can be read ({reason})") from error
    return _from_table(table, path)


def _read_csv(path: Path) -> pa.Table:
    with path.open(encoding="utf-8") as stream:
        header = stream.readline()
    delimiter = ";" if header.count(";") > header.count(",") else ","
    return pyarrow.csv.read_csv(path, parse_options=pyarrow.csv.ParseOptions(delimiter=delimiter))


def _read_xml(path: Path) -> pa.Table:
    # iterparse expands no external entities, and expat limits the amplification of internal ones.
    columns: dict[str, list[str | None]] = {name: [] for name in COLUMNS}
    time: str | None = None
    compressed = path.suffix.lower() == ".gz"
    with cast("IO[bytes]", gzip.open(path) if compressed else path.open("rb")) as stream:
        for event, element in iterparse(stream, events=("start", "end")):  # noqa: S314
            if element.tag == "timestep":
                if event == "start":
                    time = element.get("time")
                else:
                    element.clear()  # keeps memory flat over a long trace
            elif element.tag == "vehicle" and event == "start":
                columns["time"].append(time)
                for name in COLUMNS[1:]:
                    columns[name].append(element.get(name))
    return pa.table(columns)


def _from_table(table: pa.Table, path: Path) -> Trace:
    metadata = table.schema.metadata or {}
    table = table.rename_columns([_SUMO_NAMES.get(name, name) for name in table.column_names])
    for name in COLUMNS:
        if name not in table.column_names:
            raise TraceError(path, ", ".join(table.column_names), f"a column {name!r} among its columns")
    if table.num_rows == 0:
        raise TraceError(path, "no rows", "at least one sample")
    numbers = {name: _numbers(table[name], name, path) for name in ("time", "x", "y")}
    identifiers = table["id"].combine_chunks()
    if isinstance(identifiers, pa.DictionaryArray):
        identifiers = identifiers.dictionary_decode()
    if identifiers.null_count:
        raise TraceError(f"{path}: row {_first_null(identifiers)}: id", None, "the id of a vehicle")
    ids, vehicle = _sorted_ids(identifiers)
    order = np.lexsort((numbers["time"], vehicle))
    vehicle = vehicle[order]
    time, x, y = (numbers[name][order] for name in ("time", "x", "y"))
    twice = (np.diff(vehicle) == 0) & (np.diff(time) == 0)
    if twice.any():
        row = int(np.argmax(twice))
        raise TraceError(path, f"{ids[vehicle[row]]} twice at {time[row]:g} s", "one sample of a vehicle at a time")
    extent = max(np.ptp(x), np.ptp(y))
    if extent < SMALLEST_EXTENT:
        raise TraceError(f"{path}: x, y", f"{extent:g} across", "positions in metres (project degrees first)")
    attribution = "; ".join(
        metadata[key].decode("utf-8", "replace") for key in (b"attribution", b"source", b"license") if key in metadata
    )
    return Trace(tuple(ids), vehicle, time, x, y, attribution)


def _sorted_ids(column: pa.Array) -> tuple[list[str], npt.NDArray[np.int64]]:
    """Distinct ids as sorted text, and the row of each sample in them."""
    encoded = column.cast(pa.string()).dictionary_encode()
    ids: list[str] = encoded.dictionary.to_pylist()
    order = sorted(range(len(ids)), key=ids.__getitem__)
    rank = np.empty(len(ids), np.int64)
    rank[order] = np.arange(len(ids))
    return [ids[row] for row in order], rank[encoded.indices.to_numpy()]


def _numbers(column: pa.ChunkedArray, name: str, path: Path) -> FloatArray:
    try:
        cast = column.cast(pa.float64())
    except pa.ArrowException:
        row = next(i for i, value in enumerate(column.to_pylist()) if not _is_number(value))
        raise TraceError(f"{path}: row {row + 1}: {name}", column[row].as_py(), "a number") from None
    valid = pc.fill_null(pc.is_finite(cast), False).combine_chunks()
    if not pc.all(valid).as_py():
        row = pc.index(valid, False).as_py()
        raise TraceError(f"{path}: row {row + 1}: {name}", column[row].as_py(), "a finite number")
    values: FloatArray = cast.to_numpy()
    return values


def _is_number(value: object) -> bool:
    try:
        float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return value is None
    return True


def _first_null(column: pa.Array) -> int:
    return int(pc.index(pc.is_null(column), True).as_py()) + 1
