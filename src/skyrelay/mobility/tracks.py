"""Where the connected vehicles of a run are at each of its steps, whatever the source."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from skyrelay.core import plugins
from skyrelay.core.entities import FloatArray
from skyrelay.core.errors import SkyRelayError, TraceError
from skyrelay.core.scenario import Mobility, Scenario
from skyrelay.mobility.synthetic import manhattan, random_waypoint
from skyrelay.mobility.trace import DEFAULTS, FASTEST, Trace, read_trace

SYNTHETIC = {"manhattan": manhattan, "random-waypoint": random_waypoint}
GROUP = "skyrelay.mobility"
"""Of entry points."""
MOST = 1_000_000
"""Vehicles of an own model."""
Model = Callable[[FloatArray, Mobility, np.random.Generator], tuple[Sequence[str], FloatArray, FloatArray]]
"""An own model: from the times of the steps [S+1] [s], the settings and a generator (of the scenario's seed) to the
vehicles' ids [V] and their x and y [S+1, V] [m] from 0 to `mobility.area`, NaN where a vehicle is not there."""
MICROSECONDS = 1_000_000
"""Times are compared in whole microseconds, so that a tenth of a second is what it is."""


@dataclass(frozen=True)
class Tracks:
    """Positions on the run's clock.

    Attributes:
        ids: [V] vehicle ids.
        x, y: [S+1, V] position [m] at each step; NaN where the vehicle is not there.
        box: the area's smallest x and y, largest x and y [m].
        attribution: of the data behind it, or an empty text.
        notes: what was made of that data (`Trace.notes`).
        plane: the EPSG code that x and y are of, where that is known.
    """

    ids: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    box: tuple[float, float, float, float]
    attribution: str = ""
    notes: tuple[str, ...] = ()
    plane: int | None = None


def builtin_traces() -> list[str]:
    """Names of the traces inside the package."""
    return sorted(
        Path(item.name).stem for item in (files("skyrelay.data") / "traces").iterdir() if item.name.endswith(".parquet")
    )


def load_tracks(scenario: Scenario) -> Tracks:
    """The vehicles of a scenario, by its seed.

    Raises:
        TraceError: the trace cannot be read, or is shorter than the run.
    """
    mobility, flight = scenario.mobility, scenario.coordination
    random = np.random.default_rng([scenario.seed, 1])
    if mobility.source == "trace":
        trace, place = open_trace(mobility.trace, mobility)
        times = trace.time.min() + mobility.start + flight.step_seconds * np.arange(flight.steps + 1)
        if times[-1] > trace.time.max() + 0.5 / MICROSECONDS:
            raise TraceError(
                place,
                f"{trace.time.max() - trace.time.min():g} s long",
                f"{times[-1] - trace.time.min():g} s (mobility.start + coordination.steps x step_seconds)",
            )
        connected = random.random(len(trace.ids)) < mobility.penetration
        tracks = replay(trace, times, connected, mobility.max_gap)
        if not tracks.ids:
            expected = (
                f"a share that connects at least one vehicle that is there between {times[0] - trace.time.min():g} and "
                f"{times[-1] - trace.time.min():g} s of {place} (or another mobility.start)"
            )
            raise TraceError("mobility.penetration", mobility.penetration, expected)
        return tracks
    if mobility.source not in SYNTHETIC:
        return _own(scenario)
    x, y = SYNTHETIC[mobility.source](mobility, flight.steps, flight.step_seconds, random)
    width = len(str(mobility.vehicles))
    ids = tuple(f"v{number:0{width}d}" for number in range(1, mobility.vehicles + 1))
    return Tracks(ids, x, y, (0.0, 0.0, mobility.area, mobility.area))


def _own(scenario: Scenario) -> Tracks:
    """The vehicles of an own model.

    Raises:
        UsageError: there is no model of that name, or it cannot be loaded.
        TraceError: it raises, or answers with something else than `Model` says.
    """
    mobility, flight = scenario.mobility, scenario.coordination
    model = plugins.load(GROUP, mobility.source, {}, "mobility.source", ["trace", *SYNTHETIC])
    place = f"mobility {mobility.source}"
    if not callable(model):
        raise TraceError(place, type(model).__name__, "a function of times, the settings and a generator")
    times = flight.step_seconds * np.arange(flight.steps + 1)
    try:
        ids, x, y = model(times, mobility, np.random.default_rng([scenario.seed, 1]))
        names = tuple(str(name) for name in ids)
        x, y = (np.array(axis, dtype=np.float64) for axis in (x, y))
    except SkyRelayError:
        raise
    except Exception as error:  # own code may raise anything
        raise TraceError(place, None, f"ids, x and y ({plugins.fault(error)})") from error
    if len(set(names)) != len(names) or not 1 <= len(names) <= MOST:
        raise TraceError(
            f"{place}: ids", f"{len(names)}, {len(set(names))} of them distinct", f"1 to {MOST:,}, distinct"
        )
    for name, axis in (("x", x), ("y", y)):
        if axis.shape != (len(times), len(names)):
            raise TraceError(f"{place}: {name}", f"of shape {axis.shape}", f"[{len(times)}, {len(names)}]")
    there = np.isfinite(x)
    inside = (x >= 0.0) & (x <= mobility.area) & (y >= 0.0) & (y <= mobility.area)
    if (there != np.isfinite(y)).any() or np.isinf(x).any() or np.isinf(y).any() or not inside[there].all():
        raise TraceError(
            place, None, f"positions from 0 to mobility.area, {mobility.area:g} m; NaN for both where absent"
        )
    if not there.any():
        raise TraceError(place, None, "at least one vehicle that is there")
    return Tracks(names, x, y, (0.0, 0.0, mobility.area, mobility.area))


def replay(trace: Trace, times: FloatArray, connected: np.ndarray, max_gap: float = DEFAULTS.max_gap) -> Tracks:
    """A trace at given times [s], linear between its samples, of the vehicles marked in ``connected`` [V].

    A vehicle is there from its first to its last sample, but between samples further apart than ``max_gap`` [s] or
    than anything drives; those never there at ``times`` are left out.
    """
    rows = np.flatnonzero(connected)
    # One number orders all samples by vehicle, then time: then a single search serves every vehicle and step.
    begin = min(trace.time.min(), times[0])
    clock, wanted_clock = (
        np.rint((moments - begin) * MICROSECONDS).astype(np.int64) for moments in (trace.time, times)
    )
    span = int(max(clock.max(), wanted_clock.max())) + 1
    keys = trace.vehicle * span + clock
    wanted = rows[None, :] * span + wanted_clock[:, None]
    after = np.searchsorted(keys, wanted, side="left").clip(0, len(keys) - 1)
    exact = keys[after] == wanted
    before = np.where(exact, after, (after - 1).clip(0))
    gap = trace.time[after] - trace.time[before]
    same = (trace.vehicle[before] == rows) & (trace.vehicle[after] == rows)
    way = np.hypot(trace.x[after] - trace.x[before], trace.y[after] - trace.y[before])
    bridged = (gap <= max_gap) & (way <= FASTEST * gap)
    there = same & (keys[before] <= wanted) & (wanted <= keys[after]) & bridged
    share = np.where(gap > 0, (times[:, None] - trace.time[before]) / np.where(gap > 0, gap, 1.0), 0.0)
    x = np.where(there, trace.x[before] + share * (trace.x[after] - trace.x[before]), np.nan)
    y = np.where(there, trace.y[before] + share * (trace.y[after] - trace.y[before]), np.nan)
    seen = there.any(axis=0)
    ids = tuple(trace.ids[row] for row in rows[seen])
    return Tracks(ids, x[:, seen], y[:, seen], trace.box, trace.attribution, trace.notes, trace.plane)


def require_trace(name: str) -> None:
    """Make sure that a trace is there, without reading it.

    Raises:
        TraceError: it is neither a built-in one's name nor a file's path.
    """
    try:
        there = name in builtin_traces() or Path(name).exists()
    except OSError:  # a name that no file can have: too long, say
        there = False
    if not there:
        raise TraceError("mobility.trace", name, f"a file that exists, or one of: {', '.join(builtin_traces())}")


def open_trace(name: str, mobility: Mobility = DEFAULTS) -> tuple[Trace, str]:
    """A trace by the name of a built-in one or a file's path, read as `[mobility]` says, and what to call it.

    Raises:
        TraceError: there is no such file, or it is no trace.
    """
    if name in builtin_traces():
        with as_file(files("skyrelay.data") / "traces" / f"{name}.parquet") as path:
            return read_trace(path, mobility), f"built-in trace {name}"
    require_trace(name)
    return read_trace(Path(name), mobility), name
