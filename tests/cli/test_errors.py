"""SPEC section 8: each fault is one line naming place, value and expectation; status 2; nothing is left behind."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrelay.core.folders import new_folder, sole_writer


def refused(ended, *parts):
    assert ended.status == 2
    assert ended.out == ""
    lines = [line for line in ended.err.splitlines() if line.startswith("skyrelay: ")]
    assert len(lines) == 1
    assert ended.err.splitlines()[-1] == lines[0]
    assert "Traceback" not in ended.err
    for part in parts:
        assert part in lines[0]


@pytest.fixture
def out(tmp_path):
    yield tmp_path / "runs" / "run"
    assert not (tmp_path / "runs").exists() or list((tmp_path / "runs").iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--set", "fleet.uavs=none"], ["fleet.uavs", "'none'", "integer"]),
        (["--set", "fleet.uavz=1"], ["fleet.uavz", "did you mean 'uavs'?"]),
        (["--set", "fleet.uavs"], ["--set", "'fleet.uavs'", "key=value"]),
        (["--set", "selection.qov_weights=[1, 0, 0, 0.5]"], ["selection.qov_weights", "sum to 1"]),
        (["nowhere.toml"], ["nowhere.toml", "No such file", "bologna"]),
        (["--set", "mobility.trace=nowhere.parquet"], ["mobility.trace", "nowhere.parquet", "bologna"]),
        (["--set", "coordination.steps=400"], ["bologna", "599 s long", "800 s"]),
        (["--set", "coordination.policy=nowhere.onnx"], ["nowhere.onnx", "No such file"]),
        (["--set", "store.url=http://127.0.0.1:9"], ["http://127.0.0.1:9"]),
        (["--set", "store.url=ftp://store"], ["ftp://store", "http"]),
        (["--chain", "http://127.0.0.1:9"], ["http://127.0.0.1:9"]),
        (["--chain", "not an address"], ["an address without a host", "http"]),
        (["--seed", "-1"], ["--seed"]),
        (["--no-such-option"], ["--no-such-option"]),
    ],
)
def test_what_does_not_fit_a_run(skyrelay, out, arguments, parts):
    refused(skyrelay("run", *arguments, "--out", out), *parts)


def test_a_broken_scenario_file(skyrelay, out, tmp_path):
    path = tmp_path / "broken.toml"
    path.write_text("[fleet\nuavs = 3")
    refused(skyrelay("run", path, "--out", out), str(path), "TOML", "line 1")


@pytest.mark.parametrize(
    ("columns", "parts"),
    [
        ({"time": [0], "id": ["a"], "x": [0.0]}, ["'y'"]),
        ({"time": [0, 1], "id": ["a", "a"], "x": [0.0, None], "y": [0.0, 90.0]}, ["row 2", "x", "finite"]),
        ({"time": [], "id": [], "x": [], "y": []}, ["no rows"]),
    ],
)
def test_a_broken_trace(skyrelay, out, tmp_path, columns, parts):
    path = tmp_path / "trace.parquet"
    pq.write_table(pa.table(columns), path)
    refused(skyrelay("run", "--set", f"mobility.trace={path}", "--out", out), str(path), *parts)


def test_a_file_that_is_no_policy(skyrelay, out, tmp_path):
    path = tmp_path / "policy.onnx"
    path.write_bytes(b"\x80\x04 a pickle, say")
    refused(skyrelay("run", "--set", f"coordination.policy={path}", "--out", out), str(path), "ONNX")
    refused(skyrelay("evaluate", path, "--uavs", 3, "--vehicles", 20), str(path), "ONNX")


def test_a_folder_that_is_no_run(skyrelay, tmp_path):
    for command in ("audit", "report"):
        refused(skyrelay(command, tmp_path / "nowhere"), "nowhere")
    refused(skyrelay("explain", tmp_path / "nowhere", "--vehicle", "a"), "nowhere")


def test_a_place_that_is_taken(skyrelay, tmp_path):
    (tmp_path / "thesis.txt").write_text("dear")
    refused(skyrelay("run", "--out", tmp_path), str(tmp_path), "no run folder")
    assert (tmp_path / "thesis.txt").read_text() == "dear"


def test_commands_that_do_not_exist(skyrelay):
    refused(skyrelay("rum"), "rum")


def test_json_is_all_that_goes_to_standard_output(skyrelay):
    ended = skyrelay("select", "--vehicles", 20, "--uavs", 5, "--seed", 1, "--json")
    assert ended.status == 0
    json.loads(ended.out)


def test_the_scenario_command_prints_what_it_reads(skyrelay, tmp_path):
    printed = skyrelay("scenario", "--set", "fleet.uavs=7")
    (tmp_path / "mine.toml").write_text(printed.out)
    assert skyrelay("scenario", tmp_path / "mine.toml").out == printed.out
    assert "uavs = 7" in printed.out


@pytest.mark.parametrize("command", [["run", "--force"], ["train"]])
def test_two_at_once_into_one_place(skyrelay, tmp_path, command):
    out = tmp_path / "place"
    with new_folder(out) if command[0] == "run" else sole_writer(out):
        refused(skyrelay(*command, "--out", out), str(out), "in use", "no other process")
