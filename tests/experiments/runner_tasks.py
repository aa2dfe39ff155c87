"""Functions for the tests of the runner."""

import os
import signal
from pathlib import Path

import numpy as np


def draw(seed, count=3):
    values = np.random.default_rng(seed).normal(size=count)
    return [{"seed": seed, "number": number, "value": float(value)} for number, value in enumerate(values)]


def leave_a_mark(seed, folder):
    """Shows which tasks were run: one file a call."""
    mark = Path(folder) / f"{seed}-{os.getpid()}-{len(list(Path(folder).iterdir()))}"
    mark.touch()
    return [{"seed": seed}]


def die_at(seed, fatal, switch):
    """Kills its own process at one seed, as long as the switch is there."""
    if seed == fatal and Path(switch).exists():
        os.kill(os.getpid(), signal.SIGKILL)
    return draw(seed)


def refuse(seed):
    raise RuntimeError(f"no luck with seed {seed}")


def special(seed):
    return [{"seed": seed, "missing": None, "nan": float("nan"), "tiny": 5e-324, "third": 1 / 3, "whole": 2**53 + 1}]
