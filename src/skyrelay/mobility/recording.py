"""Traces recorded from SUMO simulations, by libsumo; needs ``pip install skyrelay[sumo]``.

A recording has the columns of a floating-car trace: time [s], id, x, y [m], speed [m/s], angle [degrees clockwise from
north]. libsumo holds one simulation per process.
"""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from skyrelay.core.errors import TraceError, UsageError
from skyrelay.core.extras import missing
from skyrelay.core.files import atomic_path
from skyrelay.core.progress import Progress, Silent

SCHEMA = pa.schema(
    [
        ("time", pa.float64()),
        ("id", pa.string()),
        ("x", pa.float64()),
        ("y", pa.float64()),
        ("speed", pa.float64()),
        ("angle", pa.float64()),
    ]
)
ROWS = 200_000
"""Samples that are held before they are written."""


@dataclass(frozen=True)
class Recording:
    """What was recorded.

    Attributes:
        path: of the Parquet file.
        samples: rows.
        vehicles: different ones.
        begin, end: times of the first and the last sample [s].
    """

    path: Path
    samples: int
    vehicles: int
    begin: float
    end: float


def record(
    config: Path,
    out: Path,
    *,
    seconds: float | None = None,
    step_length: float | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Simulate, and write where each vehicle is after each step.

    Args:
        config: the simulation's ``.sumocfg``.
        out: the Parquet file to write.
        seconds: to simulate at most; None for the configuration's own end, or until the last vehicle has arrived.
        step_length: [s]; None for the configuration's own.
        seed: of the simulation; None for the configuration's own.
        progress: told of each simulated second.
    Raises:
        UsageError: libsumo is not installed, the file is not to be written as Parquet, or a number is out of range.
        TraceError: SUMO refuses the configuration or stops on an error, or no vehicle ever drove.
    """
    if out.suffix.lower() != ".parquet":
        raise UsageError("--out", str(out), "a file that ends in .parquet")
    for name, value in (("--seconds", seconds), ("--step-length", step_length)):
        if value is not None and not value > 0:
            raise UsageError(name, value, "a number of seconds above 0")
    libsumo = _libsumo()
    options = ["--no-step-log", "true", "--duration-log.disable", "true", "--no-warnings", "true"]
    if step_length is not None:
        options += ["--step-length", f"{step_length:g}"]
    if seed is not None:
        options += ["--seed", str(seed)]
    shown = progress or Silent()
    with _simulation(libsumo, config, options) as version, atomic_path(out) as beside:
        source = {"source": f"{version}, {config.name}", "units": "s, m, m, m/s, degrees clockwise from north"}
        with pq.ParquetWriter(beside, SCHEMA.with_metadata(source)) as writer:
            samples, ids, begin, end = _write(libsumo, writer, seconds, shown)
        if not samples:
            raise TraceError(config, "no vehicle on the road", f"at least one within {end - begin:g} s")
    return Recording(out, samples, len(ids), begin, end)


def _write(
    libsumo: Any, writer: pq.ParquetWriter, seconds: float | None, progress: Progress
) -> tuple[int, set[str], float, float]:
    """Step until the end; returns samples written, the vehicles' ids, and the first and last time [s]."""
    start, last = libsumo.simulation.getTime(), libsumo.simulation.getEndTime()
    stop = min(start + seconds if seconds is not None else float("inf"), last if last > 0 else float("inf"))
    progress.stage("simulating", int(stop - start) if stop < float("inf") else 0)
    rows: list[tuple[float, str, float, float, float, float]] = []
    ids: set[str] = set()
    samples, begin, end, now = 0, start, start, start
    vehicles = libsumo.vehicle
    while now < stop and libsumo.simulation.getMinExpectedNumber() > 0:
        libsumo.simulationStep()
        before, now = now, libsumo.simulation.getTime()
        for name in vehicles.getIDList():
            x, y = vehicles.getPosition(name)
            rows.append((now, name, x, y, vehicles.getSpeed(name), vehicles.getAngle(name)))
            ids.add(name)
        if not samples and rows:
            begin = rows[0][0]
        if rows:
            end = rows[-1][0]
        if len(rows) >= ROWS:
            samples += _flush(writer, rows)
        progress.advance(int(now) - int(before))
    return samples + _flush(writer, rows), ids, begin, end


def _flush(writer: pq.ParquetWriter, rows: list[tuple[float, str, float, float, float, float]]) -> int:
    """Write the rows and forget them; returns how many they were."""
    count = len(rows)
    if count:
        columns = [pa.array(column, field.type) for column, field in zip(zip(*rows, strict=True), SCHEMA, strict=True)]
        writer.write_table(pa.table(columns, schema=writer.schema))
        rows.clear()
    return count


@contextmanager
def _simulation(libsumo: Any, config: Path, options: list[str]) -> Iterator[str]:
    """A running simulation; yields SUMO's version. What SUMO complains of becomes the error."""
    if libsumo.isLoaded():
        raise UsageError("libsumo", "a simulation that runs in this process", "one at a time")
    with _stderr_kept() as complaints:
        try:
            _, version = libsumo.start(["sumo", "-c", str(config), *options])
        except libsumo.TraCIException as error:
            raise TraceError(config, None, f"a SUMO configuration that loads ({_told(complaints, error)})") from error
        try:
            yield version
        except libsumo.TraCIException as error:
            raise TraceError(config, None, f"a simulation that runs ({_told(complaints, error)})") from error
        finally:
            libsumo.close()


@contextmanager
def _stderr_kept() -> Iterator[Any]:
    """SUMO prints its faults to standard error, past Python: they are kept in a file meanwhile."""
    kept = os.dup(2)
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as complaints:
        try:
            os.dup2(complaints.fileno(), 2)
            yield complaints
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _told(complaints: Any, error: Exception) -> str:
    """The first complaint, in one line; the exception itself often says less."""
    complaints.seek(0)
    text = " ".join(complaints.read().split())
    first = text.split("Error: ")[1] if "Error: " in text else str(error)
    return first.strip()[:160]


def _libsumo() -> Any:
    try:
        with redirect_stdout(io.StringIO()):  # it prints a warning about pyarrow's version, harmless here
            import libsumo  # type: ignore[import-not-found]
    except ImportError as error:  # also of a library of the system, which the error alone does not name
        raise (missing("libsumo", error) or error) from error
    return libsumo
