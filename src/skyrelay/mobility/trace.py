"""Floating-car data from files of every kind: which kind, in which units, and whether it can be true."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from skyrelay.core.entities import FloatArray
from skyrelay.core.errors import TraceError
from skyrelay.core.files import atomic_path
from skyrelay.core.scenario import Mobility
from skyrelay.mobility.formats.fcd import read_fcd
from skyrelay.mobility.formats.geo import read_geojson, read_gpx
from skyrelay.mobility.formats.movements import read_bonnmotion, read_ns2
from skyrelay.mobility.formats.samples import Samples, counted
from skyrelay.mobility.formats.tables import read_csv, read_parquet
from skyrelay.mobility.plane import name_of, project

SMALLEST_EXTENT = 1.0
"""A trace that spans less than this [m] is of nothing that moves, or not in metres."""
FASTEST = 150.0
"""No vehicle drives faster [m/s]; what does between two samples was lost in between, or has jumped."""
SLOWEST = 0.01
"""Units of length per second; positions that could be degrees and are never faster are taken for degrees."""
DISAGREEMENT = 10.0
"""Speeds written beside the positions and those that the positions tell may differ by this factor (km/h, not m/s)."""
SUMO_NOWHERE = -1073741824.0
"""What SUMO writes where a vehicle has no position."""

KINDS: Mapping[str, Callable[[Path], Samples]] = {
    ".parquet": read_parquet,
    ".csv": read_csv,
    ".tsv": read_csv,
    ".xml": read_fcd,
    ".tcl": read_ns2,
    ".ns_movements": read_ns2,
    ".movements": read_bonnmotion,
    ".gpx": read_gpx,
    ".geojson": read_geojson,
}
"""Which reader a file's ending asks for; all but Parquet may end in ``.gz`` as well."""
METRES = {"m": 1.0, "km": 1000.0, "ft": 0.3048}
TICKS = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}

DEFAULTS = Mobility()

Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Trace:
    """Samples sorted by vehicle, then time.

    Attributes:
        ids: [V] vehicle ids, sorted.
        vehicle: [M] row of ``ids`` that a sample belongs to.
        time: [M] [s], rising within a vehicle.
        x, y: [M] position [m].
        attribution: what the file says of its source and licence, or an empty text.
        notes: what was made of the file: projection, rows left out, how far apart the samples are.
        plane: the EPSG code that degrees were projected to; None where the file was in metres.
    """

    ids: tuple[str, ...]
    vehicle: Ints
    time: FloatArray
    x: FloatArray
    y: FloatArray
    attribution: str
    notes: tuple[str, ...] = ()
    plane: int | None = None

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Smallest x, smallest y, largest x, largest y [m]."""
        return float(self.x.min()), float(self.y.min()), float(self.x.max()), float(self.y.max())

    def facts(self) -> dict[str, Any]:
        """What it holds, for a person or a program."""
        west, south, east, north = self.box
        same, gap, _ = self.pairs
        begin, end = float(self.time.min()), float(self.time.max())
        return {
            "vehicles": len(self.ids),
            "samples": len(self.time),
            "begin_seconds": begin,
            "seconds": end - begin,
            "sample_seconds": float(np.median(gap[same])) if same.any() else None,
            "west_m": west,
            "south_m": south,
            "width_m": east - west,
            "height_m": north - south,
            "attribution": self.attribution,
            "notes": list(self.notes),
        }

    @property
    def pairs(self) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray]:
        """[M - 1] of neighbouring samples: whether they are one vehicle's, and how far apart [s] and [m]."""
        distance = np.hypot(np.diff(self.x), np.diff(self.y))
        return np.diff(self.vehicle) == 0, np.diff(self.time), distance


def read_trace(path: Path, config: Mobility = DEFAULTS) -> Trace:
    """Read a trace, whatever kind of file it is in (`KINDS`), and check that it can be true.

    Args:
        config: `units`, `time_unit`, `max_gap` and `lost_fixes` of the scenario.
    Raises:
        TraceError: the file cannot be read, lacks something, has a value that does not fit, or tells of what no vehicle
            does: it names the place, what stands there, and which key says otherwise.
    """
    return _checked(_from_samples(_read(path), path, config), path, config)


