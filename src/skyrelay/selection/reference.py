"""The selection as plain loops, line by line as the paper lists it: what the fast path is tested against."""

from __future__ import annotations

import math

from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings


def qou_of(vehicles: VehicleTable, v: int, uavs: UavTable, u: int, settings: Settings) -> float:
    """Eq. 1 for one pair."""
    w1, w2, w3, w4 = settings.qou_weights
    return 100 * (
        w1 * (float(uavs.bandwidth[u]) / (settings.max_uav_bandwidth * 1000))
        + w2 * (float(uavs.battery[u]) / 100)
        + w3 * (float(uavs.reputation[u]) / 100)
        + w4 * (1 - min(_distance(vehicles, v, uavs, u) / settings.max_distance, 1.0))
    )


def qov_of(vehicles: VehicleTable, v: int, uavs: UavTable, u: int, settings: Settings) -> float:
    """Eq. 2 for one pair."""
    w5, w6, w7, w8 = settings.qov_weights
    return 100 * (
        w5 * (float(vehicles.demand[v]) / (settings.max_demand * 1000))
        + w6 * (float(vehicles.payment[v]) / settings.max_payment)
        + w7 * (float(vehicles.reputation[v]) / 100)
        + w8 * (1 - min(_distance(vehicles, v, uavs, u) / settings.max_distance, 1.0))
    )


def is_candidate(vehicles: VehicleTable, v: int, uavs: UavTable, u: int, settings: Settings) -> bool:
    """Whether UAV u is of v's zone and, with ``candidates = "range"``, within ``max_distance``."""
    if vehicles.zone[v] != uavs.zone[u]:
        return False
    return settings.candidates == "zone" or _distance(vehicles, v, uavs, u) <= settings.max_distance


def propose(
    vehicles: VehicleTable, v: int, uavs: UavTable, settings: Settings, refused_by: frozenset[int] = frozenset()
) -> int:
    """Algorithm 1 for one vehicle, leaving out the UAVs that refused it; -1 where there is no UAV."""
    best_qou, best_uav = 0.0, -1
    for u in range(len(uavs)):
        if u in refused_by or not is_candidate(vehicles, v, uavs, u, settings):
            continue
        score = qou_of(vehicles, v, uavs, u, settings)
        if score > best_qou:
            best_qou, best_uav = score, u
    return best_uav


def allocate(
    vehicles: VehicleTable, uavs: UavTable, proposals: dict[int, list[int]], settings: Settings
) -> dict[int, list[int]]:
    """Algorithm 2: for each UAV the accepted among its proposing vehicles, which stand in order of submission."""
    selected: dict[int, list[int]] = {}
    for u, proposing in proposals.items():
        available = float(uavs.bandwidth[u])
        selected[u] = []
        # `sorted` is stable: of equal scores the earlier submission stays first.
        for v in sorted(
            proposing,
            key=lambda v: qov_of(vehicles, v, uavs, u, settings) / math.sqrt(float(vehicles.demand[v]) / 1000),
            reverse=True,
        ):
            if vehicles.demand[v] <= available:
                selected[u].append(v)
                available -= float(vehicles.demand[v])
    return selected


def two_sided(vehicles: VehicleTable, uavs: UavTable, settings: Settings, rounds: int) -> list[int]:
    """Algorithms 1 and 2, repeated while a vehicle without a UAV has one left to ask; the UAV of each vehicle or -1."""
    assignment = [-1] * len(vehicles)
    refused_by: list[frozenset[int]] = [frozenset()] * len(vehicles)
    held: dict[int, list[int]] = {u: [] for u in range(len(uavs))}  # in order of submission
    for _ in range(rounds):
        asked = {u: list(held[u]) for u in held}
        anyone = False
        for v in range(len(vehicles)):
            if assignment[v] >= 0:
                continue
            u = propose(vehicles, v, uavs, settings, refused_by[v])
            if u >= 0:
                asked[u].append(v)
                anyone = True
        if not anyone:
            break
        selected = allocate(vehicles, uavs, asked, settings)
        for u, proposing in asked.items():
            held[u] = [v for v in proposing if v in selected[u]]
            for v in proposing:
                if v in selected[u]:
                    assignment[v] = u
                else:
                    assignment[v] = -1
                    refused_by[v] |= {u}
    return assignment


def near_feasible(vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> list[int]:
    """Deferred acceptance, one vehicle at a time, with UAVs that hold vehicles until their bandwidth is filled.

    The UAV of each vehicle or -1; each UAV is exceeded by less than the demand of the last vehicle that it holds.
    """
    assignment = [-1] * len(vehicles)
    refused_by: list[frozenset[int]] = [frozenset()] * len(vehicles)
    for u in range(len(uavs)):
        for v in range(len(vehicles)):
            if vehicles.demand[v] > uavs.bandwidth[u]:
                refused_by[v] |= {u}
    held: list[list[int]] = [[] for _ in range(len(uavs))]
    asking = list(range(len(vehicles)))
    while asking:
        v = asking.pop()
        u = propose(vehicles, v, uavs, settings, refused_by[v])
        if u < 0:
            continue
        ranked = sorted(
            [*held[u], v],
            key=lambda w: (-qov_of(vehicles, w, uavs, u, settings) / math.sqrt(float(vehicles.demand[w]) / 1000), w),
        )
        held[u], taken = [], 0.0
        for w in ranked:
            if taken < uavs.bandwidth[u]:
                held[u].append(w)
                taken += float(vehicles.demand[w])
                assignment[w] = u
            else:
                assignment[w] = -1
                refused_by[w] |= {u}
                asking.append(w)
    return assignment


def _distance(vehicles: VehicleTable, v: int, uavs: UavTable, u: int) -> float:
    dx = float(vehicles.x[v]) - float(uavs.x[u])
    dy = float(vehicles.y[v]) - float(uavs.y[u])
    return math.sqrt(dx * dx + dy * dy)
