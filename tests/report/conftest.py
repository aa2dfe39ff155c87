from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


def _sample() -> ModuleType:
    """sample.py beside this file (tests are imported by their path, not as a package)."""
    spec = importlib.util.spec_from_file_location("report_sample", Path(__file__).with_name("sample.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def sample() -> ModuleType:
    return _sample()


@pytest.fixture(scope="session")
def recorded(sample: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder that no test changes."""
    return sample.write_run_folder(tmp_path_factory.mktemp("recorded") / "run", sample.street_tracks(60, 30))
