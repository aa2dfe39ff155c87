"""Installed by size: the core plays a run without JAX, and a command that needs an extra says which."""

import importlib.metadata
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from skyrelay.core.extras import EXTRAS, missing

ROOT = Path(__file__).parents[2]
# A process in which the packages of all extras, and what they bring, are not there.
CORE_ALONE = f"""
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {sorted([*EXTRAS, "jaxlib", "torch"])}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
from skyrelay.cli.entry import main
main()
"""


def core(*arguments, folder=None):
    line = [sys.executable, "-c", CORE_ALONE, *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, check=False, cwd=folder)


def test_the_core_alone_plays_audits_and_explains_a_run(tmp_path):
    small = ["--set", "fleet.uavs=18", "--set", "coordination.steps=16", "--set", "coordination.period_steps=8"]
    ended = core("run", "bologna", "--out", "run", *small, folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "(bafy" in ended.stdout  # a learned policy flew
    assert (tmp_path / "run" / "report.html").exists()
    ended = core("audit", "run", folder=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    ended = core("select", "--vehicles", "50", "--uavs", "10", "--seed", "1", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (["train", "--out", "policy"], "train"),
        (["evaluate", "generalist"], "train"),
        (["baseline", "planner"], "train"),
        (["reproduce", "coordination", "--out", "figures"], "train"),
        (["reproduce", "selection", "--scale", "fast", "--out", "figures", "--ray", "local"], "ray"),
        (["up", "bologna", "--out", "run"], "pilot"),
        (["live", "run"], "pilot"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value[:2]),
)
def test_a_command_that_needs_an_extra_says_which(tmp_path, arguments, extra):
    ended = core(*arguments, folder=tmp_path)
    assert ended.returncode == 2, ended.stderr
    last = ended.stderr.splitlines()[-1]
    assert last.startswith("skyrelay: the package ")
    assert f"pip install 'skyrelay[{extra}]'" in last
    assert "Traceback" not in ended.stderr
    assert not (tmp_path / "policy").exists()
    assert not (tmp_path / "run").exists()


def test_every_extra_that_is_named_brings_the_package():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    distributions = importlib.metadata.packages_distributions()
    for module, extra in EXTRAS.items():
        names = [name.lower().replace("_", "-") for name in distributions.get(module, [module])]
        assert any(line.lower().startswith(name) for line in extras[extra] for name in names), f"{module}: {extra}"


def test_a_module_that_no_extra_brings_is_a_fault_of_ours():
    assert missing("skyrelay.nowhere", ModuleNotFoundError("No module named 'skyrelay.nowhere'")) is None
