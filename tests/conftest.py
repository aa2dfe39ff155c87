"""Most of the time of tests that use JAX is compilation: here it is cheaper, and each program is compiled once."""

from __future__ import annotations

import os

import jax
import pytest


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
