"""Standard output for results alone."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stdout_kept_clean() -> Iterator[None]:
    """Drop what is printed to standard output meanwhile, by compiled libraries too; results are printed afterwards.

    HiGHS, the solver in scipy's MILP, prints a line of its own now and then that no option turns off; it would spoil
    ``--json`` output and the progress on a terminal.
    """
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        sys.stdout.flush()
        ctypes.CDLL(None).fflush(None)  # the libraries' own buffer, before standard output is itself again
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
