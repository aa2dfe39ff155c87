"""Proposals signed, and handed in many at a time or claimed: the run that comes out is that with a transaction each."""

import pyarrow.parquet as pq
import pytest

from skyrelay.audit.folder import audit_folder
from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.simulation.run import play


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    small = ["coordination.steps=24", "coordination.period_steps=8", "fleet.uavs=18", "mobility.penetration=0.08"]
    found = {}
    for way, key in (("direct", "submission"), ("batch", "submission"), ("optimistic", "allocation")):
        folder = tmp_path_factory.mktemp(way)
        summary = play(load_scenario("bologna", [*small, f"chain.{key}={way}"], 3), folder, Silent())
        found[way] = folder, summary
    return found


@pytest.mark.parametrize("table", ["members", "candidates", "fleet", "vehicles", "uavs", "metrics"])
def test_the_tables_are_the_same(runs, table):
    direct, batch, claimed = (pq.read_table(folder / f"{table}.parquet") for folder, _ in runs.values())
    assert direct.num_rows
    assert batch.equals(direct)
    assert claimed.equals(direct)


def test_the_proposals_are_the_same_but_for_their_order(runs):
    direct, *others = (
        pq.read_table(folder / "proposals.parquet").drop_columns("order").to_pylist() for folder, _ in runs.values()
    )
    assert direct
    key = ("period", "round", "vehicle")
    for rows in others:
        assert sorted(rows, key=lambda row: [row[k] for k in key]) == sorted(
            direct, key=lambda row: [row[k] for k in key]
        )


def test_it_takes_fewer_transactions_and_less_gas(runs):
    (_, direct), (_, batch), (_, claimed) = runs.values()
    assert batch["transactions"] < direct["transactions"] / 2
    assert claimed["gas_used"] < batch["gas_used"] < direct["gas_used"]


@pytest.mark.parametrize("way", ["direct", "batch", "optimistic"])
def test_the_audit_agrees(runs, way):
    report = audit_folder(runs[way][0])
    wrong = [d for d in report.differences if "manifest" not in d.place and "report" not in d.place]
    assert not wrong
