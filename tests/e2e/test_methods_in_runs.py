"""Runs that select by another method than the contract's, checked by the contract as far as it can."""

import json
import sys

import pyarrow.parquet as pq
import pytest

pytestmark = pytest.mark.xdist_group("e2e")

FEW = ("mobility.penetration=0.06", "fleet.uavs=12", "coordination.steps=4", "coordination.period_steps=2")
OWN = """
import numpy as np

from skyrelay.selection.quality import are_candidates


def first_fit(vehicles, uavs, settings):
    \"\"\"In list order, the first candidate that has room.\"\"\"
    room, chosen = uavs.bandwidth.copy(), np.full(len(vehicles), -1)
    columns = np.arange(len(uavs))
    for row in range(len(vehicles)):
        near = are_candidates(vehicles, uavs, np.full(len(uavs), row), columns, settings)
        fits = np.flatnonzero(near & (room >= vehicles.demand[row]))
        if len(fits):
            chosen[row] = fits[0]
            room[fits[0]] -= vehicles.demand[row]
    return chosen


def all_to_one(vehicles, uavs, settings):
    return np.zeros(len(vehicles), dtype=int)


def halves(vehicles, uavs, settings):
    return np.full(len(vehicles), 0.5)


def too_few(vehicles, uavs, settings):
    return np.zeros(1, dtype=int)


def raises(vehicles, uavs, settings):
    raise ZeroDivisionError("nobody asked")
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    (tmp_path / "own_methods.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_methods", raising=False)


def served(folder, period):
    rows = pq.read_table(folder / "proposals.parquet").to_pandas()
    return rows[rows.period == period]


@pytest.mark.parametrize("method", ["near-feasible", "load-aware", "nnm", "optimal", "nearest", "random"])
def test_every_shipped_method_selects_in_a_run(tmp_path, play, run, capsys, method):
    folder = play(tmp_path / "run", *FEW, f"selection.method={method}")
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["selected_by"].startswith(f"{method}, worked out outside the contract")
    proposals = pq.read_table(folder / "proposals.parquet").to_pandas()
    assert len(proposals) > 10
    assert proposals["accepted"].all()  # what keeps to the bandwidths is taken whole
    capsys.readouterr()
    assert run("audit", folder) == 0
    assert f"the method {method} was worked out outside of the contract" in capsys.readouterr().out
    assert f"chosen by {method} outside of the chain" in (folder / "report.html").read_text()


def test_the_optimum_is_no_worse_than_the_contract(tmp_path, play):
    def total(name, method):
        folder = play(tmp_path / name, *FEW, f"selection.method={method}")
        first = served(folder, 0)
        return first[first.accepted].qou.sum()

    assert total("optimal", "optimal") >= total("two-sided", "two-sided") - 1e-6


def test_own_method_in_a_run_and_in_select(tmp_path, play, run, capsys, own):
    folder = play(tmp_path / "run", *FEW, "selection.method=own_methods:first_fit")
    assert served(folder, 0).accepted.all()
    assert run("audit", folder) == 0
    capsys.readouterr()
    assert run("select", "--method", "own_methods:first_fit", "--vehicles", 40, "--uavs", 10, "--json") == 0
    assert json.loads(capsys.readouterr().out)["served"] > 0


@pytest.mark.parametrize(
    ("method", "told"),
    [
        ("own_methods:all_to_one", "no UAV that serves more than its bandwidth"),
        ("own_methods:halves", "one whole number for each of"),
        ("own_methods:too_few", "one whole number for each of"),
        ("own_methods:raises", "ZeroDivisionError: nobody asked"),
        ("own_methods:nothing", "a name in that module"),
        ("optimall", "did you mean 'optimal'?"),
    ],
)
@pytest.mark.parametrize("command", ["run", "select"])
def test_what_cannot_select_is_one_line(tmp_path, run, capsys, own, method, told, command):
    sets = [part for one in FEW for part in ("--set", one)]
    where = ["bologna", "--out", tmp_path / "out", *sets] if command == "run" else ["--vehicles", 40, "--uavs", 10]
    assert run(command, *where, "--method", method) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "expected" in line]
    assert told in line
    assert not (tmp_path / "out").exists()


def test_hosts_of_their_own_select_by_the_contract(tmp_path, run, capsys):
    assert run("up", "bologna", "--out", tmp_path / "out", "--set", "selection.method=nnm") == 2
    assert "two-sided" in capsys.readouterr().err
