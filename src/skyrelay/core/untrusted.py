"""JSON from outside: bounded before it is parsed, since a parser's own limits are its caller's stack and memory."""

from __future__ import annotations

import json
import re
from typing import Any

_TEXT_OR_BRACKET = re.compile(rb'"(?:[^"\\]|\\.)*+"|[\[{]|[\]}]', re.DOTALL)


def parse_json(data: bytes | str, *, size: int, depth: int = 32) -> Any:
    """The value of a JSON text.

    Args:
        size: at most so many bytes.
        depth: at most so many arrays and objects around a value.
    Raises:
        ValueError: it is longer or deeper, or no JSON in UTF-8.
    """
    content = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    if len(content) > size:
        raise ValueError(f"{len(content):,} bytes, at most {size:,} are read")
    level = 0
    for match in _TEXT_OR_BRACKET.finditer(content):
        first = match[0][:1]
        level += (first in b"[{") - (first in b"]}")
        if level > depth:
            raise ValueError(f"more than {depth} levels of arrays and objects")
    return json.loads(content)
