"""`skyrelay evaluate` and `skyrelay baseline`: the same options, the same episodes."""

import json
from importlib.resources import files

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrelay.experiments import suite_tasks

NUMBERS = ("--uavs", "2", "--vehicles", "2-5", "--episodes", "6", "--json")


@pytest.fixture(scope="module")
def trace(tmp_path_factory):
    """Sixty vehicles that drive around a square of 900 m, for 260 s."""
    rows = {"time": [], "id": [], "x": [], "y": []}
    for time in range(0, 261, 5):
        for vehicle in range(60):
            way = (15.0 * vehicle + 8.0 * time) % 3600.0
            side, along = divmod(way, 900.0)
            x, y = [(along, 0.0), (900.0, along), (900.0 - along, 900.0), (0.0, 900.0 - along)][int(side)]
            for name, value in zip(rows, (float(time), f"car{vehicle}", x, y), strict=True):
                rows[name].append(value)
    path = tmp_path_factory.mktemp("trace") / "square.parquet"
    pq.write_table(pa.table(rows), path)
    return path


def outcome(ended):
    assert ended.status == 0, ended.err
    return json.loads(ended.out)


def test_a_shipped_policy_on_a_trace_beats_standing_still(skyrelay, trace):
    options = ("--trace", trace, "--zone-side", 400, *NUMBERS)
    policy = outcome(skyrelay("evaluate", "generalist", *options))
    static = outcome(skyrelay("baseline", "static", *options))
    assert policy["trace"] == static["trace"] == str(trace)
    assert policy["return"]["mean"] > static["return"]["mean"]
    for measures in (policy, static):
        assert 0 <= measures["coverage"]["low"] <= measures["coverage"]["mean"] <= 1
        expected = 100 * (measures["coverage"]["mean"] + measures["connectivity"]["mean"] - 2)
        assert measures["return"]["mean"] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--games", "chess"], ["--games", "'chess'", "paper"]),
        (["--uavs", "5-2"], ["--uavs", "'5-2'", "range"]),
        (["--zone-side", "400"], ["--zone-side", "--trace"]),
        (["--trace", "nowhere.parquet"], ["nowhere.parquet", "bologna"]),
        (["--trace", "bologna", "--step-seconds", "10"], ["trace", "s long", "1000 s"]),
        (["--trace", "bologna", "--zone-side", "9000"], ["zone side", "9000", "2165.5 m"]),
    ],
)
@pytest.mark.parametrize("command", [("evaluate", "generalist"), ("baseline", "static")])
def test_options_that_do_not_fit(skyrelay, command, arguments, parts):
    ended = skyrelay(*command, *arguments)
    assert ended.status == 2
    assert ended.out == ""
    (line,) = [line for line in ended.err.splitlines() if line.startswith("skyrelay: ")]
    for part in parts:
        assert part in line


def test_a_planner_cannot_look_ahead_in_a_trace(skyrelay, trace):
    ended = skyrelay("baseline", "planner", "--trace", trace, *NUMBERS)
    assert ended.status == 2
    assert "planner" in ended.err


def test_a_suite_is_the_same_episodes_for_everybody_and_goes_on_where_it_stopped(skyrelay, tmp_path, monkeypatch):
    task = suite_tasks.GameTask("one", 2, 2, radio="air-to-ground", gateway=True, hovering=0.5, best=1.0)
    tiny = suite_tasks.Suite("tiny-v1", "Tiny", (task,), 2, 2)
    monkeypatch.setattr(suite_tasks, "suites", lambda: {"tiny-v1": tiny})
    file = files("skyrelay.data") / "policies" / "generalist.onnx"
    options = (
        "evaluate",
        "--suite",
        "tiny",
        "--only",
        "static,generalist",
        "--policy",
        f"twice={file},{file}",
        "--json",
    )
    first = outcome(skyrelay(*options, "--out", tmp_path))
    assert {method["name"] for method in first["methods"]} == {"generalist", "static", "twice"}
    journal = tmp_path / "journal.jsonl"
    whole = journal.read_bytes()
    journal.write_bytes(b"".join(whole.splitlines(keepends=True)[:2]) + b'{"task": "one-')  # killed while it wrote
    assert outcome(skyrelay(*options, "--out", tmp_path)) == first
    assert journal.read_bytes() == whole
    assert "tiny-v1" in (tmp_path / "leaderboard.html").read_text()

    rows = pq.read_table(tmp_path / "results.parquet").to_pylist()
    by = {}
    for row in rows:
        by.setdefault(row.pop("method"), []).append(row)
    # Each file flies the run of its own number; the same file flies both as one does alone.
    assert by["generalist"] == by["twice"] != by["static"]
    assert [(row["run"], row["episode"]) for row in by["twice"]] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    for row in rows:
        assert 0.0 <= row["delivered"] <= row["carried"] + 1e-6 <= 1.0 + 1e-5
        assert row["return"] == pytest.approx(100 * (row["coverage"] + row["connectivity"] - 2), abs=1e-3)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--suite", "chess"], ["--suite", "'chess'", "sizes-v1"]),
        (["--suite", "smoke", "--uavs", "3"], ["--suite", "--uavs"]),
        (["generalist", "--suite", "smoke"], ["--suite", "model"]),
        (["generalist", "--only", "cover"], ["--only", "--suite beside it"]),
        ([], ["MODEL", "--suite"]),
    ],
)
def test_suites_that_do_not_fit(skyrelay, arguments, parts):
    ended = skyrelay("evaluate", *arguments)
    assert (ended.status, ended.out) == (2, "")
    for part in parts:
        assert part in ended.err
