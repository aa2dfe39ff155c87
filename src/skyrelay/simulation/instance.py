"""The vehicles and UAVs that one selection is made of: those that a run begins with, or those of a run's period."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skyrelay.core.entities import FloatArray, UavTable, VehicleTable
from skyrelay.core.errors import UsageError
from skyrelay.core.scenario import Scenario, Selection
from skyrelay.runfolder.reader import read_scenario, read_table
from skyrelay.simulation.team import uavs_of, vehicles_at
from skyrelay.simulation.world import World


def first_instance(scenario: Scenario) -> tuple[VehicleTable, UavTable, Selection]:
    """Vehicles and UAVs as a run of this scenario would have them at its first selection, and its settings.

    Raises:
        TraceError, ScenarioError: as `skyrelay.simulation.world.World.of`.
    """
    world = World.of(scenario)
    _, vehicles = vehicles_at(world.tracks, world.members, world.law.grid, 0)
    _, uavs = uavs_of(world.fleet)
    return vehicles, uavs, world.scenario.selection


def recorded_instance(folder: Path, period: int) -> tuple[VehicleTable, UavTable, Selection]:
    """Vehicles and UAVs as the contract had them when a run's period began, and the run's settings.

    Raises:
        RunFolderError: the folder is none of a run's.
        UsageError: it has no such period.
    """
    scenario, members, fleet = read_scenario(folder), read_table(folder, "members"), read_table(folder, "fleet")
    here, there = members["period"] == period, fleet["period"] == period
    if not here.any() and not there.any():
        last = max(members["period"].max(initial=0), fleet["period"].max(initial=0))
        raise UsageError("--period", period, f"a period of the run, 0 to {last}")

    def vehicles(name: str) -> FloatArray:
        return np.asarray(members[name][here], np.float64)

    def uavs(name: str) -> FloatArray:
        return np.asarray(fleet[name][there], np.float64)

    return (
        VehicleTable(
            ids=tuple(members["vehicle"][here].tolist()),
            x=vehicles("x"),
            y=vehicles("y"),
            zone=members["zone"][here].astype(np.int64),
            demand=vehicles("demand_kbps"),
            payment=vehicles("payment"),
            reputation=vehicles("reputation"),
        ),
        UavTable(
            ids=tuple(fleet["uav"][there].tolist()),
            x=uavs("x"),
            y=uavs("y"),
            zone=fleet["zone"][there].astype(np.int64),
            bandwidth=uavs("bandwidth_kbps"),
            battery=uavs("battery"),
            reputation=uavs("reputation"),
        ),
        scenario.selection,
    )
