"""Models as blocks in a folder: the default store, and each UAV's own.

Layout: ``blocks/<two letters>/<cid>`` holds one block each, ``pins/<cid>`` is one empty file for each model kept.
Blocks are written beside their place and renamed, so that several processes may share a folder; they are hashed again
whenever they are read, so that a damaged or exchanged one is found before it is used.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from skyrelay.core.errors import StoreError
from skyrelay.core.files import atomic_path, write_bytes
from skyrelay.store.cid import CHUNK_BYTES, DAG_PB, Cid, Importer, decode_node, read_chunks
from skyrelay.store.model_store import MAX_IN_MEMORY, MAX_MODEL_BYTES, StoredModel

_MAX_BLOCK = 2 << 20  # no block of a network that speaks Bitswap is larger
_MAX_DEPTH = 6  # 1024 ** 6 leaves: far beyond any model; a chain of nodes made to be deep ends here


class LocalStore:
    """A content-addressed store in the folder ``root``, which is made when something is first put there."""

    def __init__(self, root: Path) -> None:
        self.root = root

    @property
    def place(self) -> str:
        """The folder."""
        return f"store {self.root}"

    def put(self, source: Path | bytes) -> Cid:
        """Keep a model and return its address; a block that lies here damaged is replaced.

        Raises: StoreError: the source cannot be read, or the folder cannot be written.
        """
        importer = Importer(self._write_block)
        for data in read_chunks(source):
            importer.update(data)
        cid = importer.finish()
        self._write_pin(cid)
        return cid

    def get(self, cid: Cid, max_bytes: int = MAX_IN_MEMORY) -> bytes:
        """The model's bytes.

        Raises: StoreError: a block is missing, or is not what its address says, or the model is longer.
        """
        return b"".join(self._leaves(cid, max_bytes))

    def fetch(self, cid: Cid, out: Path) -> int:
        """Write the model to ``out``, whole or not at all; return its length [bytes].

        Raises: StoreError: a block is missing or is not what its address says, or ``out`` cannot be written.
        """
        size = 0
        try:
            with atomic_path(out) as beside, beside.open("wb") as file:
                for leaf in self._leaves(cid):
                    size += file.write(leaf)
        except OSError as error:
            raise StoreError(out, error.strerror, "a path that can be written") from None
        return size

    def has(self, cid: Cid) -> bool:
        """Whether every block of the model lies here; leaves are not read."""
        seen, level = {cid}, [cid]
        for _ in range(_MAX_DEPTH + 1):
            if not all(self._path(block).is_file() for block in level):
                return False
            nodes = [block for block in level if block.codec == DAG_PB]
            # A block that is linked to many times is looked at once.
            below = {link.cid for node in nodes for link in decode_node(self._block(node), node)}
            level = sorted(below - seen)
            seen |= below
            if not level:
                return True
        raise StoreError(f"{self.place}: {cid}", f"a tree of over {_MAX_DEPTH} levels", "a file by `ipfs add`")

    def verify(self, cid: Cid) -> int:
        """Hash every block of the model again; return the model's length [bytes].

        Raises: StoreError: a block is missing, or is not what its address says.
        """
        return sum(len(leaf) for leaf in self._leaves(cid))

    def pin(self, cid: Cid) -> None:
        """Keep the model, after checking that all of it is here.

        Raises: StoreError: a block is missing, or is not what its address says.
        """
        self.verify(cid)
        self._write_pin(cid)

    def models(self) -> list[StoredModel]:
        """The models kept, by address.

        Raises: StoreError: the root block of one is missing or damaged.
        """
        pins = self.root / "pins"
        names = sorted(path.name for path in pins.iterdir() if not path.name.startswith(".")) if pins.is_dir() else []
        cids = [Cid.parse(name, f"{self.place}: pin") for name in names]
        return [StoredModel(cid, self._size(cid)) for cid in cids]

    def _size(self, cid: Cid) -> int:
        block = self._block(cid)
        return sum(link.file_bytes for link in decode_node(block, cid)) if cid.codec == DAG_PB else len(block)

    def _leaves(self, cid: Cid, max_bytes: int = MAX_MODEL_BYTES) -> Iterator[bytes]:
        """The file's chunks in order, each checked."""
        size = self._size(cid)
        if size > max_bytes:
            raise StoreError(f"{self.place}: {cid}", f"a file of {size} bytes", f"at most {max_bytes} bytes")
        left = size
        for leaf in self._leaves_below(cid, size, _MAX_DEPTH):
            left -= len(leaf)
            if left and len(leaf) != CHUNK_BYTES:  # small chunks would make as many reads as bytes
                expected = f"{CHUNK_BYTES}, as all but the last"
                raise StoreError(f"{self.place}: {cid}", f"a chunk of {len(leaf)} bytes", expected)
            yield leaf

    def _leaves_below(self, cid: Cid, size: int, depth: int) -> Iterator[bytes]:
        block = self._block(cid)
        if cid.codec != DAG_PB:
            if len(block) != size:
                raise StoreError(f"{self.place}: {cid}", f"{len(block)} bytes", f"the {size} that its parent announces")
            yield block
            return
        links = decode_node(block, cid)
        if sum(link.file_bytes for link in links) != size or not depth:
            raise StoreError(f"{self.place}: {cid}", "a node that does not fit its parent", "a file by `ipfs add`")
        for link in links:
            yield from self._leaves_below(link.cid, link.file_bytes, depth - 1)

    def _block(self, cid: Cid) -> bytes:
        path = self._path(cid)
        try:
            with path.open("rb") as file:
                block = file.read(_MAX_BLOCK + 1)
        except FileNotFoundError:
            raise StoreError(
                f"{self.place}: {cid}",
                "not here",
                "a model that was added here: `skyrelay models add FILE`",
            ) from None
        except OSError as error:
            raise StoreError(path, error.strerror, "a block that can be read") from None
        if not cid.names(block):
            raise StoreError(
                f"{self.place}: block {cid}",
                f"damaged (its {len(block)} bytes hash to {Cid.of_block(cid.codec, block)})",
                "the bytes that its address names: add the model again, or ask another store",
            )
        return block

    def _write_block(self, cid: Cid, block: bytes) -> None:
        path = self._path(cid)
        try:
            if not (path.is_file() and path.stat().st_size == len(block) and cid.names(path.read_bytes())):
                write_bytes(path, block)
        except OSError as error:
            raise StoreError(self.root, error.strerror, "a folder that can be written") from None

    def _write_pin(self, cid: Cid) -> None:
        try:
            write_bytes(self.root / "pins" / str(cid), b"")
        except OSError as error:
            raise StoreError(self.root, error.strerror, "a folder that can be written") from None

    def _path(self, cid: Cid) -> Path:
        """Where a block lies. A `Cid` spells itself in base32 letters only: no path can leave the folder."""
        name = str(cid)
        return self.root / "blocks" / name[-2:] / name
