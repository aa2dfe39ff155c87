"""Synthetic vehicles for a whole run in NumPy; the compiled game has its own, relative to one zone."""

from __future__ import annotations

import numpy as np

from skyrelay.core.entities import FloatArray
from skyrelay.core.scenario import Mobility


def manhattan(
    config: Mobility, steps: int, seconds: float, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Vehicles that drive along the axes, turn at random, and turn back at the border.

    Returns: x and y, each [steps+1, vehicles] [m].
    """
    count = config.vehicles
    position = random.uniform(0.0, config.area, (count, 2))
    speed = random.uniform(*config.speed, count)
    heading = random.integers(0, 4, count)
    unit = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    track = np.empty((steps + 1, count, 2))
    track[0] = position
    for step in range(1, steps + 1):
        turns = random.random(count) < config.turn_probability
        heading = np.where(turns, heading + random.choice([1, 3], count), heading) % 4
        position = position + unit[heading] * (speed * seconds)[:, None]
        outside = ((position < 0.0) | (position > config.area)).any(axis=1)
        heading = np.where(outside, heading + 2, heading) % 4
        position = config.area - np.abs(config.area - np.abs(position))  # mirrored at the border
        position = position.clip(0.0, config.area)
        track[step] = position
    return track[..., 0], track[..., 1]


def random_waypoint(
    config: Mobility, steps: int, seconds: float, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Vehicles that drive straight to a uniform target, then choose another and another speed.

    Returns: x and y, each [steps+1, vehicles] [m].
    """
    count = config.vehicles
    position = random.uniform(0.0, config.area, (count, 2))
    target = random.uniform(0.0, config.area, (count, 2))
    speed = random.uniform(*config.speed, count)
    track = np.empty((steps + 1, count, 2))
    track[0] = position
    for step in range(1, steps + 1):
        way = target - position
        distance = np.linalg.norm(way, axis=1)
        reach = speed * seconds
        arrived = distance <= reach
        moved = position + way * (reach / np.maximum(distance, 1e-12))[:, None]
        position = np.where(arrived[:, None], target, moved)
        target = np.where(arrived[:, None], random.uniform(0.0, config.area, (count, 2)), target)
        speed = np.where(arrived, random.uniform(*config.speed, count), speed)
        track[step] = position
    return track[..., 0], track[..., 1]
