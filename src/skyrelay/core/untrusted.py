"""JSON from outside: bounded before it is parsed, since a parser's own limits are its caller's stack and memory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

MAX_JSON = 64 * 2**20
"""Longest text that is parsed where the caller knows no smaller bound [bytes]."""

_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


def parse_json(data: bytes | str, *, size: int = MAX_JSON, depth: int = 32) -> Any:
    """The value of a JSON text, with or without a byte-order mark.

    Args:
        size: at most so many bytes.
        depth: at most so many arrays and objects around a value.
    Raises:
        ValueError: it is longer or deeper, or no JSON in UTF-8.
    """
    content = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    if len(content) > size:
        raise ValueError(f"{len(content):,} bytes, at most {size:,} are read")
    if _deeper(content, depth):
        raise ValueError(f"more than {depth} levels of arrays and objects")
    # Not `json.loads(content)`: it would take UTF-16 and UTF-32, too, whose bytes the levels were not counted in.
    return json.loads(data.removeprefix("\ufeff") if isinstance(data, str) else content.decode("utf-8-sig"))


def read_json(path: Path, *, size: int = MAX_JSON, depth: int = 32) -> Any:
    """The value of a file's JSON text; no more of the file is read than ``size`` allows.

    Raises:
        OSError: it cannot be read.
        ValueError: as `parse_json`.
    """
    with path.open("rb") as file:
        return parse_json(file.read(size + 1), size=size, depth=depth)


def _deeper(content: bytes, depth: int) -> bool:
    """Whether brackets outside of strings stand within each other deeper than that."""
    if content.count(b"[") + content.count(b"{") <= depth:
        return False
    outside = b"".join(content.replace(b"\\\\", b"").replace(b'\\"', b"").split(b'"')[::2])
    level = 0
    for bracket in outside.translate(None, _NO_BRACKETS):
        level += 1 if bracket in b"[{" else -1
        if level > depth:
            return True
    return False
