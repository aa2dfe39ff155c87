"""Runs beside each other: groups, pairs by seed, intervals; and the command."""

import json
import math
import shutil

import pytest

from skyrelay.core.errors import UsageError
from skyrelay.report.compare import draw, groups_of, table
from skyrelay.runfolder.folder import SCENARIO, SUMMARY
from skyrelay.runfolder.reader import read_table

pytestmark = pytest.mark.xdist_group("e2e")

SMALL = ("mobility.penetration=0.08", "fleet.uavs=18", "coordination.steps=24", "coordination.period_steps=8")


@pytest.fixture
def make(tmp_path, small_run):
    """A run's folder with another seed, policy and figures: what is read of it for a comparison."""

    def run(name, seed, in_range, policy="auto"):
        folder = tmp_path / name
        folder.mkdir()
        shutil.copy(small_run / SCENARIO, folder)
        text = (folder / SCENARIO).read_text().replace('policy = "auto"', f'policy = "{policy}"')
        (folder / SCENARIO).write_text(text)
        summary = json.loads((small_run / SUMMARY).read_text())
        summary |= {"seed": seed, "in_range": in_range, "static_in_range": in_range - 2.0 * seed}
        (folder / SUMMARY).write_text(json.dumps(summary))
        return folder

    return run


def row(rows, measure, runs):
    (found,) = [one for one in rows if one["measure"] == measure and one["runs"] == runs]
    return found


def test_pairs_are_by_seed(make):
    folders = [make("a1", 1, 10.0), make("a2", 2, 20.0), make("a3", 3, 90.0)]
    folders += [make("b2", 2, 23.0, "cover"), make("b1", 1, 12.0, "cover"), make("b9", 9, 0.0, "cover")]
    first, second = groups_of(folders)
    assert (first.label, second.label) == ("coordination.policy=auto", "coordination.policy=cover")
    found = row(table([first, second]), "in_range", second.label)
    assert found["seeds"] == 3
    assert found["paired"] == 2
    assert found["difference_mean"] == pytest.approx(2.5)  # 12 - 10 and 23 - 20; seed 9 has no partner
    half = 12.706 * math.sqrt(0.5) / math.sqrt(2)  # Student's t with one degree of freedom, by hand
    assert found["difference_high"] - found["difference_mean"] == pytest.approx(half, rel=1e-3)


def test_a_single_kind_is_held_against_hovering(make):
    groups = groups_of([make("a1", 1, 10.0), make("a2", 2, 20.0)], hovering=True)
    assert [group.label for group in groups] == ["hovering", "flying"]
    assert row(table(groups), "in_range", "flying")["difference_mean"] == pytest.approx(3.0)
    for measure in ("carried_mbps", "delivered_mbps", "fairness", "handovers"):
        assert row(table(groups), measure, "hovering")["seeds"] == 2
    assert row(table(groups), "gas_used", "flying")["seeds"] == 2  # of which the fleet that hovers has none


def test_one_run_has_no_interval(make):
    found = row(table(groups_of([make("a1", 1, 10.0)])), "in_range", "flying")
    assert found["mean"] == 10.0
    assert found["low"] is None


def test_the_same_run_twice_is_refused(make):
    with pytest.raises(UsageError, match="seed 1 once more"):
        groups_of([make("a", 1, 1.0), make("b", 1, 2.0)])


def test_a_figure(make, tmp_path):
    draw(groups_of([make("a1", 1, 10.0), make("a2", 2, 20.0)], hovering=True), tmp_path / "figure.svg")
    text = (tmp_path / "figure.svg").read_text()
    assert text.startswith("<?xml")


def test_the_command(make, tmp_path, run, capsys):
    folders = [make("a1", 1, 10.0), make("a2", 2, 20.0)]
    assert run("compare", *folders, "--figure", tmp_path / "f.png", "--json") == 0
    assert row(json.loads(capsys.readouterr().out), "in_range", "flying")["paired"] == 2
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")
    assert run("compare", *folders) == 0
    assert "difference +3.0" in capsys.readouterr().out
    assert run("compare", tmp_path) == 2


def test_seeds_beside_each_other(tmp_path, run, capsys):
    sets = ("mobility.penetration=0.04", "fleet.uavs=6", "coordination.steps=4", "coordination.period_steps=2")
    options = [part for one in sets for part in ("--set", one)]
    assert run("run", "bologna", "--seeds", 3, "--out", tmp_path / "city", "--json", *options) == 0
    found = row(json.loads(capsys.readouterr().out), "in_range", "flying")
    assert (found["seeds"], found["paired"]) == (3, 3)
    assert found["difference_low"] <= found["difference_mean"] <= found["difference_high"]
    summaries = [json.loads((tmp_path / f"city-{seed}" / SUMMARY).read_text()) for seed in (1, 2, 3)]
    by_hand = [one["in_range"] - one["static_in_range"] for one in summaries]
    assert found["difference_mean"] == pytest.approx(sum(by_hand) / 3)


def test_selecting_again_what_a_run_selected(small_run, run, capsys):
    assert run("select", "--run", small_run, "--json") == 0
    again = json.loads(capsys.readouterr().out)["assignment"]
    proposals = read_table(small_run, "proposals")
    mine = (proposals["period"] == 0) & proposals["accepted"]
    recorded = dict(zip(proposals["vehicle"][mine], proposals["uav"][mine], strict=True))
    assert {vehicle: uav for vehicle, uav in again.items() if uav} == recorded
    assert run("select", "--run", small_run, "--period", 2, "--method", "nnm", "--json") == 0
    assert json.loads(capsys.readouterr().out)["method"] == "nnm"
    assert run("select", "--run", small_run, "--period", 77) == 2
    assert "a period of the run, 0 to 2" in capsys.readouterr().err


def test_selecting_for_the_vehicles_of_a_trace(small_run, run, capsys):
    sets = [part for one in SMALL for part in ("--set", one)]
    assert run("select", "--scenario", "bologna", "--trace", "bologna", "--seed", 1, "--json", *sets) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["uavs"] == 18
    members = read_table(small_run, "members")
    assert sorted(told["assignment"]) == sorted(members["vehicle"][members["period"] == 0])
    assert run("select", "--trace", "bologna", "--uavs", 3) == 2
    assert "whose own are taken" in capsys.readouterr().err
