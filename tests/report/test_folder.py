"""What a run folder must hold, and what one hears when it does not."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrelay.core.errors import RunFolderError
from skyrelay.report import write_figures, write_report
from skyrelay.runfolder import read_run


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    return shutil.copytree(recorded, tmp_path / "run")


def column(folder: Path, table: str, name: str, values: object) -> None:
    path = folder / f"{table}.parquet"
    read = pq.read_table(path)
    array = values if isinstance(values, pa.Array) else pa.array(values)
    pq.write_table(read.set_column(read.column_names.index(name), name, array), path)


def test_reads_what_was_written(recorded: Path) -> None:
    run = read_run(recorded)
    assert run.summary.steps == 30
    assert run.scenario.fleet.uavs == run.summary.uavs == 12
    assert run.grid.side == run.summary.range_m * 2
    rows = pq.read_table(recorded / "metrics.parquet").to_pylist()
    expected = [row["coverage"] for row in rows if row["zone"] == 0]
    assert run.metric("coverage").tolist() == expected


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match=r"run folder: is '.*nowhere'; expected a folder that `skyrelay run`"):
        read_run(tmp_path / "nowhere")


@pytest.mark.parametrize(
    "name",
    [
        "scenario.toml",
        "summary.json",
        "vehicles.parquet",
        "uavs.parquet",
        "metrics.parquet",
        "proposals.parquet",
        "events.parquet",
        "accounts.parquet",
    ],
)
def test_a_file_is_missing_or_broken(folder: Path, name: str) -> None:
    (folder / name).write_bytes(b"\x00\xff not a table {")
    with pytest.raises(RunFolderError, match=name) as broken:
        read_run(folder)
    assert "\n" not in str(broken.value)
    (folder / name).unlink()
    with pytest.raises(RunFolderError, match=f"{name}: expected a file of the run folder; it is not there"):
        read_run(folder)


def test_truncated_parquet(folder: Path) -> None:
    path = folder / "uavs.parquet"
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(RunFolderError, match=r"uavs\.parquet: expected readable Parquet"):
        read_run(folder)


def test_a_column_is_missing(folder: Path) -> None:
    path = folder / "metrics.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["static_coverage"]), path)
    with pytest.raises(RunFolderError, match=r"metrics\.parquet: is .*; expected a column 'static_coverage'"):
        read_run(folder)


def test_a_column_of_another_type(folder: Path) -> None:
    count = pq.read_metadata(folder / "uavs.parquet").num_rows
    column(folder, "uavs", "battery", ["full"] * count)
    with pytest.raises(RunFolderError, match=r"uavs\.parquet: battery: is 'string'; expected a column of double"):
        read_run(folder)


@pytest.mark.parametrize(
    ("table", "name", "value", "message"),
    [
        ("vehicles", "x", float("nan"), r"vehicles\.parquet: x\[3\]: is nan; expected a finite position"),
        ("vehicles", "y", None, r"vehicles\.parquet: y\[3\]: is 'null'"),
        ("vehicles", "step", 31, r"vehicles\.parquet: step\[3\]: is 31; expected a step of the run \(0 to 30\)"),
        ("vehicles", "zone", -1, r"vehicles\.parquet: zone\[3\]: is -1; expected a zone of the grid \(0 to 4\)"),
        ("vehicles", "uav", "ghost", r"vehicles\.parquet: uav: is 'ghost'; expected a UAV of uavs\.parquet"),
        ("vehicles", "static_uav", "ghost", r"vehicles\.parquet: static_uav: is 'ghost'"),
        ("metrics", "zone", 5, r"metrics\.parquet: zone\[3\]: is 5"),
        ("events", "args", "{", r"events\.parquet: args\[3\]: is '{'; expected JSON"),
        ("events", "args", '{"a": ' + "9" * 5000 + "}", r"events\.parquet: args\[3\]: is .*; expected JSON"),
        ("events", "args", "[1]", r"events\.parquet: args\[3\]: is '\[1\]'; expected a JSON object"),
    ],
)
def test_a_value_that_does_not_fit(folder: Path, table: str, name: str, value: object, message: str) -> None:
    values = pq.read_table(folder / f"{table}.parquet")[name].to_pylist()
    values[3] = value
    column(folder, table, name, values)
    with pytest.raises(RunFolderError, match=message):
        write_report(folder)
    assert not (folder / "report.html").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": None}, "summary.json: steps: expected this key; it is missing"),
        ({"gas_used": "much"}, "summary.json: gas_used: is 'much'; expected"),
        ({"grid": {"x0": 0, "y0": 0, "side": -1, "columns": 1, "rows": 1}}, "summary.json: grid.side: is -1"),
        ({"coverage": float("nan")}, "summary.json: coverage: is nan; expected a finite number"),
    ],
)
def test_a_summary_that_does_not_fit(folder: Path, change: dict[str, object], message: str) -> None:
    path = folder / "summary.json"
    summary = json.loads(path.read_text()) | change
    path.write_text(
        json.dumps({key: value for key, value in summary.items() if key not in change or value is not None})
    )
    with pytest.raises(RunFolderError) as fault:
        write_figures(folder)
    assert message in str(fault.value)
    assert not (folder / "figures").exists()
