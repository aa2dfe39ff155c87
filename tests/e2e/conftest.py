import sys

import pytest

from skyrelay.cli.main import main

SMALL = [
    "mobility.penetration=0.08",
    "fleet.uavs=18",
    "coordination.steps=24",
    "coordination.period_steps=8",
]


def _run(*arguments):
    """The console script in this process; its exit status."""
    before = sys.argv
    sys.argv = ["skyrelay", *map(str, arguments)]
    try:
        main()
    except SystemExit as ended:
        return ended.code
    finally:
        sys.argv = before
    raise AssertionError("main() always exits")


def _play(folder, *overrides, seed=1, scenario="bologna"):
    sets = [part for override in (*SMALL, *overrides) for part in ("--set", override)]
    assert _run("run", scenario, "--out", folder, "--seed", seed, *sets) == 0
    return folder


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    return _play(tmp_path_factory.mktemp("runs") / "small")


@pytest.fixture
def run():
    return _run


@pytest.fixture
def play():
    return _play
