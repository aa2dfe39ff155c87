"""Runs with buildings in the way, and with charging points."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from skyrelay.airspace.maps import ENERGY_MAPS, OBSTACLE_MAPS
from skyrelay.core.scenario import load_scenario
from skyrelay.policy import Policy, builtin_policies
from skyrelay.report.payload import _contents
from skyrelay.runfolder import read_run

pytestmark = pytest.mark.xdist_group("e2e")

EXAMPLE = Path(__file__).parents[2] / "examples" / "city-blocks.toml"
FEW = ("mobility.vehicles=40", "fleet.uavs=10", "coordination.steps=10", "coordination.period_steps=5")


def table(folder, name):
    return pq.read_table(folder / f"{name}.parquet").to_pandas()


def sees(vehicle, uav, buildings, altitude):
    """Whether the straight line from the ground up to the UAV misses every building, sampled every decimetre."""
    count = int(np.hypot(*(uav - vehicle)) * 10) + 2
    share = np.linspace(0, 1, count)[:, None]
    line = vehicle + share * (uav - vehicle)
    for building in buildings:
        low = share[:, 0] * altitude < building.height
        ends = np.array([building.polygon, [*building.polygon[1:], building.polygon[0]]])
        x, y = line[:, :1], line[:, 1:]
        spans = (ends[0, :, 1] <= y) != (ends[1, :, 1] <= y)
        slope = (ends[1, :, 0] - ends[0, :, 0]) / np.where(
            ends[1, :, 1] == ends[0, :, 1], 1, ends[1, :, 1] - ends[0, :, 1]
        )
        inside = (spans & (x < ends[0, :, 0] + (y - ends[0, :, 1]) * slope)).sum(axis=1) % 2 == 1
        if inside[0]:
            # A vehicle inside a building sees through its roof: blocked where the line leaves below it.
            out = np.argmin(inside) if not inside.all() else count - 1
            if not inside.all() and low[out]:
                return False
        elif (inside & low).any():
            return False
    return True


def test_a_run_with_buildings(tmp_path, play, run):
    city = play(tmp_path / "city", *FEW, scenario=EXAMPLE)
    scenario, summary = load_scenario(city / "scenario.toml"), json.loads((city / "summary.json").read_text())
    assert len(scenario.obstacles.buildings) == 40  # the run folder needs no other file
    vehicles, uavs = table(city, "vehicles"), table(city, "uavs")[["step", "uav", "x", "y", "zone"]]
    served = vehicles[vehicles.uav != ""].merge(uavs, on=["step", "uav"], suffixes=("", "_uav"))
    near = (np.hypot(served.x - served.x_uav, served.y - served.y_uav) < summary["range_m"] - 0.1) & (
        served.zone_uav > 0
    )
    some = served[near].sample(60, random_state=1)
    expected = [
        sees(np.array([row.x, row.y]), np.array([row.x_uav, row.y_uav]), scenario.obstacles.buildings, 100.0)
        for row in some.itertuples()
    ]
    assert (some.covered == expected).mean() > 0.97  # samples may miss a corner that a line only just touches
    assert 0 < np.mean(expected) < 1
    assert run("audit", city) == 0
    header, _ = _contents(read_run(city))  # what the page draws
    assert len(header["buildings"]) == 40
    assert header["charging"] is None


def test_uavs_that_hover_at_the_charging_point_charge(tmp_path, play, run):
    """Every zone is all charging point: whoever hovers fills up."""
    energy = ("energy.hover_per_minute=40", "energy.move_per_minute=60", "energy.charging_radius=10000")
    folder = play(tmp_path / "run", *energy, "energy.charge_per_minute=600", "fleet.battery=[30, 60]")
    uavs = table(folder, "uavs").sort_values(["uav", "step"])
    gain = uavs.groupby("uav").battery.diff()
    flying = (uavs.step > 0) & (uavs.zone > 0)
    idle = (uavs.action == 0) & flying
    before = uavs.groupby("uav").battery.shift()
    assert (gain[idle & (before < 80)] > 0).all()
    assert (gain[~idle & flying] < 0).all()
    assert uavs.battery.max() <= 100
    assert run("audit", folder) == 0


@pytest.mark.parametrize(("options", "maps"), [((), ()), (("obstacles",), OBSTACLE_MAPS), (("energy",), ENERGY_MAPS)])
def test_shipped_policies_fly_where_they_were_trained_for(options, maps):
    from skyrelay.simulation.consortium import deciders

    sets = {
        "obstacles": f"obstacles.buildings={EXAMPLE.parent / 'city-blocks.geojson'}",
        "energy": "energy.charge_per_minute=30",
    }
    flown = deciders(load_scenario(overrides=[sets[option] for option in options]))
    shipped = [Policy.builtin(name).card.maps for name in builtin_policies()]
    some = any(set(maps) <= set(names) for names in shipped)
    for policy in flown:
        assert (set(maps) <= set(policy.card.maps)) == some
        assert not (set(OBSTACLE_MAPS + ENERGY_MAPS) - set(maps)) & set(policy.card.maps)
