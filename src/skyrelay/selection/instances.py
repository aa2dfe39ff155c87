"""Vehicles and UAVs drawn as in Table "Simulation Setup", or by another scenario's distributions."""

from __future__ import annotations

import numpy as np

from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.errors import UsageError
from skyrelay.core.scenario import Scenario
from skyrelay.core.zones import ZoneGrid

_KBPS_PER_MBPS = 1000.0


def draw_instance(vehicles: int, uavs: int, seed: int, scenario: Scenario) -> tuple[VehicleTable, UavTable]:
    """Draw vehicles and UAVs, every attribute uniform and independent.

    Args:
        vehicles, uavs: how many.
        seed: equal arguments give equal tables; UAVs do not depend on the number of vehicles, nor the other way round.
        scenario: its area (a square of ``mobility.area``), zones, and bounds of ``fleet`` and ``demand``;
            ``load_scenario("paper")`` is the paper's set-up.
    Raises:
        UsageError: a negative number, or a seed below 0.
    Source: Table "Simulation Setup".
    """
    for name, value in (("vehicles", vehicles), ("uavs", uavs), ("seed", seed)):
        if value < 0:
            raise UsageError(name, value, "a number of at least 0")
    side = scenario.mobility.area
    grid = ZoneGrid.over(0.0, 0.0, side, side, scenario.zones.columns, scenario.zones.rows)
    of_vehicles, of_uavs = (np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(2))
    x, y = of_vehicles.uniform(0.0, side, (2, vehicles))
    demand = scenario.demand
    table = VehicleTable(
        ids=tuple(f"v{number}" for number in range(vehicles)),
        x=x,
        y=y,
        zone=grid.zone_of(x, y),
        demand=of_vehicles.uniform(*demand.bandwidth, vehicles) * _KBPS_PER_MBPS,
        payment=of_vehicles.uniform(*demand.payment, vehicles),
        reputation=of_vehicles.uniform(*demand.reputation, vehicles),
    )
    x, y = of_uavs.uniform(0.0, side, (2, uavs))
    fleet = scenario.fleet
    return table, UavTable(
        ids=tuple(f"u{number}" for number in range(uavs)),
        x=x,
        y=y,
        zone=grid.zone_of(x, y),
        bandwidth=of_uavs.uniform(*fleet.bandwidth, uavs) * _KBPS_PER_MBPS,
        battery=of_uavs.uniform(*fleet.battery, uavs),
        reputation=of_uavs.uniform(*fleet.reputation, uavs),
    )
