"""What the pilot's tests share: processes that end with the test."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "chain")]  # for `processes`, and the chain's rounds


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory):
    """What one process makes of the scenario that `town_of_processes` plays with many."""
    from town_of_processes import sets, skyrelay

    folder = tmp_path_factory.mktemp("one") / "run"
    process = skyrelay("run", "--out", folder, *sets(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    assert process.wait() == 0
    return folder


@pytest.fixture
def start():
    """Start Python processes; they are killed when the test is over."""
    processes = []

    def begin(*arguments, **options):
        process = subprocess.Popen(
            [sys.executable, *map(str, arguments)],
            env=os.environ | options.pop("env", {}),
            stdout=subprocess.PIPE,
            text=True,
            **options,
        )
        processes.append(process)
        return process

    yield begin
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()
