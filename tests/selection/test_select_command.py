"""`skyrelay select` as a user calls it."""

import json
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from skyrelay.cli import select
from skyrelay.core.errors import SkyRelayError

app = typer.Typer()
app.command()(select.command)


def run(*arguments):
    return CliRunner().invoke(app, list(arguments))


def test_json_has_the_measures_and_every_vehicle():
    result = json.loads(run("--vehicles", "30", "--uavs", "8", "--seed", "3", "--json").stdout)
    assert result["method"] == "two-sided"
    assert result["served"] == sum(uav is not None for uav in result["assignment"].values())
    assert len(result["assignment"]) == 30
    again = json.loads(run("--vehicles", "30", "--uavs", "8", "--seed", "3", "--json").stdout)
    assert again == result


@pytest.mark.parametrize("method", ["two-sided", "near-feasible", "load-aware", "nnm", "optimal", "nearest", "random"])
def test_every_method_prints_its_measures(method):
    result = run("--method", method, "--vehicles", "20", "--uavs", "5", "--set", "selection.candidates=zone")
    assert result.exit_code == 0
    assert "blocking_pairs" in result.stdout


def test_full_rounds_serve_at_least_as_many_as_one():
    arguments = ("--uavs", "20", "--set", "selection.candidates=zone", "--set", "zones.columns=1", "--json")
    one, full = (json.loads(run(*arguments, "--rounds", rounds).stdout) for rounds in ("1", "full"))
    assert full["served"] > one["served"]
    assert full["rounds"] > one["rounds"] == 1


@pytest.mark.parametrize("counts", [("0", "5"), ("5", "0"), ("0", "0")])
def test_nobody_there_is_an_empty_result(counts):
    result = json.loads(run("--vehicles", counts[0], "--uavs", counts[1], "--json").stdout)
    assert result["served"] == 0
    assert result["mean_qou"] is None


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("--method", "optimum"), "method: is 'optimum'; .*did you mean 'optimal'"),
        (("--rounds", "0"), "rounds: is 0; expected a whole number from 1"),
        (("--rounds", "many"), "--rounds: is 'many'"),
        (("--method", "optimal", "--objective", "QoS"), "objective: is 'QoS'"),
        (("--set", "selection.qou_weights=[0.5,0.5,0.5,0.5]"), r"selection.qou_weights.*sum to 1 \(these sum to 2\)"),
        (("--set", "selection.qou_weights=[nan,0.5,0.5,0.5]"), "selection.qou_weights"),
        (("--set", "selection.max_distance=-1"), "selection.max_distance: is -1"),
        (("--set", "demand.bandwidth=[-1,4]"), "demand.bandwidth"),
        (("--scenario", "no-such-file.toml"), "scenario: is 'no-such-file.toml'"),
    ],
)
def test_bad_input_names_place_value_and_expectation(arguments, line):
    with pytest.raises(SkyRelayError, match=line):
        CliRunner().invoke(app, list(arguments), catch_exceptions=False)


def test_without_bandwidth_nobody_is_served():
    result = json.loads(run("--uavs", "9", "--set", "fleet.bandwidth=[0,0]", "--json").stdout)
    assert result["served"] == 0
    assert result["used_bandwidth_percent"] is None


def test_selecting_needs_no_heavy_library():
    code = "import skyrelay.cli.select, sys; print([name for name in ('jax', 'web3', 'ray') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
