"""Most of the time of tests that use JAX is compilation: here it is cheaper, and each program is compiled once."""

from __future__ import annotations

import os

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Set JAX's options by its environment variables, for this process and those that tests start.

    Without most of XLA's optimisations compiling takes half the time, and results agree to rounding. The persistent
    cache serves programs that several tests, or both workers, or the next run compile.
    """
    os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(config.cache.mkdir("jax")) if config.cache else "")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "0")