def write_parquet(trace: Trace, path: Path) -> None:
    """Write a trace in metres and seconds.

    Raises:
        TraceError: the place may not be written, or does not end in .parquet.
    """
    if path.suffix.lower() != ".parquet":
        raise TraceError("--out", str(path), "a file that ends in .parquet")
    ids = pa.DictionaryArray.from_arrays(pa.array(trace.vehicle, pa.int32()), pa.array(trace.ids, pa.string()))
    metadata = {"attribution": trace.attribution, "notes": "; ".join(trace.notes), "units": "s, m, m"}
    table = pa.table({"time": trace.time, "id": ids.dictionary_decode(), "x": trace.x, "y": trace.y})
    try:
        with atomic_path(path) as beside:
            pq.write_table(table.replace_schema_metadata(metadata), beside, compression="zstd")
    except OSError as error:
        raise TraceError(path, None, f"a place that may be written ({error.strerror})") from error


def _read(path: Path) -> Samples:
    endings = [suffix.lower() for suffix in path.suffixes]
    if endings[-1:] == [".gz"]:
        endings.pop()
    reader = KINDS.get(endings[-1]) if endings else None
    if reader is None or (reader is read_parquet and path.suffix.lower() == ".gz"):
        known = ", ".join(KINDS)
        raise TraceError(
            path, "".join(path.suffixes)[-40:] or "no ending", f"a file that ends in {known} (or .gz after)"
        )
    try:
        return reader(path)
    except FileNotFoundError:
        raise TraceError(path, None, "a file that exists") from None
    except (OSError, pa.ArrowException, ParseError, EOFError, ValueError, MemoryError, OverflowError) as error:
        reason = " ".join(str(error).split())[:120]
        raise TraceError(path, None, f"vehicle positions that can be read ({reason})") from error


def _from_samples(samples: Samples, path: Path, config: Mobility) -> Trace:
    table = samples.table
    if table.num_rows == 0:
        raise TraceError(path, "no rows", "at least one sample")
    notes = list(samples.notes)
    time = _times(table["time"], config, path)
    x, y = (_numbers(table[name], name, path) for name in ("x", "y"))
    speed = _numbers(table["speed"], "speed", path, missing=np.nan) if "speed" in table.column_names else None
    ids, vehicle = _sorted_ids(_identifiers(table["id"], path))
    order = np.lexsort((time, vehicle))
    nowhere = (x == SUMO_NOWHERE) | (y == SUMO_NOWHERE)
    if nowhere.any():
        notes.append(f"{counted(int(nowhere.sum()), 'sample')} without a position left out (SUMO's mark for it)")
        order = order[~nowhere[order]]
        if not len(order):
            raise TraceError(path, "no position", "at least one sample with a position")
    vehicle, time, x, y = vehicle[order], time[order], x[order], y[order]
    speed = None if speed is None else speed[order]
    if len(present := np.unique(vehicle)) < len(ids):
        ids, vehicle = [ids[row] for row in present], np.searchsorted(present, vehicle)
    twice = (np.diff(vehicle) == 0) & (np.diff(time) <= 0)
    if twice.any():
        row = int(np.argmax(twice))
        raise TraceError(
            path, f"{_short(ids[vehicle[row]])} twice at {time[row]:.9g} s", "one sample of a vehicle at a time"
        )
    trace = Trace(tuple(ids), vehicle.astype(np.int64), time, x, y, samples.attribution)
    trace, more = _in_metres(trace, speed, samples.geographic, path, config)
    return _with_notes(trace, *notes, *more)


def _with_notes(trace: Trace, *notes: str) -> Trace:
    return replace(trace, notes=(*trace.notes, *notes))


# Columns


