"""Games over the vehicles of a floating-car trace: squares of the city at moments of the trace, for evaluation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key, PRNGKeyArray

from skyrelay.coordination import game
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.core.errors import UsageError
from skyrelay.mobility.trace import Trace
from skyrelay.mobility.tracks import Tracks, replay

ZONES_ACROSS = 3
"""A zone's side where none is given: a third of the trace's longer side, as the default scenario cuts it."""
_ATTEMPTS = 1000


@dataclass(frozen=True)
class Setting:
    """How a trace is cut into games.

    Attributes:
        uavs, vehicles: smallest and largest numbers, inclusive; a square with less traffic has fewer vehicles.
        zone_side: [m]; None for a third of the trace's longer side.
        ratio: zone side over range.
        step_seconds: [s].
        uav_speed: [m/s].
    """

    uavs: tuple[int, int]
    vehicles: tuple[int, int]
    zone_side: float | None = None
    ratio: float = 2.0
    step_seconds: float = 2.0
    uav_speed: float = 30.0


def replayed_games(
    key: PRNGKeyArray, trace: Trace, count: int, shape: Shape, setting: Setting
) -> tuple[game.State, game.Trace]:
    """Games of real vehicles.

    Each has its own moment, and a square around one of the vehicles that are there then. Of the vehicles in the square
    some are drawn; one that leaves the square or the trace is absent. UAVs start anywhere in the square, and
    each vehicle has a UAV in range, or else the nearest (`skyrelay.coordination.game.reset`).

    Args:
        key: of the games, and of what is drawn from the trace.
        count: how many games.
        shape: its mobility is taken as "replay".
    Returns: states and traces, a leading axis of games each: arguments of a vmapped `game.step`.
    Raises:
        UsageError: the trace is shorter than an episode, or the square is larger than the trace's area.
    """
    shape = replace(shape, mobility="replay")
    x0, y0, x1, y1 = trace.box
    longest = max(x1 - x0, y1 - y0)
    side = setting.zone_side if setting.zone_side is not None else longest / ZONES_ACROSS
    if not 0 < side <= longest:
        raise UsageError("zone side", side, f"a length over 0 and up to the trace's longer side, {longest:g} m")
    duration = shape.steps * setting.step_seconds
    begin, end = float(trace.time.min()), float(trace.time.max())
    if end - begin < duration:
        raise UsageError(
            "trace", f"{end - begin:g} s long", f"{duration:g} s ({shape.steps} steps of {setting.step_seconds:g} s)"
        )

    random = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
    first, last = _spans(trace)
    moments = setting.step_seconds * np.arange(shape.steps + 1, dtype=np.float64)
    positions = np.zeros((count, shape.steps + 1, shape.vehicles, 2), np.float32)
    present = np.zeros(positions.shape[:3], bool)
    for number in range(count):
        tracks = _busy_moment(random, trace, first, last, end - duration, moments)
        centre = random.choice(np.flatnonzero(np.isfinite(tracks.x[0])))
        corner = np.array(
            [
                _within(tracks.x[0, centre] - side / 2, x0, x1 - side),
                _within(tracks.y[0, centre] - side / 2, y0, y1 - side),
            ]
        )
        place = (np.stack([tracks.x, tracks.y], -1) - corner) / side
        inside = np.all((place >= 0) & (place <= 1), -1)  # false where a vehicle is absent: comparisons with NaN
        candidates = np.flatnonzero(inside[0])
        wanted = random.integers(setting.vehicles[0], setting.vehicles[1] + 1)
        chosen = random.permutation(candidates)[:wanted]
        positions[number, :, : len(chosen)] = np.where(inside[:, chosen, None], place[:, chosen], 0.0)
        present[number, :, : len(chosen)] = inside[:, chosen]

    traces = game.Trace(jnp.asarray(positions), jnp.asarray(present))
    domain = physical(
        setting.uavs,
        setting.vehicles,
        zone_side=side,
        reach=side / setting.ratio,
        step_seconds=setting.step_seconds,
        uav_speed=setting.uav_speed,
    )

    @partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
    def start_all(keys: Key[Array, " games"], traces: game.Trace) -> game.State:
        def one(key: PRNGKeyArray, trace: game.Trace) -> game.State:
            k_draw, k_reset = jax.random.split(key)
            return game.reset(k_reset, shape, domain.draw(k_draw), trace)

        return jax.vmap(one)(keys, traces)

    return start_all(jax.random.split(key, count), traces), traces


def _spans(trace: Trace) -> tuple[FloatArray, FloatArray]:
    """[V] time of the first and of the last sample of each vehicle."""
    starts: IntArray = np.flatnonzero(np.diff(trace.vehicle, prepend=-1))
    first = np.full(len(trace.ids), np.inf)
    last = np.full(len(trace.ids), -np.inf)
    first[trace.vehicle[starts]] = trace.time[starts]
    ends = np.append(starts[1:], len(trace.vehicle)) - 1
    last[trace.vehicle[ends]] = trace.time[ends]
    return first, last


def _busy_moment(
    random: np.random.Generator, trace: Trace, first: FloatArray, last: FloatArray, end: float, times: FloatArray
) -> Tracks:
    """Tracks from a random moment up to ``end`` on, of the vehicles that are there at that moment, at least one."""
    for _ in range(_ATTEMPTS):
        start = random.uniform(trace.time.min(), end)
        tracks = replay(trace, start + times, (first <= start) & (start <= last))
        if np.isfinite(tracks.x[0]).any():
            return tracks
    raise UsageError("trace", "hardly any traffic", "vehicles at the times that an episode can begin at")


def _within(value: float, low: float, high: float) -> float:
    """``value``, no less than ``low`` and no more than ``high``; centred where there is no room."""
    return (low + high) / 2 if high < low else min(max(value, low), high)
