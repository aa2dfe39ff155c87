"""Runs with a selection again within a period and with dispatch, by transactions and by batches."""

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from skyrelay.audit.folder import audit_folder
from skyrelay.cli.main import app
from skyrelay.core.errors import ScenarioError
from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.report.bound import bound
from skyrelay.simulation.run import play

SMALL = ["coordination.steps=16", "coordination.period_steps=8", "fleet.uavs=18", "mobility.penetration=0.08"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    found = {}
    for way in ("direct", "batch"):
        folder = tmp_path_factory.mktemp(way)
        keys = [*SMALL, "coordination.reselect_steps=3", "coordination.dispatch=true", f"chain.submission={way}"]
        found[way] = folder, play(load_scenario("bologna", keys, 3), folder, Silent())
    return found


def test_vehicles_are_served_from_within_a_period_on(runs):
    folder, _ = runs["direct"]
    rows = pq.read_table(folder / "vehicles.parquet").to_pylist()
    at = [{row["vehicle"] for row in rows if row["step"] == step and row["uav"]} for step in range(17)]
    new = [step for step in range(2, 17) if at[step] - at[step - 1]]
    assert new
    assert set(new) <= {4, 7, 9, 12, 15}
    seen = [{row["vehicle"] for row in rows if row["step"] == step} for step in range(17)]
    assert at[4] - seen[0] or at[7] - seen[0]  # one that came after the period began


def test_batches_give_the_same_tables_and_uavs_are_dispatched(runs):
    zones = pq.read_table(runs["batch"][0] / "uavs.parquet", columns=["uav", "zone"]).to_pylist()
    assert len({(row["uav"], row["zone"]) for row in zones if row["zone"]}) > 18
    assert runs["batch"][1]["gas_used"] < runs["direct"][1]["gas_used"]
    for table in ("members", "candidates", "fleet", "vehicles", "uavs", "metrics"):
        direct, batch = (pq.read_table(folder / f"{table}.parquet") for folder, _ in runs.values())
        assert batch.equals(direct), table


@pytest.mark.parametrize("way", ["direct", "batch"])
def test_the_audit_agrees(runs, way):
    report = audit_folder(runs[way][0])
    assert not [d for d in report.differences if "manifest" not in d.place and "report" not in d.place]


def test_the_selection_at_the_periods_begin_is_retold(runs):
    folder, _ = runs["direct"]
    row = next(row for row in pq.read_table(folder / "proposals.parquet").to_pylist() if row["round"] > 1)
    vehicle = row["vehicle"]
    told = CliRunner().invoke(app, ["explain", str(folder), "--vehicle", vehicle], standalone_mode=False)
    members = {one["vehicle"] for one in pq.read_table(folder / "members.parquet").to_pylist()}
    assert (told.exception is None) == (vehicle in members)


def test_its_bound_counts_those_who_came_within_a_period(runs):
    (free,) = bound(runs["direct"][0], 5)
    assert free.level == "free"
    assert free.share is not None
    assert 0.0 < free.share < 1.0


@pytest.mark.parametrize("key", ["payment.enabled=true", "chain.allocation=optimistic"])
def test_what_settles_whole_periods_excludes_it(key):
    with pytest.raises(ScenarioError, match="reselect_steps"):
        load_scenario("bologna", ["coordination.reselect_steps=5", key], 1)
