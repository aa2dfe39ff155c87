"""An honest folder agrees; whatever of it is rewritten, with all that is needed for it to look right, is named."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from skyrelay.audit import audit_folder
from skyrelay.audit.folder import wrong_signature
from skyrelay.chain.accounts import SigningKey
from skyrelay.cli.main import app
from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.report import write_figures, write_report
from skyrelay.runfolder.manifest import Manifest, read_manifest, write_manifest
from skyrelay.runfolder.writer import write_summary
from skyrelay.simulation import play

pytestmark = pytest.mark.xdist_group("e2e")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("audit") / "run"
    folder.mkdir()
    small = ["coordination.steps=24", "coordination.period_steps=12", "selection.rounds=3", "fleet.battery=[3.5, 30]"]
    play(load_scenario("bologna", small), folder, Silent(), draw)
    return folder


def draw(folder):
    write_figures(folder)
    write_report(folder)


@pytest.fixture
def folder(recorded, tmp_path):
    return Path(shutil.copytree(recorded, tmp_path / "run"))


def places(folder):
    """Of the files that differ; the forger has written a new manifest."""
    write_manifest(folder, None)
    return {difference.place.split(":")[0] for difference in audit_folder(folder).differences}


def change(folder, table, column, edit, where=lambda rows: np.arange(len(rows)) == len(rows) // 2):
    """Rewrite some values of a column, and the page with them."""
    path = folder / f"{table}.parquet"
    old = pq.read_table(path)
    values = np.array(old[column].to_pylist(), dtype=object)
    rows = np.flatnonzero(where(old.to_pylist()))
    assert len(rows)
    values[rows] = [edit(value) for value in values[rows]]
    new = old.set_column(old.column_names.index(column), old.schema.field(column), pa.array(values, old[column].type))
    pq.write_table(new, path)


def test_an_honest_folder_agrees_and_tells_what_nobody_could_check(recorded):
    report = audit_folder(recorded)
    assert report.differences == []
    assert min(report.checked.values()) > 0
    assert any("between selections" in what for what in report.unchecked)
    tables = {path.name for path in recorded.glob("*.parquet")} - {"events.parquet"}
    assert {f"rows of {name}" for name in tables} <= set(report.checked)
    assert report.checked["stored blocks"] > 1


def test_a_radio_and_gateways_are_worked_out_again(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    radio = ["radio.model=tr36777", 'gateways=[{name = "station", x = 900.0, y = 900.0, capacity = 20.0}]']
    play(load_scenario("bologna", ["coordination.steps=4", *radio]), folder, Silent(), draw)
    assert audit_folder(folder).differences == []
    rows = pq.read_table(folder / "vehicles.parquet").to_pandas()
    assert 0 < rows.delivered_kbps.sum() < rows.carried_kbps.sum() < rows.demand_kbps[rows.uav != ""].sum()
    for column in ("carried_kbps", "delivered_kbps"):
        change(folder, "vehicles", column, lambda value: value + 900, lambda rows: np.arange(len(rows)) % 9 == 0)
        assert "vehicles.parquet" in places(folder)


def accepted(rows):
    return np.array([row["accepted"] for row in rows])


def served(rows):
    return np.array([row["uav"] != "" and row["covered"] for row in rows])


def opening(rows):
    return np.array([row["step"] == 12 for row in rows])


@pytest.mark.parametrize(
    ("table", "column", "edit", "where"),
    [
        ("proposals", "accepted", lambda value: not value, accepted),
        ("proposals", "qou", lambda value: value + 0.01, accepted),
        ("proposals", "round", lambda value: value + 1, None),
        ("proposals", "period", lambda value: 1 - value, None),
        ("proposals", "score", lambda value: value + 1, None),
        ("proposals", "demand_kbps", lambda value: value + 1, None),
        ("candidates", "qou", lambda value: value - 0.01, None),
        ("fleet", "battery", lambda value: value + 1, None),
        ("fleet", "bandwidth_kbps", lambda value: value + 1, None),
        ("fleet", "reputation", lambda value: value - 1, None),
        ("members", "payment", lambda value: value + 1, None),
        ("members", "x", lambda value: value + 0.1, None),
        ("members", "demand_kbps", lambda value: value + 1, None),
        ("accounts", "address", lambda value: value[:-1] + ("0" if value[-1] != "0" else "1"), None),
        ("accounts", "name", lambda value: value + "x", None),
        ("events", "step", lambda value: value + 12, None),
        ("vehicles", "uav", lambda _: "", served),
        ("vehicles", "covered", lambda value: not value, None),
        ("vehicles", "static_covered", lambda value: not value, None),
        ("vehicles", "carried_kbps", lambda value: value + 1, None),
        ("vehicles", "delivered_kbps", lambda value: value + 1, None),
        ("vehicles", "static_carried_kbps", lambda value: value + 1, None),
        ("vehicles", "demand_kbps", lambda value: value + 1, served),
        ("vehicles", "zone", lambda value: value % 9 + 1, None),
        ("vehicles", "x", lambda value: value + 5, opening),
        ("uavs", "zone", lambda value: value % 9 + 1, None),
        ("uavs", "selected", lambda value: not value, None),
        ("uavs", "y", lambda value: value + 5, opening),
        ("metrics", "time", lambda value: value + 0.5, None),
        ("metrics", "covered", lambda value: value + 1, None),
        ("metrics", "connected", lambda value: value + 1, None),
        ("metrics", "coverage", lambda value: value * 0.99, None),
        ("metrics", "connectivity", lambda value: 1 - value if value in (0, 1) else value + 0.1, None),
        ("metrics", "served_mbps", lambda value: value + 1, None),
        ("metrics", "demand_mbps", lambda value: value + 1, None),
        ("metrics", "carried_mbps", lambda value: value + 1, None),
        ("metrics", "static_delivered_mbps", lambda value: value + 1, None),
        ("metrics", "energy_percent", lambda value: value + 1, None),
        ("metrics", "static_covered", lambda value: value + 1, None),
    ],
)
def test_a_rewritten_table_is_named(folder, table, column, edit, where):
    change(folder, table, column, edit, **({"where": where} if where else {}))
    write_report(folder)  # the forger draws the page again
    assert f"{table}.parquet" in places(folder)


@pytest.mark.parametrize("table", ["proposals", "candidates", "fleet", "members", "accounts", "metrics", "vehicles"])
def test_a_row_that_is_missing_or_twice_is_named(recorded, folder, table):
    path = folder / f"{table}.parquet"
    rows = pq.read_table(path)
    middle = len(rows) - 1 if table == "accounts" else len(rows) // 2  # the last one is a UAV's
    for forged in (
        pa.concat_tables([rows[:middle], rows[middle + 1 :]]),
        pa.concat_tables([rows[: middle + 1], rows[middle:]]),
    ):
        pq.write_table(forged, path)
        write_report(folder)
        assert places(folder) & {f"{table}.parquet", "metrics.parquet"}


FIGURES = {
    "seed", "vehicles", "vehicles_per_period", "uavs", "served", "served_per_period", "mean_qou", "mean_qov",
    "connected", "in_range", "in_range_share", "coverage", "connectivity", "connectivity_neighbor", "served_mbps",
    "static_in_range", "static_coverage", "static_connectivity", "static_served_mbps", "energy_percent",
    "demand_mbps", "carried_mbps", "delivered_mbps", "carried_share", "delivered_share", "fairness", "handovers",
    "outage_p95_seconds", "static_carried_mbps", "static_fairness", "static_handovers", "static_outage_p95_seconds",
    "uavs_retired", "transactions", "gas_used", "blocks", "range_m", "chain_head", "contract", "model_cids",
}  # fmt: skip


def test_every_rewritten_figure_is_named(folder):
    summary = json.loads((folder / "summary.json").read_text())
    forged = {}
    for key in FIGURES:
        value = summary[key]
        forged[key] = (
            value + 1 if isinstance(value, int | float) else value[:-3] + "123" if isinstance(value, str) else []
        )
        assert forged[key] != value
    write_summary(folder, summary | forged)
    write_report(folder)
    write_manifest(folder, None)
    named = {difference.place for difference in audit_folder(folder).differences}
    assert {f"summary.json: {key}" for key in FIGURES} <= named


def test_a_rewritten_scenario_page_or_policy_is_named(folder):
    scenario = (folder / "scenario.toml").read_text()
    forged = scenario.replace("max_uav_bandwidth = 20.0", "max_uav_bandwidth = 21.0")
    assert forged != scenario
    (folder / "scenario.toml").write_text(forged)
    assert "scenario.toml" in places(folder)
    (folder / "scenario.toml").write_text(scenario)
    page = folder / "report.html"
    text = page.read_text()
    page.write_text(text.replace("connected vehicles", "satisfied vehicles"))
    assert places(folder) == {"report.html"}
    page.write_text(text)
    block = max((folder / "store" / "blocks").glob("*/*"), key=lambda path: path.stat().st_size)
    content = bytearray(block.read_bytes())
    content[100] ^= 1
    block.write_bytes(content)
    assert places(folder) == {"store"}
    block.unlink()
    assert places(folder) == {"store"}


def test_a_small_file_of_a_long_text_many_times_is_named(folder):
    """Dictionary coding makes gigabytes of text fit into kilobytes."""
    events, rows = pq.read_table(folder / "events.parquet"), 50_000
    texts = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int32)), pa.array(["x" * 2**20]))
    long = {
        field.name: texts.cast(pa.dictionary(pa.int32(), pa.string()))
        if pa.types.is_string(field.type) or pa.types.is_dictionary(field.type)
        else pa.array(np.zeros(rows, np.int64)).cast(field.type)
        for field in events.schema
    }
    pq.write_table(pa.table(long), folder / "events.parquet", compression="zstd")
    assert (folder / "events.parquet").stat().st_size < 2**20
    assert any(difference.place.startswith("events.parquet") for difference in audit_folder(folder).differences)


def test_events_that_are_no_json_are_differences_and_no_end(folder):
    change(folder, "events", "args", lambda _: "no JSON")
    assert "events.parquet" in places(folder)


def test_a_file_that_is_gone_or_no_table_is_named(folder):
    (folder / "members.parquet").write_bytes(b"no table")
    assert any("members.parquet" in difference.place for difference in audit_folder(folder).differences)
    (folder / "members.parquet").unlink()
    assert any("members.parquet" in difference.place for difference in audit_folder(folder).differences)


def test_the_command_tells_by_its_status(recorded, folder):
    agreed = CliRunner().invoke(app, ["audit", str(recorded)], standalone_mode=False)
    assert agreed.return_value == 0
    assert "selections by UAVs" in agreed.output
    assert "Not checked" in agreed.output
    assert "All agree." in agreed.output
    change(folder, "fleet", "battery", lambda value: value + 1)
    differs = CliRunner().invoke(app, ["audit", str(folder)], standalone_mode=False)
    assert differs.return_value == 1
    assert "DIFFERENT  fleet.parquet: period " in differs.output


def test_the_command_as_json(recorded):
    tree = json.loads(CliRunner().invoke(app, ["audit", str(recorded), "--json"], standalone_mode=False).stdout)
    assert tree["agrees"] is True
    assert tree["differences"] == []
    assert tree["checked"]["proposals"] > 10
    assert tree["unchecked"]


def test_what_the_manifest_does_not_have_is_named(folder):
    (folder / "figures" / "energy.png").write_bytes(b"another chart")
    (folder / "figures" / "coverage.pdf").unlink()
    (folder / "notes.txt").write_text("new")
    found = {str(difference) for difference in audit_folder(folder).differences}
    assert found == {
        "manifest.json: figures/energy.png: other bytes, should be what the manifest has",
        "manifest.json: figures/coverage.pdf: is not there, should be what the manifest has",
        "manifest.json: notes.txt: a file, should be none",
    }


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"files": {}}', '{"files": {"a": 1}, "signer": null, "signature": null}', None]
)
def test_a_manifest_that_is_none_is_named(folder, text):
    (folder / "manifest.json").unlink()
    if text is not None:
        (folder / "manifest.json").write_text(text)
    assert [difference.place for difference in audit_folder(folder).differences] == ["manifest.json"]


def test_a_signature_counts_if_a_party_of_the_chain_has_given_it(recorded):
    report = audit_folder(recorded)
    party, stranger = SigningKey(), SigningKey()
    granted = next(event for event in report.events if event.name == "RoleGranted")
    report.events = [dataclasses.replace(granted, args={**granted.args, "account": party.address})]
    files = read_manifest(recorded).files
    for key, sealed, fits in ((party, True, True), (stranger, True, False), (party, False, False)):
        unsigned = Manifest(files=files, signer=None, signature=None)
        signature = key.sign(unsigned.message if sealed else b"another message").hex()
        signed = Manifest(files=files, signer=key.address, signature=signature)
        assert (wrong_signature(signed, report.events) is None) == fits
