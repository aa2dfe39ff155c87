"""Content identifiers: the address of a model is the hash of what it says.

The identifier of a file is the one of the profile ``unixfs-v1-2025``, which Kubo gives under that profile: the file is
cut into chunks of 1 MiB, each a raw leaf; the leaves hang from a balanced tree of dag-pb nodes with at most 1,024 links
each; every block is named by its SHA-256; a file of one chunk is its leaf. Only these identifiers are read and made.

Source: CIDv1 (multiformats), DAG-PB and UnixFS (IPLD/IPFS specifications), the profile of IPIP-499.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from skyrelay.core.errors import StoreError

PROFILE = "unixfs-v1-2025"
"""By what rules files become identifiers."""
CHUNK_BYTES = 1 << 20
LINKS_PER_NODE = 1024

RAW = 0x55
DAG_PB = 0x70
_SHA2_256 = b"\x12\x20"  # multihash prefix: the function's code and its 32 bytes of digest
_UNIXFS_FILE = 2
_EXPECTED = "a CIDv1 of a raw or dag-pb block by SHA-256, as `ipfs add` prints it under unixfs-v1-2025 (59 letters)"


@dataclass(frozen=True, order=True, slots=True)
class Cid:
    """The address of one block, and so of the file whose root it is.

    Attributes:
        codec: `RAW` (a leaf) or `DAG_PB` (a node).
        digest: SHA-256 of the block, 32 bytes.
    """

    codec: int
    digest: bytes

    @staticmethod
    def of_block(codec: int, block: bytes) -> Cid:
        """The address of ``block``."""
        return Cid(codec, hashlib.sha256(block).digest())

    @staticmethod
    def parse(text: str, place: str = "CID") -> Cid:
        """Read an identifier that came from outside: a command line, a chain, another host.

        Args:
            text: the identifier, e.g. ``bafkrei...``.
            place: where it came from, for the message.
        Raises: StoreError: anything but the one canonical spelling of an identifier made here.
        """
        try:
            if len(text) != 59 or not text.startswith("b") or text != text.lower():
                raise ValueError  # noqa: TRY301
            cid = Cid.from_bytes(base64.b32decode(text[1:].upper() + "======"), place)
        except (ValueError, binascii.Error):
            raise StoreError(place, text, _EXPECTED) from None
        if str(cid) != text:  # bits behind the last letter: a second spelling of the same address
            raise StoreError(place, text, _EXPECTED)
        return cid

    @staticmethod
    def from_bytes(data: bytes, place: str = "CID") -> Cid:
        """Read the 36 bytes of the binary form.

        Raises: StoreError: another version, codec, hash function or length.
        """
        if len(data) != 36 or data[0] != 1 or data[1] not in (RAW, DAG_PB) or data[2:4] != _SHA2_256:
            raise StoreError(place, data.hex(), _EXPECTED)
        return Cid(data[1], data[4:])

    def __bytes__(self) -> bytes:
        return bytes((1, self.codec)) + _SHA2_256 + self.digest

    def __str__(self) -> str:
        return "b" + base64.b32encode(bytes(self)).decode("ascii").rstrip("=").lower()

    def names(self, block: bytes) -> bool:
        """Whether this is the address of ``block``."""
        return hashlib.sha256(block).digest() == self.digest


@dataclass(frozen=True, slots=True)
class Link:
    """A child of a node, as its parent describes it.

    Attributes:
        cid: address of the child block.
        file_bytes: bytes of the file below it.
        dag_bytes: bytes of all blocks below it, its own among them (DAG-PB's ``Tsize``).
    """

    cid: Cid
    file_bytes: int
    dag_bytes: int


class Importer:
    """Cut a file into blocks as it streams past; the memory held is one chunk and one node a level.

    Args:
        keep: called with every block, children before parents; left out: only the address is computed.
    """

    def __init__(self, keep: Callable[[Cid, bytes], None] | None = None) -> None:
        self._keep = keep
        self._chunk = bytearray()
        self._levels: list[list[Link]] = [[]]
        self.file_bytes = 0

    def update(self, data: bytes) -> None:
        """Take the next bytes of the file."""
        self.file_bytes += len(data)
        view = memoryview(data)
        while view:
            taken = CHUNK_BYTES - len(self._chunk)
            self._chunk += view[:taken]
            view = view[taken:]
            if len(self._chunk) == CHUNK_BYTES:
                self._leaf()

    def finish(self) -> Cid:
        """Close the tree and return the address of its root. The importer is spent."""
        if self._chunk or not self.file_bytes:
            self._leaf()
        level = 0
        while len(self._levels) > level + 1 or len(self._levels[level]) > 1:
            self._close(level)
            level += 1
        return self._levels[level][0].cid

    def _leaf(self) -> None:
        block = bytes(self._chunk)
        self._chunk.clear()
        self._append(0, Link(self._put(RAW, block), len(block), len(block)))

    def _append(self, level: int, link: Link) -> None:
        if level == len(self._levels):
            self._levels.append([])
        if len(self._levels[level]) == LINKS_PER_NODE:
            self._close(level)
        self._levels[level].append(link)

    def _close(self, level: int) -> None:
        """Turn the links gathered at ``level`` into one node of the level above."""
        links = self._levels[level]
        self._levels[level] = []
        block = encode_node(links)
        size = sum(link.file_bytes for link in links)
        self._append(level + 1, Link(self._put(DAG_PB, block), size, len(block) + sum(li.dag_bytes for li in links)))

    def _put(self, codec: int, block: bytes) -> Cid:
        cid = Cid.of_block(codec, block)
        if self._keep is not None:
            self._keep(cid, block)
        return cid


def cid_of(source: bytes | Path | BinaryIO) -> Cid:
    """The address of a file, read as a stream.

    Raises: StoreError: the file cannot be read.
    """
    importer = Importer()
    for data in read_chunks(source):
        importer.update(data)
    return importer.finish()


def read_chunks(source: bytes | Path | BinaryIO) -> Iterator[bytes]:
    """The bytes of ``source`` in pieces of at most a chunk.

    Raises: StoreError: the file cannot be read.
    """
    if isinstance(source, bytes):
        for start in range(0, len(source), CHUNK_BYTES):
            yield source[start : start + CHUNK_BYTES]
    elif isinstance(source, Path):
        try:
            with source.open("rb") as file:
                yield from read_chunks(file)
        except OSError as error:
            raise StoreError(source, error.strerror, "a file that can be read") from None
    else:
        while data := source.read(CHUNK_BYTES):
            yield data


def encode_node(links: list[Link]) -> bytes:
    """The dag-pb block of a UnixFS file node over ``links``."""
    data = _number(1, _UNIXFS_FILE) + _number(3, sum(link.file_bytes for link in links))
    data += b"".join(_number(4, link.file_bytes) for link in links)
    children = (_field(1, bytes(li.cid)) + _field(2, b"") + _number(3, li.dag_bytes) for li in links)
    return b"".join(_field(2, child) for child in children) + _field(1, data)


def decode_node(block: bytes, cid: Cid) -> list[Link]:
    """The children of a UnixFS file node.

    Only what `encode_node` writes is read: nothing hidden, nothing twice, no child without bytes.

    Args:
        block: a dag-pb block whose hash was already checked.
        cid: its address, for the message.
    Raises: StoreError: the block is no such node.
    """
    try:
        children: list[tuple[Cid, int]] = []
        sizes: list[int] = []
        for field, value in _fields(block):
            if field == 2:
                child = dict(_fields(_as_bytes(value)))
                children.append((Cid.from_bytes(_as_bytes(child[1])), _as_int(child[3])))
            else:
                sizes = [_as_int(size) for number, size in _fields(_as_bytes(value)) if number == 4]
        links = [Link(child, size, total) for (child, total), size in zip(children, sizes, strict=True)]
        whole = bool(links) and all(sizes) and encode_node(links) == block
    except (ValueError, KeyError, IndexError, StoreError):
        whole = False
    if not whole:
        raise StoreError(f"block {cid}", f"{len(block)} bytes of dag-pb", "a node of a file that `ipfs add` made")
    return links


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _number(field: int, value: int) -> bytes:
    return bytes((field << 3,)) + _varint(value)


def _field(field: int, value: bytes) -> bytes:
    return bytes((field << 3 | 2,)) + _varint(len(value)) + value


def _fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Field numbers and values of a protobuf message of varints (wire type 0) and bytes (wire type 2)."""
    at = 0
    while at < len(data):
        key, at = _read_varint(data, at)
        value, at = _read_varint(data, at)
        if key & 7 == 0:
            yield key >> 3, value
        elif key & 7 == 2 and at + value <= len(data):
            yield key >> 3, data[at : at + value]
            at += value
        else:
            raise ValueError("neither a varint nor whole bytes")


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while shift < 63:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise ValueError("a varint of more than nine bytes")


def _as_bytes(value: int | bytes) -> bytes:
    if isinstance(value, bytes):
        return value
    raise ValueError("a number where bytes belong")


def _as_int(value: int | bytes) -> int:
    if isinstance(value, int):
        return value
    raise ValueError("bytes where a number belongs")
