"""Ctrl-C in a process of its own, at moments that its memory map and its folder tell: one line and status 130."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PROCESS = (sys.executable, "-c", "from skyrelay.cli.entry import main; main()")
TRAIN = ("train", "--uavs", "2", "--vehicles", "4", "--steps", "100000000")

pytestmark = pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="reads /proc")


def loaded(library):
    """Once a compiled library is mapped: its import is under way."""
    return lambda process, folder: library in Path(f"/proc/{process.pid}/maps").read_text()


def written(name):
    return lambda process, folder: (folder / name).exists()


def wait_until(holds, process, folder):
    deadline = time.monotonic() + 240
    while process.poll() is None and time.monotonic() < deadline:
        if holds(process, folder):
            return
        time.sleep(0.002)
    pytest.fail(f"the moment never came: {process.communicate(timeout=10)}")


@pytest.mark.parametrize(
    ("arguments", "moment"),
    [
        (TRAIN, loaded("_multiarray_umath")),
        (TRAIN, loaded("jaxlib")),
        (TRAIN, written("")),  # the folder is taken, the compiler begins
        (("run", "--force", "--set", "selection.method=nnm"), loaded("_multiarray_umath")),
        (("baseline", "planner"), loaded("jaxlib")),
    ],
    ids=["train-numpy", "train-jax", "train-compiling", "run-numpy", "baseline-jax"],
)
def test_ctrl_c_while_starting(arguments, moment, tmp_path):
    folder = tmp_path / "out"
    out = () if arguments[0] == "baseline" else ("--out", str(folder))
    process = subprocess.Popen([*PROCESS, *arguments, *out], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        wait_until(moment, process, folder)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130, told
    assert told.rstrip().endswith("skyrelay: interrupted")
    assert "Traceback" not in told


def test_ctrl_c_while_training_leaves_the_checkpoint(tmp_path):
    folder = tmp_path / "out"
    process = subprocess.Popen([*PROCESS, *TRAIN, "--out", str(folder)], stderr=subprocess.PIPE, text=True)
    try:
        wait_until(written("training.json"), process, folder)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=240)
    finally:
        process.kill()
    assert process.returncode == 130, told
    assert told.rstrip().endswith(f"interrupted; go on with --resume --out {folder}")
    assert "Traceback" not in told
    assert (folder / "checkpoint.npz").exists()
