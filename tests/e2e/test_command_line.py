"""What `skyrelay run` and `skyrelay explain` say about a run."""

import json

import pytest

pytestmark = pytest.mark.xdist_group("e2e")

TINY = ["coordination.steps=4", "coordination.period_steps=2", "fleet.uavs=9"]


@pytest.fixture
def said(run, capsys):
    """Status and standard output of a command."""

    def call(*arguments):
        status = run(*arguments)
        return status, capsys.readouterr().out

    return call


def test_a_shipped_policy_flies_by_its_name_and_the_share_is_said(said, tmp_path):
    sets = [part for override in (*TINY, "coordination.policy=generalist") for part in ("--set", override)]
    status, out = said("run", "--out", tmp_path / "run", *sets)
    assert status == 0
    assert "(mobility.penetration: 0.21 of the trace's)" in out
    assert len(json.loads((tmp_path / "run" / "summary.json").read_text())["model_cids"]) == 1


def test_explain_lists_the_ids_it_can_be_asked_for(said, small_run):
    status, out = said("explain", small_run, "--list", "--json")
    assert status == 0
    counts = json.loads(out)
    summary = json.loads((small_run / "summary.json").read_text())
    assert sum(count["served"] for count in counts.values()) == round(summary["served_per_period"] * summary["periods"])
    assert all(0 <= count["served"] <= count["periods"] <= summary["periods"] for count in counts.values())
    served = next(vehicle for vehicle, count in counts.items() if count["served"])
    assert said("explain", small_run, "--vehicle", served)[0] == 0
    status, out = said("explain", small_run, "--list", "--period", "0")
    assert any(line.split()[0] == served for line in out.splitlines()) or counts[served]["periods"] < summary["periods"]
    assert said("explain", small_run)[0] == 2
