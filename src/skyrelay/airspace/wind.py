"""Wind: what a UAV that counters it still makes over ground, and what hovering in it amounts to.

A UAV holds its course and its place by its airspeed (the wind triangle): across the wind it leans into it, against it
it makes less way. It never flies faster over ground than in still air, so that whatever was reckoned for a move of full
length (the least separation, the links, the zone's border) holds for the shorter one on the same line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skyrelay.airspace.flight import unit_moves
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.core.scenario import Wind

_WAVES = 8
_SLOWEST, _FASTEST = 10.0, 120.0
"""Periods that gusts are made of [s]."""


@dataclass(frozen=True)
class Weather:
    """The wind over an area, the same everywhere, by the time; it has no state.

    Attributes:
        wind: a scenario's.
        rates: [W] of the gusts' waves [rad/s].
        phases: [W] [rad].
    """

    wind: Wind
    rates: FloatArray
    phases: FloatArray

    @classmethod
    def of(cls, wind: Wind, seed: int) -> Weather | None:
        """A scenario's; None where there is no wind."""
        if wind.speed == 0.0 and wind.gusts == 0.0:
            return None
        draw = np.random.default_rng((seed, 0x77696E64))  # a stream of its own: nothing else is drawn by it
        periods = np.exp(draw.uniform(np.log(_SLOWEST), np.log(_FASTEST), _WAVES))
        return cls(wind, 2.0 * np.pi / periods, draw.uniform(0.0, 2.0 * np.pi, _WAVES))

    def at(self, seconds: float) -> FloatArray:
        """[2] where the air moves to, east and north [m/s]: ``speed`` give or take at most ``gusts``."""
        swing = float(np.cos(self.rates * seconds + self.phases).mean())
        strength = max(self.wind.speed + self.wind.gusts * swing, 0.0)
        towards = np.radians(self.wind.direction + 180.0)  # the direction is where it blows from, clockwise from north
        return strength * np.array([np.sin(towards), np.cos(towards)])


def progress(actions: IntArray, wind: FloatArray, speed: float) -> FloatArray:
    """What share of a move in still air UAVs make in a wind that they counter.

    Args:
        actions: [N] 0..8.
        wind: [2] where the air moves to [m/s], slower than ``speed``.
        speed: the UAVs' airspeed [m/s].
    Returns: [N] in (0, 1]; 1 for one that stays.
    """
    heading = unit_moves()[actions].astype(np.float64)
    along = heading @ wind
    across = float(wind @ wind) - along * along
    made = (np.sqrt(np.maximum(speed * speed - across, 0.0)) + along) / speed
    return np.where(heading.any(axis=1), np.clip(made, 0.0, 1.0), 1.0)
