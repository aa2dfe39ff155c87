"""The default run's tables, seeds 1 to 3, against those that are held (tests/golden)."""

import importlib.util
import json
from pathlib import Path

import pytest

PLACE = Path(__file__).parents[1] / "golden" / "digests.py"
_spec = importlib.util.spec_from_file_location("digests", PLACE)
assert _spec is not None
digests = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(digests)


@pytest.mark.parametrize("seed", digests.SEEDS)
def test_default_run_gives_the_golden_tables(run, tmp_path, seed):
    assert run("run", "--seed", seed, "--out", tmp_path / "run") == 0
    found = digests.of_run(tmp_path / "run")
    golden = json.loads(digests.GOLDEN.read_text())[str(seed)]
    assert set(found) == set(golden)
    moved = [
        f"{table}.{name}" for table in golden for name in golden[table] if found[table].get(name) != golden[table][name]
    ]
    assert not moved
