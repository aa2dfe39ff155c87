"""What every format gives: rows as they stand in the file."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from io import BufferedIOBase
from pathlib import Path

import pyarrow as pa

MAX_SAMPLES = 50_000_000
"""A file with more is refused while it is read."""


@dataclass(frozen=True)
class Samples:
    """Rows of a file.

    Attributes:
        table: columns `time`, `id`, `x`, `y`, and `speed` where the file has it; text, numbers or time stamps.
        geographic: whether x and y are longitude and latitude by the format or the columns' names.
        attribution: what the file says of its source and licence.
        notes: what was left out while reading, and why.
    """

    table: pa.Table
    geographic: bool = False
    attribution: str = ""
    notes: tuple[str, ...] = ()


def open_bytes(path: Path) -> BufferedIOBase:
    """A file's bytes, unpacked where its name ends in ``.gz``."""
    return gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb")


def counted(count: int, what: str) -> str:
    """``1 row``, ``2,000 rows``."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"
