"""XML from outside, element by element, in bounded time and memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol
from xml.etree.ElementTree import Element, iterparse

MAX_DEPTH = 32
"""Elements within each other; traces have three or four."""
LONGEST = 1 << 20
"""Bytes of a tag or a text: a parser looks at an unfinished one anew with each piece that comes."""


class Readable(Protocol):
    """A file, or what stands for one."""

    def read(self, size: int = -1, /) -> bytes:
        """The next so many bytes; fewer at the end, none behind it."""
        ...


def elements(stream: Readable) -> Iterator[tuple[str, Element]]:
    """Every start and end of an element. No external entity is opened, and expat limits what internal ones become.

    Raises:
        ParseError: it is no XML.
        ValueError: it is too deep, or a tag or text is too long.
    """
    depth = 0
    for event, element in iterparse(_Pieces(stream), events=("start", "end")):  # noqa: S314
        depth += 1 if event == "start" else -1
        if depth > MAX_DEPTH:
            raise ValueError(f"more than {MAX_DEPTH} levels of elements")
        yield event, element


class _Pieces:
    """A file of which no more is read than there is between two ends of tags."""

    def __init__(self, stream: Readable) -> None:
        self._stream = stream
        self._open = 0

    def read(self, size: int = -1) -> bytes:
        """The next piece.

        Raises:
            ValueError: the tag or text that it belongs to is too long.
        """
        piece = self._stream.read(size)
        end = piece.rfind(b">")
        self._open = self._open + len(piece) if end < 0 else len(piece) - end
        if self._open > LONGEST:
            raise ValueError(f"a tag or text of more than {LONGEST:,} bytes")
        return piece
