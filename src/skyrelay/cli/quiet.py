"""Standard output for results alone."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stdout_kept_clean() -> Iterator[None]:
    """Send what compiled libraries print to standard output to standard error.

    HiGHS, which scipy's MILP is, prints a line of its own now and then; in ``--json`` output it would be a fault.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        yield
    finally:
        sys.stdout.flush()
        ctypes.CDLL(None).fflush(None)  # the library's own buffer, before standard output is itself again
        os.dup2(kept, 1)
        os.close(kept)
