"""A run that is killed and gone on with is the run that was never killed."""

import os
import signal
import subprocess
import sys
import time

import pyarrow.parquet as pq
import pytest

LAUNCH = "from skyrelay.cli.main import main; main()"
SETS = [
    part
    for override in ("mobility.penetration=0.08", "fleet.uavs=18", "coordination.steps=240")
    for part in ("--set", override)
]


def skyrelay(*arguments, **options):
    return subprocess.Popen([sys.executable, "-c", LAUNCH, *map(str, arguments)], text=True, **options)


def killed(folder, blocks):
    """A run to ``folder`` that is killed once it has mined so many blocks; what it left."""
    run = skyrelay("run", "--out", folder, *SETS, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    until = time.monotonic() + 60
    while True:
        assert run.poll() is None
        assert time.monotonic() < until
        found = list(folder.parent.glob(f".{folder.name}.*.partial/chain/*"))
        records = [path for path in found if path.is_file() and path.read_bytes().count(b"\n") > blocks]
        if records:
            break
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    assert not folder.exists()
    return records[0]


@pytest.mark.parametrize(
    "blocks", [pytest.param(3, marks=pytest.mark.survival), 30, pytest.param(60, marks=pytest.mark.survival)]
)
def test_a_killed_run_goes_on_to_the_same_end(tmp_path, blocks):
    killed(tmp_path / "run", blocks)
    assert skyrelay("run", "--resume", tmp_path / "run", stderr=subprocess.DEVNULL).wait(120) == 0
    assert skyrelay("run", "--out", tmp_path / "other", *SETS, stderr=subprocess.DEVNULL).wait(120) == 0
    for table in ("proposals", "uavs", "vehicles", "events", "metrics"):
        one, other = (pq.read_table(tmp_path / name / f"{table}.parquet").to_pandas() for name in ("run", "other"))
        assert one.equals(other), table  # pandas takes a missing number for equal to itself


def test_a_record_that_is_not_this_run_s_is_not_gone_on_with(tmp_path):
    record = killed(tmp_path / "run", 10)
    content = bytearray(record.read_bytes())
    content[len(content) // 2] ^= 1
    record.write_bytes(content)
    run = skyrelay("run", "--resume", tmp_path / "run", stderr=subprocess.PIPE)
    _, told = run.communicate(timeout=120)
    assert run.returncode == 2
    assert "blocks that the killed run had mined" in told
    assert not (tmp_path / "run").exists()


def test_there_must_be_something_to_go_on_with(tmp_path):
    run = skyrelay("run", "--resume", tmp_path / "run", stderr=subprocess.PIPE)
    _, told = run.communicate(timeout=60)
    assert run.returncode == 2
    assert "there is nothing to go on with" in told
