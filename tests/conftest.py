"""What writes its shapes down holds to them in the tests, and JAX compiles cheaply, each program once."""

from __future__ import annotations

import os

import jax
import pytest
from jaxtyping import config, install_import_hook

# Where these are imported from here on, beartype stands before every function and dataclass. Not by pytest's option
# `--jaxtyping-packages`: what pyproject.toml adds to the command line does not reach the workers of pytest-xdist.
CHECKED = ("baselines", "coordination", "learning")
install_import_hook(
    [f"skyrelay.{package}" for package in CHECKED],
    "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))",
)


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """As without the hook: for a test of how what is called with a wrong type refuses it by itself."""
    monkeypatch.setattr(config, "jaxtyping_disable", True)


def pytest_configure(config: pytest.Config) -> None:
    """Set JAX's options for this process, and by its environment for those that tests start.

    Without most of XLA's optimisations compiling takes half the time, and results agree to rounding. The persistent
    cache serves programs that several tests, or both workers, or the next run compile.
    """
    options: dict[str, bool | float | str] = {
        "jax_disable_most_optimizations": True,
        "jax_persistent_cache_min_compile_time_secs": 0.1,
        "jax_persistent_cache_min_entry_size_bytes": 0,
    }
    if config.cache:
        options["jax_compilation_cache_dir"] = str(config.cache.mkdir("jax"))
    for name, value in options.items():
        jax.config.update(name, value)
        os.environ[name.upper()] = str(value)
