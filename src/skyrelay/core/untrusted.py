"""Text from outside: bounded before it is parsed, since a parser's own limits are its caller's stack and memory.

And of one form: what can be spelled in two ways is compared by one and hashed by the other.
"""

from __future__ import annotations

import binascii
import json
import tomllib
from pathlib import Path
from typing import Any

MAX_JSON = 64 * 2**20
"""Longest text that is parsed where the caller knows no smaller bound [bytes]."""

MAX_VALUES = 4 << 20
"""Most values of a text: an empty object is two bytes of text and sixty of memory."""

_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


def parse_json(data: bytes | str, *, size: int = MAX_JSON, depth: int = 32) -> Any:
    """The value of a JSON text, with or without a byte-order mark.

    Args:
        size: at most so many bytes.
        depth: at most so many arrays and objects around a value.
    Raises:
        ValueError: it is longer or deeper, of more values than `MAX_VALUES`, or no JSON in UTF-8.
    """
    content = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    if len(content) > size:
        raise ValueError(f"{len(content):,} bytes, at most {size:,} are read")
    if content.count(b",") > MAX_VALUES:
        raise ValueError(f"more than {MAX_VALUES:,} values")
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


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text, of a length that the caller has bounded.

    Raises:
        ValueError: it is none, has a number of more digits than Python reads, or is too deep.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("arrays and tables too deep within each other") from None


def hex_bytes(text: Any) -> bytes:
    """The bytes that JSON-RPC's data names: ``0x`` and pairs of hexadecimal digits, and nothing else.

    Raises:
        ValueError: it is something else; `bytes.fromhex` would pass over spaces.
    """
    if not isinstance(text, str) or not text.startswith("0x"):
        raise ValueError("no data: 0x and pairs of hexadecimal digits")
    return binascii.unhexlify(text[2:])


def hex_number(text: Any) -> int:
    """The number that JSON-RPC's quantity names: ``0x`` and at most 64 hexadecimal digits.

    Raises:
        ValueError: it is something else; `int` would take signs, spaces and underscores.
    """
    if not isinstance(text, str) or not 2 < len(text) <= 66:
        raise ValueError("no quantity: 0x and at most 64 hexadecimal digits")
    digits = text[2:]
    return int.from_bytes(hex_bytes(text[:2] + "0" * (len(digits) % 2) + digits), "big")


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
