"""Hand-overs in a run: with hysteresis a vehicle asks its last UAV again."""

import numpy as np
import pandas as pd
import pytest

from skyrelay.runfolder.reader import read_summary

pytestmark = pytest.mark.xdist_group("e2e")

# One zone and nobody moves far: what is a candidate now was one before.
CALM = (
    "mobility.source=random-waypoint",
    "mobility.vehicles=25",
    "mobility.area=2000",
    "zones.columns=1",
    "zones.rows=1",
    "fleet.uavs=9",
    "fleet.battery=[50, 100]",
    "selection.rounds=1",
)


def read(folder, name):
    return pd.read_parquet(folder / f"{name}.parquet")


def asked_again(folder):
    """Of the vehicles served in a period whose UAV is a candidate in the next, the share that ask it again."""
    proposals, candidates = read(folder, "proposals"), read(folder, "candidates")
    again = []
    for period in range(1, proposals["period"].max() + 1):
        before = proposals[(proposals["period"] == period - 1) & proposals["accepted"]].set_index("vehicle")["uav"]
        now = proposals[proposals["period"] == period].set_index("vehicle")["uav"]
        here = candidates[candidates["period"] == period]
        weighed = set(zip(here["vehicle"], here["uav"], strict=True))
        again += [now[vehicle] == uav for vehicle, uav in before.items() if (vehicle, uav) in weighed]
    return np.mean(again), len(again)


def test_a_vehicle_stays_where_hysteresis_says_so(play, run, tmp_path):
    free = play(tmp_path / "free", *CALM)
    loyal = play(tmp_path / "loyal", *CALM, "selection.hysteresis=100")
    patient = play(tmp_path / "patient", *CALM, "selection.time_to_trigger=100")
    for folder in (loyal, patient):
        share, count = asked_again(folder)
        assert count > 20
        assert share == 1.0
    assert asked_again(free)[0] < 1.0
    # The fleet that hovers goes by the same rule.
    counted = [read_summary(folder).static_handovers for folder in (loyal, patient, free)]
    assert counted[0] == counted[1] < counted[2]
    assert run("audit", loyal) == 0


def test_candidates_are_in_range(play, tmp_path):
    folder = play(tmp_path / "run", *CALM, "fleet.range=600")
    members, fleet = (
        read(folder, name).set_index(["period", key]) for name, key in (("members", "vehicle"), ("fleet", "uav"))
    )
    rows = list(read(folder, "candidates").itertuples())
    assert len(rows) > 20
    for row in rows:
        vehicle, uav = members.loc[row.period, row.vehicle], fleet.loc[row.period, row.uav]
        assert np.hypot(vehicle.x - uav.x, vehicle.y - uav.y) <= 600.0
