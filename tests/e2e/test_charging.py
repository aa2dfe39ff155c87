"""Runs with charging places."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from skyrelay.core.errors import ScenarioError
from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.report.alerts import alerts
from skyrelay.report.page import write_report
from skyrelay.report.payload import _contents
from skyrelay.runfolder import new_run_folder, read_run
from skyrelay.simulation import play
from skyrelay.simulation.world import World

pytestmark = pytest.mark.xdist_group("e2e")

QUEUE = (
    "mobility.vehicles=12",
    "fleet.uavs=9",
    "fleet.battery=[35, 80]",
    "coordination.steps=100",
    "coordination.period_steps=10",
    "energy.battery=30",
    "charging=[]",
    "energy.places=1",
    "energy.charging_power=600",
)
"""Batteries of ten minutes, and a place for two or three UAVs."""


def table(folder, name):
    return pq.read_table(folder / f"{name}.parquet").to_pandas()


def report(folder):
    write_report(folder)


def nothing(_):
    pass


@pytest.mark.parametrize(("policy", "rotation"), [("random", "rotate"), ("random", "alone"), ("recharge", "rotate")])
def test_no_uav_lands_empty_whatever_it_flies_by(tmp_path, run, policy, rotation):
    folder = tmp_path / "run"
    with new_run_folder(folder) as place:
        sets = (*QUEUE, f"coordination.policy={policy}", f"energy.rotation={rotation}")
        play(load_scenario("shift", sets), place, Silent(), report if rotation == "alone" else nothing)
    uavs, charging = table(folder, "uavs"), table(folder, "charging")
    summary, scenario = json.loads((folder / "summary.json").read_text()), load_scenario(folder / "scenario.toml")
    assert uavs.battery.min() >= scenario.energy.reserve - 1e-4
    assert summary["uavs_retired"] == 0
    assert summary["lowest_battery"] == pytest.approx(uavs.battery.min(), abs=1e-4)

    # Who is away goes straight to the nearest point, waits its turn, and comes back with more than it had.
    away = uavs[uavs.zone == 0]
    assert set(zip(away.step, away.uav, strict=True)) == set(zip(charging.step, charging.uav, strict=True))
    assert set(charging.state) >= {"under way", "charging", "waiting"}
    assert charging[charging.state == "charging"].groupby(["step", "point"]).size().max() == 1
    ordered = uavs.sort_values(["uav", "step"]).assign(gain=lambda rows: rows.groupby("uav").battery.diff())
    told = ordered.merge(charging, on=["step", "uav"], how="left", suffixes=("", "_told"))
    last = told.groupby("uav").state.shift()
    per_step = 600.0 / 30.0 * 4.0 / 36.0
    charged = told[(told.state == "charging") & (last == "charging") & (told.battery < 100)]
    assert charged.gain.to_numpy() == pytest.approx(np.full(len(charged), per_step), abs=1e-4)
    assert (told[(told.state == "waiting") & (last == "waiting")].gain == 0).all()
    assert (told[told.zone > 0].gain.dropna() < 0).all()
    back = told[(told.zone > 0) & (told.groupby("uav").zone.shift() == 0)]
    assert len(back) > 0
    if (policy, rotation) == ("random", "alone"):  # its UAVs leave in the middle of a period, too
        assert run("audit", folder) == 0
    if policy == "recharge":
        assert back.battery.min() >= 49  # it does not wait until it is full
    elif rotation == "rotate":
        leaves = told[(told.zone == 0) & (told.groupby("uav").zone.shift() > 0)]
        assert set((leaves.step - 1) % 10) == {0}  # between two periods: no link is cut

    whole = read_run(folder)
    header, _ = _contents(whole)
    assert len(header["charging"]["points"]) == 4
    assert not any("landed" in alert.text for _, alert in alerts(whole))


FAR = '[{name = "far", x = 90000, y = 0}]'


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (["energy.charge_per_minute=5"], ["energy.charge_per_minute of 0 beside [[charging]]"]),
        (["charging=[]", "energy.places=1", "energy.charge_per_minute=5"], ["of 0 beside energy.places"]),
        (["energy.places=-1"], ["energy.places"]),
        (["energy.charging_power=0"], ["energy.charging_power"]),
        (["energy.payload=-1"], ["energy.payload"]),
        (["energy.rotation=often"], ["energy.rotation", "'rotate'"]),
        (["charging=[{x = 1, y = 1}]"], ["charging.0.name"]),
        (['charging=[{name = "a", x = 1, y = 1, place = 2}]'], ["did you mean 'places'?"]),
        (['charging=[{name = "a", x = 1, y = 1}, {name = "a", x = 1, y = 2}]'], ["'a' is there twice"]),
        (["charging=[]", "energy.places=1", "zones.columns=11", "zones.rows=10"], ["at most 100 zones"]),
        ([f"charging={FAR}"], ["'far' at x 90000", "x 0 to 3000 m"]),
        (["fleet.battery=[1, 2]"], ["fleet.battery", "way to a charging point"]),
        (["energy.battery=2"], ["charging", "of a battery for the longest way there and back"]),
    ],
)
def test_what_cannot_be_is_one_line(overrides, parts):
    with pytest.raises(ScenarioError) as fault:
        World.of(load_scenario("shift", overrides))
    assert len(str(fault.value).splitlines()) == 1
    for part in parts:
        assert part in str(fault.value)


def test_listed_points_are_kept_by_what_is_printed_of_a_scenario(tmp_path):
    from skyrelay.core.scenario import to_commented_toml, to_toml

    listed = ['charging=[{name = "roof", x = 1500, y = 1500, places = 3, power = 900}]']
    scenario = load_scenario("shift", listed)
    for number, text in enumerate((to_toml(scenario), to_commented_toml(scenario))):
        path = tmp_path / f"{number}.toml"
        path.write_text(text)
        assert load_scenario(path) == scenario
