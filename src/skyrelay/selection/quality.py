"""What a vehicle thinks of a UAV (QoU, Eq. 1) and a UAV of a vehicle (QoV, Eq. 2), in floating point."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings

BoolArray = npt.NDArray[np.bool_]

KBPS_PER_MBPS = 1000.0


def standing(uavs: UavTable, settings: Settings) -> FloatArray:
    """The part of Eq. 1 that no distance enters: bandwidth, battery and reputation, weighted.

    Returns: [U] between 0 and w1 + w2 + w3 (above it only for a UAV with more bandwidth than ``max_uav_bandwidth``).
    """
    w1, w2, w3, _ = settings.qou_weights
    result: FloatArray = (
        w1 * (uavs.bandwidth / (settings.max_uav_bandwidth * KBPS_PER_MBPS))
        + w2 * (uavs.battery / 100.0)
        + w3 * (uavs.reputation / 100.0)
    )
    return result


def offer(vehicles: VehicleTable, settings: Settings) -> FloatArray:
    """The part of Eq. 2 that no distance enters: demand, payment and reputation, weighted.

    Returns: [V] between 0 and w5 + w6 + w7 (above it only for a demand or payment above its maximum).
    """
    w5, w6, w7, _ = settings.qov_weights
    result: FloatArray = (
        w5 * (vehicles.demand / (settings.max_demand * KBPS_PER_MBPS))
        + w6 * (vehicles.payment / settings.max_payment)
        + w7 * (vehicles.reputation / 100.0)
    )
    return result


def distance(dx: FloatArray, dy: FloatArray) -> FloatArray:
    """Euclidean distance [m] of coordinate differences [m].

    A square root of squares, not ``hypot``: each of its steps is correctly rounded and monotone, so that the bounds
    by which `proposal` leaves UAVs out hold to the last bit.
    """
    result: FloatArray = np.sqrt(dx * dx + dy * dy)
    return result


def closeness(separation: FloatArray, settings: Settings) -> FloatArray:
    """1 - distance/max_distance, the distance term of Eq. 1 and 2, clipped to [0, 1]; ``separation`` [m]."""
    result: FloatArray = 1.0 - np.minimum(separation / settings.max_distance, 1.0)
    return result


def pair_qou(
    vehicles: VehicleTable, uavs: UavTable, rows: IntArray, columns: IntArray, settings: Settings
) -> FloatArray:
    """QoU of chosen pairs (Eq. 1), whether or not they are candidates of each other.

    Args:
        rows, columns: [P] indices of vehicles and of UAVs.
    Returns: [P] in [0, 100].
    Source: Eq. 1; the distance term is clipped (docs/assumptions.md).
    """
    near = closeness(_pair_distance(vehicles, uavs, rows, columns), settings)
    result: FloatArray = 100.0 * (standing(uavs, settings)[columns] + settings.qou_weights[3] * near)
    return result


def pair_qov(
    vehicles: VehicleTable, uavs: UavTable, rows: IntArray, columns: IntArray, settings: Settings
) -> FloatArray:
    """QoV of chosen pairs (Eq. 2).

    Args:
        rows, columns: [P] indices of vehicles and of UAVs.
    Returns: [P] in [0, 100].
    Source: Eq. 2; the distance term is clipped (docs/assumptions.md).
    """
    near = closeness(_pair_distance(vehicles, uavs, rows, columns), settings)
    result: FloatArray = 100.0 * (offer(vehicles, settings)[rows] + settings.qov_weights[3] * near)
    return result


def qou(vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> FloatArray:
    """Score every UAV for every vehicle (Eq. 1).

    Returns: [V, U] in [0, 100]; -inf where the UAV is no candidate of the vehicle.
    Source: Eq. 1; candidates as in docs/assumptions.md.
    """
    separation = _all_distances(vehicles, uavs)
    score: FloatArray = 100.0 * (standing(uavs, settings) + settings.qou_weights[3] * closeness(separation, settings))
    return np.where(_is_candidate(vehicles, uavs, separation, settings), score, -np.inf)


def qov(vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> FloatArray:
    """Score every vehicle for every UAV (Eq. 2).

    Returns: [V, U] in [0, 100]; -inf where they are no candidates of each other.
    Source: Eq. 2; candidates as in docs/assumptions.md.
    """
    separation = _all_distances(vehicles, uavs)
    worth = offer(vehicles, settings)[:, None]
    score: FloatArray = 100.0 * (worth + settings.qov_weights[3] * closeness(separation, settings))
    return np.where(_is_candidate(vehicles, uavs, separation, settings), score, -np.inf)


def are_candidates(
    vehicles: VehicleTable, uavs: UavTable, rows: IntArray, columns: IntArray, settings: Settings
) -> BoolArray:
    """Whether the UAVs of chosen pairs are of the vehicles' zones and, with ``candidates = "range"``, in range.

    Args:
        rows, columns: [P] indices of vehicles and of UAVs.
    Returns: [P].
    """
    same_zone: BoolArray = vehicles.zone[rows] == uavs.zone[columns]
    if settings.candidates == "zone":
        return same_zone
    return same_zone & (_pair_distance(vehicles, uavs, rows, columns) <= settings.max_distance)


def density(qov_of_pairs: FloatArray, demand: FloatArray) -> FloatArray:
    """What Algorithm 2 sorts by: QoV/sqrt(RB), ``demand`` [kbit/s] taken in Mbit/s; the greatest is served first."""
    result: FloatArray = qov_of_pairs / np.sqrt(demand / KBPS_PER_MBPS)
    return result


def _all_distances(vehicles: VehicleTable, uavs: UavTable) -> FloatArray:
    return distance(vehicles.x[:, None] - uavs.x, vehicles.y[:, None] - uavs.y)


def _pair_distance(vehicles: VehicleTable, uavs: UavTable, rows: IntArray, columns: IntArray) -> FloatArray:
    return distance(vehicles.x[rows] - uavs.x[columns], vehicles.y[rows] - uavs.y[columns])


def _is_candidate(vehicles: VehicleTable, uavs: UavTable, separation: FloatArray, settings: Settings) -> BoolArray:
    same_zone: BoolArray = vehicles.zone[:, None] == uavs.zone
    return same_zone if settings.candidates == "zone" else same_zone & (separation <= settings.max_distance)