def _identifiers(column: pa.ChunkedArray, path: Path) -> pa.Array:
    """Ids as text, just as they stand in the file."""
    flat = column.combine_chunks()
    if isinstance(flat, pa.DictionaryArray):
        flat = flat.dictionary_decode()
    kind = flat.type
    if not (pa.types.is_integer(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        raise TraceError(f"{path}: id", str(kind), "text, or whole numbers")
    text = flat.cast(pa.string())
    missing = pc.or_(pc.is_null(text), pc.fill_null(pc.equal(pc.utf8_length(text), 0), True))
    if pc.any(missing).as_py():
        raise TraceError(f"{path}: row {pc.index(missing, True).as_py() + 1}: id", None, "the id of a vehicle")
    return text


def _sorted_ids(column: pa.Array) -> tuple[list[str], Ints]:
    """Distinct ids, sorted, and the row of each sample in them."""
    encoded = column.dictionary_encode()
    ids: list[str] = encoded.dictionary.to_pylist()
    order = sorted(range(len(ids)), key=ids.__getitem__)
    rank = np.empty(len(ids), np.int64)
    rank[order] = np.arange(len(ids))
    return [ids[row] for row in order], rank[encoded.indices.to_numpy()]


def _times(column: pa.ChunkedArray, config: Mobility, path: Path) -> FloatArray:
    """[M] [s]; time stamps count from 1970, and whole numbers are divided exactly, whatever their size."""
    ticks = TICKS[config.time_unit]
    trimmed = pc.utf8_trim_whitespace(column) if _is_text(column) else column
    if _is_text(column):
        try:
            trimmed = trimmed.cast(pa.int64())
        except pa.ArrowException:
            stamps = _stamps(trimmed)
            trimmed = trimmed if stamps is None else stamps
    if pa.types.is_timestamp(trimmed.type):
        trimmed, ticks = trimmed.cast(pa.timestamp("us")).cast(pa.int64()), TICKS["us"]
    if pa.types.is_integer(trimmed.type) and not trimmed.null_count:
        whole = trimmed.cast(pa.int64(), safe=False).to_numpy()
        first = int(whole.min())
        if ticks == 1:
            return np.asarray(whole, dtype=np.float64)
        return np.asarray(first // ticks + ((whole - first) + first % ticks) / ticks, dtype=np.float64)
    return _numbers(trimmed, "time", path) / ticks


def _stamps(column: pa.ChunkedArray) -> pa.ChunkedArray | None:
    """ISO 8601 time stamps; None where they are not."""
    for kind in (pa.timestamp("us", tz="UTC"), pa.timestamp("us")):
        try:
            return column.cast(kind)
        except pa.ArrowException:
            continue
    return None


def _numbers(column: pa.ChunkedArray, name: str, path: Path, missing: float | None = None) -> FloatArray:
    """[M] finite numbers; ``missing`` stands for what is left out, where that is allowed."""
    kind = column.type
    text = pc.utf8_trim_whitespace(column) if _is_text(column) else column
    if missing is not None and _is_text(column):
        text = pc.if_else(pc.equal(pc.utf8_length(text), 0), pa.scalar(None, pa.string()), text)
    numeric = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)
    if not (numeric or _is_text(column)):
        raise TraceError(f"{path}: {name}", str(kind), "a column of numbers")
    try:
        cast = text.cast(pa.float64())
    except pa.ArrowException:
        row, value = next((i, v) for i, v in enumerate(text.to_pylist()) if not _is_number(v))
        raise TraceError(f"{path}: row {row + 1}: {name}", _short(str(value)) or None, "a number") from None
    if missing is not None:
        return np.asarray(pc.fill_null(cast, missing).to_numpy(), dtype=np.float64)
    valid = pc.fill_null(pc.is_finite(cast), False).combine_chunks()
    if not pc.all(valid).as_py():
        row = pc.index(valid, False).as_py()
        raise TraceError(f"{path}: row {row + 1}: {name}", column[row].as_py(), "a finite number")
    values: FloatArray = cast.to_numpy()
    return values


def _is_text(column: pa.ChunkedArray) -> bool:
    return bool(pa.types.is_string(column.type) or pa.types.is_large_string(column.type))


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError):
        return value is None
    return bool(value != "")


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


# Units


def _in_metres(
    trace: Trace, speed: FloatArray | None, geographic: bool, path: Path, config: Mobility
) -> tuple[Trace, list[str]]:
    """Positions in metres, by what the scenario names, what the columns are called, or what the speeds prove."""
    units = config.units
    if units == "auto":
        units = "degrees" if geographic or _proven_degrees(trace, speed) else "m"
    if units == "degrees":
        _check_degrees(trace, path)
        x, y, plane = project(trace.x, trace.y)
        return replace(trace, x=x, y=y, plane=plane), [f"degrees projected to {name_of(plane)}"]
    if config.units == "auto" and _could_be_degrees(trace):
        raise TraceError(
            f"{path}: x, y", f"{_extent(trace)} across", 'metres; for degrees set mobility.units = "degrees"'
        )
    notes = [] if units == "m" else [f"lengths in {units} taken to metres"]
    scale = METRES[units]
    return replace(trace, x=trace.x * scale, y=trace.y * scale), notes


def _extent(trace: Trace) -> str:
    west, south, east, north = trace.box
    return f"{max(east - west, north - south):.3g}"


def _check_degrees(trace: Trace, path: Path) -> None:
    for name, values, low, high in (("longitude", trace.x, -180, 180), ("latitude", trace.y, -80, 84)):
        outside = (values < low) | (values > high)
        if outside.any():
            row = int(np.argmax(outside))
            who = _short(trace.ids[trace.vehicle[row]])
            place = f"{path}: vehicle {who} at {trace.time[row]:.9g} s: {name}"
            raise TraceError(place, float(values[row]), f"degrees from {low} to {high}")


def _could_be_degrees(trace: Trace) -> bool:
    """Whether positions fit on the globe and nobody is faster than `SLOWEST`, though somebody moves."""
    if abs(trace.x).max() > 180 or abs(trace.y).max() > 90:
        return False
    same, gap, distance = trace.pairs
    pace = distance[same] / gap[same]
    west, south, east, north = trace.box
    fastest = float(np.quantile(pace, 0.99)) if pace.size else 0.0
    return 0.0 < fastest < SLOWEST or (not pace.size and max(east - west, north - south) < SMALLEST_EXTENT)


def _proven_degrees(trace: Trace, speed: FloatArray | None) -> bool:
    """Whether the speeds beside the positions are those of a drive over the globe."""
    if speed is None or not _could_be_degrees(trace) or trace.y.min() < -80 or trace.y.max() > 84:
        return False
    x, y, _ = project(trace.x, trace.y)
    told = _told_over_written(Trace(trace.ids, trace.vehicle, trace.time, x, y, ""), speed)
    return told is not None and 1 / DISAGREEMENT < told < DISAGREEMENT


def _told_over_written(trace: Trace, speed: FloatArray) -> float | None:
    """By which factor the positions' speeds differ from those beside them, in the middle; None where nobody moves."""
    same, gap, distance = trace.pairs
    written = 0.5 * (speed[:-1] + speed[1:])
    moving = same & np.isfinite(written) & (written > 1.0)
    if not moving.any():
        return None
    return float(np.median(distance[moving] / gap[moving] / written[moving]))


# Truth


def _checked(trace: Trace, path: Path, config: Mobility) -> Trace:
    """The trace if it can be true, with notes on what will not be bridged."""
    trace = _without_lost_fixes(trace, path, config)
    west, south, east, north = trace.box
    if max(east - west, north - south) < SMALLEST_EXTENT:
        expected = f"positions at least {SMALLEST_EXTENT:g} m apart (set mobility.units where they are not in metres)"
        raise TraceError(f"{path}: x, y", f"{_extent(trace)} m across", expected)
    same, gap, distance = trace.pairs
    if not same.any():
        return trace
    gaps = gap[same]
    middle = float(np.median(gaps))
    if middle > config.max_gap:
        row = int(np.flatnonzero(same)[np.argmax(gaps >= middle)])
        place = f"{path}: vehicle {_short(trace.ids[trace.vehicle[row]])} at {trace.time[row]:.9g} s"
        expected = (
            f"samples at most {config.max_gap:g} s apart; set mobility.time_unit where times are not in seconds, "
            "or a longer mobility.max_gap"
        )
        raise TraceError(place, f"{gap[row]:g} s from the next sample", expected)
    quick = same & (distance > FASTEST * gap)
    if quick.sum() > 0.5 * same.sum():
        row = int(np.argmax(quick))
        place = f"{path}: vehicle {_short(trace.ids[trace.vehicle[row]])} at {trace.time[row]:.9g} s"
        expected = f"at most {FASTEST:g} m/s; set mobility.units or mobility.time_unit where they are others"
        raise TraceError(place, f"{distance[row] / gap[row]:.3g} m/s to the next sample", expected)
    notes = []
    low, high = np.quantile(gaps, [0.05, 0.95]).tolist()
    if middle > 1.5 or high - low > 0.5 * middle:
        notes.append(
            f"samples of a vehicle mostly {low:.3g} to {high:.3g} s apart (median {middle:.3g}, longest "
            f"{gaps.max():.3g}): positions between are linear"
        )
    if wide := int((same & (gap > config.max_gap)).sum()):
        notes.append(f"{counted(wide, 'gap')} over {config.max_gap:g} s not bridged (mobility.max_gap)")
    if quick.any():
        row = int(np.argmax(quick))
        who = f"{_short(trace.ids[trace.vehicle[row]])} at {trace.time[row]:.9g} s"
        notes.append(f"{counted(int(quick.sum()), 'jump')} faster than {FASTEST:g} m/s not bridged (first: {who})")
    return _with_notes(trace, *notes)


def _without_lost_fixes(trace: Trace, path: Path, config: Mobility) -> Trace:
    """The trace without single samples that nobody can have been at, if the scenario says to drop them."""
    lost = _lost_fixes(trace)
    if not lost.any():
        return trace
    row = int(np.argmax(lost))
    if config.lost_fixes == "refuse":
        who = f"{path}: vehicle {_short(trace.ids[trace.vehicle[row]])} at {trace.time[row]:.9g} s"
        where = f"({trace.x[row]:.9g}, {trace.y[row]:.9g})"
        expected = 'a position that it can have reached; mobility.lost_fixes = "drop" leaves such samples out'
        raise TraceError(who, where, expected)
    kept = ~lost
    present, vehicle = np.unique(trace.vehicle[kept], return_inverse=True)
    ids = tuple(trace.ids[number] for number in present)
    note = f"{counted(int(lost.sum()), 'sample')} dropped at places that could not be reached (mobility.lost_fixes)"
    thinned = replace(trace, ids=ids, vehicle=vehicle, time=trace.time[kept], x=trace.x[kept], y=trace.y[kept])
    return _with_notes(thinned, note)


def _lost_fixes(trace: Trace) -> npt.NDArray[np.bool_]:
    """[M] samples that lie faster than `FASTEST` from those before and after, which lie well together; and strays.

    A stray is further from the middle of all than 100 times the distance that nine in ten keep.
    """
    same, gap, distance = trace.pairs
    quick = same & (distance > FASTEST * gap)
    lost = np.zeros(len(trace.x), dtype=bool)
    inner = quick[:-1] & quick[1:]
    across = np.hypot(trace.x[2:] - trace.x[:-2], trace.y[2:] - trace.y[:-2])
    lost[1:-1] = inner & (across <= FASTEST * (trace.time[2:] - trace.time[:-2]))
    away = np.hypot(trace.x - np.median(trace.x), trace.y - np.median(trace.y))
    return lost | (away > 100.0 * max(float(np.quantile(away, 0.9)), 100.0))
