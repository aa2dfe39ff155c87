"""Runs that are flown by rules, by a policy of a name, and by own code."""

import json
import sys

import pyarrow.parquet as pq
import pytest

from skyrelay.core.scenario import load_scenario
from skyrelay.protocol.rule import RULES

pytestmark = pytest.mark.xdist_group("e2e")

FEW = (
    "mobility.penetration=0.04",
    "fleet.uavs=6",
    "zones.columns=1",
    "zones.rows=1",
    "fleet.range=350",
    "coordination.steps=6",
)
CHARGED = ("energy.charge_per_minute=30", "energy.charging_radius=400")
OWN = """
from skyrelay.airspace.sight import Sight


def east(sight: Sight) -> int:
    return 1


def breaks(sight):
    raise KeyError("no such road")


def answers_text(sight):
    return "north"


def answers_nine(sight):
    return 9


number = 3
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A module in the folder that the command is called from."""
    (tmp_path / "own_rules.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_rules", raising=False)


def actions(folder):
    uavs = pq.read_table(folder / "uavs.parquet").to_pandas()
    return uavs[(uavs.step > 0) & (uavs.zone > 0)]


@pytest.mark.parametrize("name", RULES)
def test_every_rule_flies_a_run(tmp_path, play, run, name):
    folder = play(tmp_path / "run", *FEW, *CHARGED, f"coordination.policy={name}")
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["decided_by"] == [f"rule {name}"]
    assert len(summary["model_cids"]) == 1
    moved = (actions(folder).action > 0).any()
    if name == "hovering":
        assert not moved
    elif not name.startswith("pso"):  # where everyone is in range and no link in reach there is no better placement
        assert moved
    assert run("audit", folder) == 0
    page = (folder / "report.html").read_text()
    assert f"Flying the rule {name}" in page if name != "hovering" else "the rule that hovers" in page


def test_hovering_is_what_a_run_is_held_against(tmp_path, play):
    summary = json.loads((play(tmp_path / "run", "coordination.policy=hovering") / "summary.json").read_text())
    for measure in ("in_range", "coverage", "connectivity", "served_mbps"):
        assert summary[measure] == summary[f"static_{measure}"]


def test_a_policy_by_its_name(tmp_path, play):
    folder = play(tmp_path / "run", *FEW, "coordination.policy=generalist")
    assert json.loads((folder / "summary.json").read_text())["decided_by"] == ["policy generalist"]


def test_own_code_flies_a_run(tmp_path, play, run, own):
    folder = play(tmp_path / "run", *FEW, "coordination.policy=own_rules:east")
    assert json.loads((folder / "summary.json").read_text())["decided_by"] == ["rule own_rules:east"]
    assert 1 in set(actions(folder).action) <= {0, 1}  # a UAV that serves nobody hovers
    assert run("audit", folder) == 0


@pytest.mark.parametrize(
    ("policy", "told"),
    [
        ("own_rules:breaks", "KeyError: 'no such road'"),
        ("own_rules:answers_text", "action: is 'north'; expected a whole number from 0 to 8"),
        ("own_rules:answers_nine", "action: is 9; expected"),
        ("own_rules:number", "a function from a Sight to an action"),
        ("own_rules:nobody", "a name in that module"),
        ("no_such_module:f", "a module that can be imported here"),
        ("covr", "did you mean 'cover'?"),
        ("genralist", "did you mean 'generalist'?"),
        ("recharge", "energy.charge_per_minute above 0"),
    ],
)
def test_what_cannot_decide_is_one_line(tmp_path, run, capsys, own, policy, told):
    sets = [part for one in FEW for part in ("--set", one)]
    assert run("run", "bologna", "--policy", policy, "--out", tmp_path / "out", *sets) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "expected" in line]
    assert told in line
    assert not (tmp_path / "out").exists()


def test_code_that_a_file_names_is_not_loaded(tmp_path, run, capsys, own):
    (tmp_path / "their.toml").write_text('[coordination]\npolicy = "own_rules:marks"\n')
    (tmp_path / "own_rules.py").write_text("from pathlib import Path\nPath('was-loaded').touch()\n")
    assert load_scenario(tmp_path / "their.toml").coordination.policy == "own_rules:marks"
    assert run("run", "their.toml", "--out", "out") == 2
    assert "code that you name yourself" in capsys.readouterr().err
    assert not (tmp_path / "was-loaded").exists()
