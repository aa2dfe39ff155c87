"""Comparators without preferences of the UAVs: one vehicle after the other takes a candidate that has room."""

from __future__ import annotations

import numpy as np

from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.candidates import Pairs, candidate_pairs
from skyrelay.selection.quality import distance


def nearest(vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> IntArray:
    """In list order each vehicle takes the nearest candidate that still has its bandwidth; [V] UAV or -1."""
    pairs = candidate_pairs(vehicles, uavs, settings)
    separation = distance(vehicles.x[pairs.vehicle] - uavs.x[pairs.uav], vehicles.y[pairs.vehicle] - uavs.y[pairs.uav])
    return take_in_turn(vehicles, uavs, pairs, separation, np.arange(len(vehicles)))


def random(vehicles: VehicleTable, uavs: UavTable, settings: Settings, seed: int) -> IntArray:
    """In random order each vehicle takes any candidate that still has its bandwidth, all equally likely."""
    pairs = candidate_pairs(vehicles, uavs, settings)
    generator = np.random.default_rng(seed)
    return take_in_turn(vehicles, uavs, pairs, generator.random(len(pairs)), generator.permutation(len(vehicles)))


def take_in_turn(vehicles: VehicleTable, uavs: UavTable, pairs: Pairs, cost: FloatArray, turns: IntArray) -> IntArray:
    """Each vehicle, when its turn comes, takes the candidate of lowest cost that still has its bandwidth.

    Args:
        cost: [P] of each pair; the first of equals is taken.
        turns: [V] vehicles in the order of their turns.
    Returns: [V] UAV or -1.
    """
    assignment = np.full(len(vehicles), -1, dtype=np.int64)
    free = uavs.bandwidth.copy()
    for vehicle in turns:
        mine = slice(pairs.start[vehicle], pairs.start[vehicle + 1])
        candidates = pairs.uav[mine]
        fits = free[candidates] >= vehicles.demand[vehicle]
        if fits.any():
            chosen = candidates[np.argmin(np.where(fits, cost[mine], np.inf))]
            assignment[vehicle] = chosen
            free[chosen] -= vehicles.demand[vehicle]
    return assignment
