"""One error tree. Every message names the place, the value found there, and what was expected."""

from __future__ import annotations

import re
from pathlib import Path


class SkyRelayError(Exception):
    """A fault that the person at the keyboard can mend: one line, exit status 2.

    Args:
        place: where the fault is, e.g. ``"scenario.toml: selection.qou_weights"``.
        value: what was found there, or None where there is nothing to quote.
        expected: what would have been right, phrased as advice.
    """

    exit_code = 2

    def __init__(self, place: str | Path, value: object, expected: str) -> None:
        self.place = str(place)
        self.value = value
        self.expected = expected
        found = "" if value is None else f" is {_quote(value)};"
        super().__init__(f"{self.place}:{found} expected {expected}")


class UsageError(SkyRelayError):
    """A command line or a call has an argument that does not fit."""


class ScenarioError(SkyRelayError):
    """A scenario file or a ``--set`` has a key or value that does not fit."""


class TraceError(SkyRelayError):
    """A vehicle trace cannot be read as floating-car data."""


class SelectionError(SkyRelayError):
    """Vehicles, UAVs or weights that no selection can be made from."""


class ModelError(SkyRelayError):
    """A policy file or its card does not fit what would fly it."""


class StoreError(SkyRelayError):
    """A model store does not answer, or answers with something else than was asked."""


class ChainError(SkyRelayError):
    """The chain refuses, is out of reach, or is not the one that was expected."""


class ProtocolError(SkyRelayError):
    """A message came that the process sequence does not allow at that point."""


class BusError(SkyRelayError):
    """The bus or the world is out of reach, or a message does not fit."""


class HostError(SkyRelayError):
    """A host of agents met what nobody has foreseen; it may be started again."""

    exit_code = 70  # EX_SOFTWARE of sysexits.h


class PositionError(SkyRelayError):
    """A receiver is not there, or does not say what it should."""


class AutopilotError(SkyRelayError):
    """An autopilot is not there, or does not do what it is asked."""


class TrainingError(SkyRelayError):
    """Training met a number that is none, or a checkpoint of another run."""


class RunFolderError(SkyRelayError):
    """A run folder lacks a file, or holds one that cannot be read."""


def _quote(value: object, limit: int = 120) -> str:
    """``value`` on one line, shortened."""
    try:
        text = " ".join((repr(value) if isinstance(value, str) else str(value)).split())
    except (ValueError, RecursionError):  # a number that Python does not write in tens, tables without end
        text = f"a number of {value.bit_length():,} bits" if isinstance(value, int) else f"a {type(value).__name__}"
    text = re.sub(r"(?<=://)[^/\s]*@", "...@", text)  # of an address in the wrong place: its name and password
    return text if len(text) <= limit else text[: limit - 3] + "..."
