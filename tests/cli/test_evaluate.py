"""`skyrelay evaluate` and `skyrelay baseline`: the same options, the same episodes."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

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
