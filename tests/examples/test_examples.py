"""Every example runs, and shows what it says it shows."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="needs the extra ray")


@pytest.fixture
def example(tmp_path):
    def run(name, *arguments):
        line = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
        ended = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    return run


def test_an_own_selection_stands_beside_the_shipped_ones(example):
    served = dict(re.findall(r"^(\S+) +(\d+) ", example("own_selection.py", "--steps", 20), re.MULTILINE))
    assert set(served) == {"two-sided", "nearest", "best-payer-first"}
    assert 0 < int(served["best-payer-first"]) <= 200


def test_an_own_network_is_checked_and_flown(example, tmp_path):
    shown = example("own_onnx.py", "--out", "own", "--steps", 8)
    assert "by-hand: checked" in shown
    assert float(re.search(r"by-hand: coverage ([\d.]+)", shown)[1]) > 0.9
    assert (tmp_path / "own" / "by-hand" / "summary.json").exists()


def test_an_own_learner_learns(example):
    returns = [float(value) for value in re.findall(r"games +(-[\d.]+)", example("own_jax_loop.py", "--updates", 11))]
    assert returns[-1] > returns[0] + 1.0


def test_the_game_by_pettingzoo(example):
    shown = example("pettingzoo_loop.py", "--steps", 10)
    assert re.search(r"^random +return +-?[\d.]+ in 10 steps", shown, re.MULTILINE)
    assert re.search(r"^hovering +return +-?[\d.]+ in 10 steps", shown, re.MULTILINE)


def test_own_mobility_ends_in_a_report(example, tmp_path):
    assert example("own_mobility.py", "--out", "town", "--steps", 20).startswith("120 vehicles")
    assert (tmp_path / "town" / "report.html").exists()


def test_the_audit_finds_what_was_changed(example):
    shown = example("audit_as_library.py", "--steps", 20)
    assert "as it was played: 0 differences" in shown
    assert "proposals.parquet: order 0: qou" in shown


@needs_ray
def test_a_sweep_on_ray(example, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), str(EXAMPLES)])))
    shown = example("sweep_on_ray.py", "--uavs", 9, 18, "--seeds", 1, "--steps", 4)
    assert re.search(r"^ +9 UAVs: +[\d.]+ of \d+ vehicles", shown, re.MULTILINE)
    assert re.search(r"^ 18 UAVs: +[\d.]+ of \d+ vehicles", shown, re.MULTILINE)


def test_every_example_is_listed_and_tested():
    listed = (EXAMPLES / "README.md").read_text()
    tested = Path(__file__).read_text()
    for path in EXAMPLES.glob("*.py"):
        assert f"({path.name})" in listed
        assert path.name in tested or path.name == "train_with_benchmarl.py"  # tests/peers runs that one
