"""The whole system through the command line, and its record held against itself."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.scenario import load_scenario
from skyrelay.selection import select

pytestmark = pytest.mark.xdist_group("e2e")

TIMES = {"chain_seconds", "wall_seconds"}
SUMMARY = {
    "vehicles", "uavs", "zones", "periods", "served", "mean_qou", "mean_qov", "coverage", "connectivity",
    "connectivity_neighbor", "static_coverage", "static_connectivity", "transactions", "gas_used", "blocks",
    "chain_seconds", "wall_seconds", "model_cids",
}  # fmt: skip


def summary(folder):
    return json.loads((folder / "summary.json").read_text())


def table(folder, name):
    return pq.read_table(folder / f"{name}.parquet").to_pandas()


def test_a_run_leaves_its_whole_record(small_run):
    assert summary(small_run).keys() >= SUMMARY
    names = {path.name for path in small_run.iterdir()}
    assert names >= {"scenario.toml", "summary.json", "report.html", "figures", "chain", "store"}
    assert load_scenario(small_run / "scenario.toml").fleet.range == summary(small_run)["range_m"]


def test_a_seed_gives_one_summary_and_another_seed_another(small_run, tmp_path, play):
    first = summary(small_run)
    again = summary(play(tmp_path / "again"))
    other = summary(play(tmp_path / "other", seed=2))
    assert {k: v for k, v in first.items() if k not in TIMES} == {k: v for k, v in again.items() if k not in TIMES}
    assert first["chain_head"] != other["chain_head"]
    assert first["coverage"] != other["coverage"]
    same = {path.name for path in small_run.glob("*.parquet")} | {"report.html", "scenario.toml"}
    for name in same - {"report.html"}:
        assert (small_run / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


def test_the_figures_follow_from_the_tables(small_run):
    vehicles, metrics, proposals = (table(small_run, name) for name in ("vehicles", "metrics", "proposals"))
    counted = vehicles[(vehicles.step > 0) & (vehicles.uav != "")]
    assert summary(small_run)["coverage"] == pytest.approx(counted.covered.mean(), abs=1e-6)
    area = metrics[(metrics.zone == 0) & (metrics.step > 0)]
    assert summary(small_run)["connectivity"] == pytest.approx(area.connectivity.mean(), abs=1e-6)
    hovering = vehicles[(vehicles.step > 0) & (vehicles.static_uav != "")]
    assert summary(small_run)["static_coverage"] == pytest.approx(hovering.static_covered.mean(), abs=1e-6)
    moved = vehicles[vehicles.step > 0].groupby("step")
    assert summary(small_run)["connected"] == pytest.approx(moved.size().mean(), abs=1e-6)
    assert summary(small_run)["in_range"] == pytest.approx(moved.covered.sum().mean(), abs=1e-6)
    assert summary(small_run)["static_in_range"] == pytest.approx(moved.static_covered.sum().mean(), abs=1e-6)
    shares = vehicles[vehicles.step > 0][["covered", "static_covered"]].mean()
    assert summary(small_run)["in_range_share"] == pytest.approx(shares.covered, abs=1e-6)
    assert summary(small_run)["static_in_range_share"] == pytest.approx(shares.static_covered, abs=1e-6)
    demand = table(small_run, "members").groupby("vehicle").demand_kbps.first()
    mbps = demand.reindex(vehicles.vehicle).fillna(0).to_numpy() / 1000  # who came between selections has no UAV
    for kind, name in (("covered", "served_mbps"), ("static_covered", "static_served_mbps")):
        series = (mbps * vehicles[kind]).groupby(vehicles.step).sum()
        assert metrics[metrics.zone == 0].set_index("step")[name].to_numpy() == pytest.approx(series.to_numpy())
        assert summary(small_run)[name] == pytest.approx(series[1:].mean(), abs=1e-5)
    for kind in ("", "static_"):
        for what in ("carried", "delivered"):
            series = vehicles.groupby("step")[f"{kind}{what}_kbps"].sum() / 1000
            column = metrics[metrics.zone == 0].set_index("step")[f"{kind}{what}_mbps"]
            assert column.to_numpy() == pytest.approx(series.to_numpy())
            share = (
                vehicles[vehicles.step > 0][f"{kind}{what}_kbps"].sum() / vehicles[vehicles.step > 0].demand_kbps.sum()
            )
            assert summary(small_run)[f"{kind}{what}_share"] == pytest.approx(share, abs=1e-6)
    sums = vehicles[vehicles.step > 0].groupby("vehicle")[["demand_kbps", "delivered_kbps"]].sum()
    got = sums.delivered_kbps / sums.demand_kbps
    assert summary(small_run)["fairness"] == pytest.approx(got.sum() ** 2 / (len(got) * (got**2).sum()), abs=1e-6)
    accepted = proposals[proposals.accepted]
    assert summary(small_run)["mean_qou"] == pytest.approx(accepted.qou.mean(), abs=1e-6)
    assert summary(small_run)["served"] == accepted.vehicle.nunique()


def test_the_battery_of_a_zone_is_that_of_its_own_uavs_in_the_air(small_run):
    metrics, uavs = table(small_run, "metrics"), table(small_run, "uavs")
    air = uavs[uavs.zone > 0]
    assert len(air) < len(uavs)
    by_zone, whole = air.groupby(["step", "zone"]).battery.mean(), air.groupby("step").battery.mean()
    seen = set()
    for row in metrics.itertuples():
        expected = whole.get(row.step) if row.zone == 0 else by_zone.get((row.step, row.zone), np.nan)
        assert row.energy_percent == pytest.approx(expected, abs=1e-4, nan_ok=True)
        seen.add(round(row.energy_percent, 3))
    assert len(seen) > metrics.step.nunique()  # not one figure for all zones
    assert summary(small_run)["energy_percent"] == pytest.approx(whole.iloc[-1], abs=1e-4)


def test_covered_means_inside_the_range_of_the_own_uav(small_run):
    vehicles = table(small_run, "vehicles")
    uavs = table(small_run, "uavs")[["step", "uav", "x", "y", "zone"]]
    served = vehicles[vehicles.uav != ""].merge(uavs, on=["step", "uav"], suffixes=("", "_uav"))
    apart = np.hypot(served.x - served.x_uav, served.y - served.y_uav)
    reach = summary(small_run)["range_m"]
    clear = (apart - reach).abs() > 0.01  # the table holds positions in single precision
    inside = (apart <= reach) & (served.zone_uav > 0)
    assert (inside == served.covered)[clear].all()


def test_no_uav_promises_more_than_it_has_and_none_leaves_its_zone(small_run):
    proposals, fleet, uavs = (table(small_run, name) for name in ("proposals", "fleet", "uavs"))
    promised = proposals[proposals.accepted].groupby(["period", "uav"]).demand_kbps.sum()
    offered = fleet.set_index(["period", "uav"]).bandwidth_kbps
    assert (promised <= offered.loc[promised.index]).all()
    grid = summary(small_run)["grid"]
    flying = uavs[uavs.zone > 0]
    column, row = (flying.zone - 1) % grid["columns"], (flying.zone - 1) // grid["columns"]
    for position, low in ((flying.x, grid["x0"] + column * grid["side"]), (flying.y, grid["y0"] + row * grid["side"])):
        assert (position >= low - 0.01).all()
        assert (position <= low + grid["side"] + 0.01).all()


@pytest.mark.parametrize("rounds", [1, 3])
def test_the_chain_selects_what_the_reference_selects(tmp_path, rounds, play):
    folder = play(tmp_path / "run", f"selection.rounds={rounds}", "coordination.steps=8")
    fleet, members, proposals = (table(folder, name) for name in ("fleet", "members", "proposals"))
    uavs = UavTable(
        tuple(fleet.uav),
        fleet.x.to_numpy(),
        fleet.y.to_numpy(),
        fleet.zone.to_numpy().astype(np.int64),
        *(fleet[name].to_numpy().astype(float) for name in ("bandwidth_kbps", "battery", "reputation")),
    )
    vehicles = VehicleTable(
        tuple(members.vehicle),
        members.x.to_numpy(),
        members.y.to_numpy(),
        members.zone.to_numpy().astype(np.int64),
        *(members[name].to_numpy().astype(float) for name in ("demand_kbps", "payment", "reputation")),
    )
    chosen = select(vehicles, uavs, settings=load_scenario(folder / "scenario.toml").selection)
    expected = {vehicles.ids[v]: uavs.ids[u] for v, u in enumerate(chosen.assignment) if u >= 0}
    accepted = proposals[proposals.accepted]
    assert dict(zip(accepted.vehicle, accepted.uav, strict=True)) == expected
    assert proposals["round"].max() <= rounds
    if rounds > 1:
        assert proposals["round"].max() > 1


def test_the_audit_agrees_and_a_changed_byte_is_named(small_run, tmp_path, capsys, run):
    assert run("audit", small_run) == 0
    import shutil

    broken = tmp_path / "broken"
    shutil.copytree(small_run, broken)
    (record,) = (broken / "chain").iterdir()
    data = bytearray(record.read_bytes())
    data[len(data) // 2] ^= 1
    record.write_bytes(data)
    capsys.readouterr()
    assert run("audit", broken) == 1
    assert "DIFFERENT" in capsys.readouterr().out


def test_a_vehicle_is_told_why_it_was_not_served(small_run, capsys, run):
    proposals = table(small_run, "proposals")
    rejected = proposals[~proposals.accepted].iloc[0]
    capsys.readouterr()
    assert run("explain", small_run, "--vehicle", rejected.vehicle, "--period", rejected.period, "--json") == 0
    assert rejected.uav in capsys.readouterr().out


@pytest.mark.parametrize("source", ["manhattan", "random-waypoint"])
def test_synthetic_vehicles(tmp_path, source, play, run):
    folder = play(tmp_path / "run", f"mobility.source={source}", "mobility.vehicles=60", "coordination.step_seconds=10")
    assert summary(folder)["vehicles"] == 60
    assert run("audit", folder) == 0


def test_another_city_needs_no_more_than_its_trace(tmp_path, play, run):
    """Other extents and ids; vehicles that appear and vanish; a sample every two seconds; an empty corner."""
    random = np.random.default_rng(5)
    rows = {"time": [], "id": [], "x": [], "y": [], "speed": [], "angle": []}
    for vehicle in range(500):
        begin, length = random.uniform(-60, 150), random.uniform(10, 240)
        start, angle = random.uniform([3000, -500], [7000, 2500]), random.uniform(0, 360)
        for time in np.arange(max(0, np.ceil(begin / 2) * 2), min(240, begin + length), 2.0):
            drive = 9.0 * (time - begin)
            rows["time"].append(float(time))
            rows["id"].append(vehicle)
            rows["x"].append(float(np.clip(start[0] + drive * np.sin(np.radians(angle)), 3000, 8000)))
            rows["y"].append(float(np.clip(start[1] + drive * np.cos(np.radians(angle)), -500, 3500)))
            rows["speed"].append(9.0)
            rows["angle"].append(float(angle))
    pq.write_table(pa.table(rows), tmp_path / "city.parquet")
    (tmp_path / "city.toml").write_text('name = "elsewhere"\n[mobility]\ntrace = "city.parquet"\npenetration = 0.5\n')
    folder = play(tmp_path / "run", "mobility.penetration=0.5", scenario=tmp_path / "city.toml")
    found = summary(folder)
    assert found["name"] == "elsewhere"
    assert found["served"] > 0
    assert run("audit", folder) == 0
    there = table(folder, "vehicles").groupby("vehicle").step.agg(["min", "max"])
    assert (there["min"] > 0).any()
    assert (there["max"] < found["steps"]).any()


def test_batteries_run_out_and_selection_replaces_the_uav(tmp_path, play, run):
    folder = play(tmp_path / "run", "energy.hover_per_minute=60", "energy.move_per_minute=75", "fleet.battery=[5, 60]")
    uavs, events = table(folder, "uavs"), table(folder, "events")
    left = uavs[(uavs.zone == 0)].uav.nunique()
    assert left == summary(folder)["uavs_retired"] > 0
    assert (events.name == "UAVZoneUpdated").sum() >= left
    assert uavs[uavs.zone == 0].selected.sum() == 0
    assert run("audit", folder) == 0


def test_a_run_with_nobody_to_serve_is_a_run(tmp_path, play, run):
    folder = play(tmp_path / "run", "fleet.bandwidth=[0, 0]")
    found = summary(folder)
    assert (found["served"], found["mean_qou"], found["coverage"], found["model_cids"]) == (0, None, None, [])
    assert run("audit", folder) == 0


def test_one_zone_one_uav(tmp_path, play):
    folder = play(tmp_path / "run", "fleet.uavs=1", "zones.columns=1", "zones.rows=1", "fleet.battery=[90, 100]")
    assert summary(folder)["connectivity"] == 1.0


def test_the_recorded_action_is_the_one_that_led_to_the_step(small_run):
    uavs = table(small_run, "uavs").sort_values(["uav", "step"])
    moved = np.hypot(uavs.groupby("uav").x.diff(), uavs.groupby("uav").y.diff()) > 0.01
    assert moved.any()
    assert (uavs.action[moved] > 0).all()
    assert uavs.groupby("step").action.apply(tuple).nunique() > 1
