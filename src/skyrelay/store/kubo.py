"""Models behind a Kubo node's RPC endpoint: the store that shares them with the rest of the network.

The endpoint is not trusted. What it sends is hashed while it arrives and compared with the address that was asked for;
the address that it reports for what it was given is compared with our own. A node that hangs, trickles or never ends is
cut off.
"""

from __future__ import annotations

import http.client
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlencode, urlsplit

from skyrelay.core.errors import StoreError
from skyrelay.core.files import atomic_path
from skyrelay.core.untrusted import parse_json
from skyrelay.net.http import Http, HttpError
from skyrelay.store.cid import CHUNK_BYTES, LINKS_PER_NODE, Cid, Importer, read_chunks
from skyrelay.store.model_store import MAX_IN_MEMORY, MAX_MODEL_BYTES, StoredModel

_MAX_REPLY_BYTES = 16 << 20  # of a reply that is not a model: a list of pins is the longest
_ADD = {
    # Spelt out: a node's own configuration may have other defaults, and then other addresses.
    "cid-version": 1,
    "raw-leaves": "true",
    "chunker": f"size-{CHUNK_BYTES}",
    "max-file-links": LINKS_PER_NODE,
    "hash": "sha2-256",
    "pin": "true",
    "progress": "false",
}


class KuboStore:
    """A store behind the RPC endpoint of a Kubo node.

    Args:
        url: where the node listens, e.g. ``http://127.0.0.1:5001``.
        timeout: longest silence [s]; also what the node may spend on looking for a block in its network.
        deadline: longest transfer [s], from the first byte sent to the last received.
        max_bytes: length at which a model is cut off [bytes].
    Raises: StoreError: ``url`` is no HTTP address.
    """

    def __init__(
        self, url: str, *, timeout: float = 20.0, deadline: float = 300.0, max_bytes: int = MAX_MODEL_BYTES
    ) -> None:
        try:
            self._http = Http(url, timeout=timeout)
        except HttpError as error:
            raise StoreError(
                "store address", error.told, f"http://HOST:PORT of a Kubo RPC endpoint ({error.expected})"
            ) from None
        if urlsplit(url).path not in ("", "/") or urlsplit(url).query:
            raise StoreError(
                "store address", self._http.name, "http://HOST:PORT of a Kubo RPC endpoint, as http://127.0.0.1:5001"
            )
        if self._http.has_credentials:
            raise StoreError("store address", self._http.name, "an address without a name or password in it")
        self._timeout, self._deadline, self._max_bytes = timeout, deadline, max_bytes
        self.url = self._http.name

    @property
    def place(self) -> str:
        """The address."""
        return f"store {self.url}"

    def put(self, source: Path | bytes) -> Cid:
        """Add and pin a model.

        Raises: StoreError: the source cannot be read, the node does not answer, or it reports another address.
        """
        importer = Importer()
        boundary = secrets.token_hex(16)

        def body() -> Iterator[bytes]:
            yield (
                f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="model"\r\n'
                "Content-Type: application/octet-stream\r\n\r\n"
            ).encode()
            for data in read_chunks(source):
                importer.update(data)
                yield data
            yield f"\r\n--{boundary}--\r\n".encode()

        headers = {"Content-Type": f"multipart/form-data; boundary={boundary}"}
        with self._ask("add", _ADD, body(), headers) as answer:
            reported = self._json(answer).get("Hash")
        cid = importer.finish()
        if reported != str(cid):
            raise StoreError(f"{self.place}: add", reported, f"{cid}, the address of what was sent")
        return cid

    def get(self, cid: Cid, max_bytes: int = MAX_IN_MEMORY) -> bytes:
        """The model's bytes.

        Raises: StoreError: the node does not answer, has no such model, or sends other bytes or more of them.
        """
        return b"".join(self._checked(cid, max_bytes))

    def fetch(self, cid: Cid, out: Path) -> int:
        """Write the model to ``out``, whole or not at all; return its length [bytes].

        Raises: StoreError: the node does not answer, has no such model, or sends other bytes; ``out`` is not writable.
        """
        size = 0
        try:
            with atomic_path(out) as beside, beside.open("wb") as file:
                for data in self._checked(cid):
                    size += file.write(data)
        except OSError as error:
            raise StoreError(out, error.strerror, "a path that can be written") from None
        return size

    def has(self, cid: Cid) -> bool:
        """Whether the node itself holds every block of the model; its network is not asked.

        Raises: StoreError: the node does not answer.
        """
        stat = self._stat(cid)
        return stat is not None and stat.get("Local") is True

    def verify(self, cid: Cid) -> int:
        """Read the whole model, hash it, and return its length [bytes].

        Raises: StoreError: the node does not answer, has no such model, or sends other bytes.
        """
        return sum(len(data) for data in self._checked(cid))

    def pin(self, cid: Cid) -> None:
        """Have the node fetch the model from its network, keep it, and show that it did.

        Raises: StoreError: the node does not answer, finds no such model, or sends other bytes.
        """
        with self._ask("pin/add", {"arg": cid, "recursive": "true"}) as answer:
            pins = self._json(answer).get("Pins")
        if pins != [str(cid)]:
            raise StoreError(f"{self.place}: pin", pins, f"[{cid}]")
        self.verify(cid)

    def models(self) -> list[StoredModel]:
        """The files pinned on the node whose addresses are of our kind, by address; folders are left out.

        Raises: StoreError: the node does not answer, or answers with something else.
        """
        with self._ask("pin/ls", {"type": "recursive"}) as answer:
            keys = self._json(answer).get("Keys", {})
        if not isinstance(keys, dict):
            raise StoreError(f"{self.place}: pin/ls", keys, "an object of addresses")
        models = []
        for key in sorted(keys):
            try:
                cid = Cid.parse(key)
            except StoreError:
                continue  # the node's owner keeps other things too
            stat = self._stat(cid)
            if stat is not None and stat.get("Type") == "file" and isinstance(size := stat.get("Size"), int):
                models.append(StoredModel(cid, size))
        return models

    def _stat(self, cid: Cid) -> dict[str, object] | None:
        """What the node knows of a model without its network; None where it lacks the root."""
        query = {"arg": f"/ipfs/{cid}", "with-local": "true", "offline": "true"}
        try:
            with self._ask("files/stat", query) as answer:
                return self._json(answer)
        except _NotFoundError:
            return None

    def _checked(self, cid: Cid, max_bytes: int | None = None) -> Iterator[bytes]:
        """The model as it arrives. It may be used only after the iterator has ended: the hash is known then."""
        importer = Importer()
        most = self._max_bytes if max_bytes is None else min(max_bytes, self._max_bytes)
        with self._ask("cat", {"arg": cid}) as answer:
            while data := answer.read(CHUNK_BYTES):
                importer.update(data)
                if importer.file_bytes > most:
                    raise StoreError(f"{self.place}: {cid}", f"over {most} bytes", "a model that ends before that")
                yield data
        came = importer.finish()
        if came != cid:
            raise StoreError(
                f"{self.place}: {cid}",
                f"{importer.file_bytes} bytes that hash to {came}",
                "the bytes that the address names: they were refused; ask another store",
            )

    @contextmanager
    def _ask(
        self,
        command: str,
        query: Mapping[str, object],
        body: Iterator[bytes] | None = None,
        headers: dict[str, str] | None = None,
    ) -> Iterator[http.client.HTTPResponse]:
        """One RPC command; whatever goes wrong on the way becomes a StoreError that names the store."""
        place = f"{self.place}: {command}"
        target = f"/api/v0/{command}?{urlencode({**query, 'timeout': f'{self._timeout:g}s'})}"
        try:
            with self._http.post(body, target=target, headers=headers, deadline=self._deadline) as answer:
                yield answer
        except HttpError as error:
            if error.status is not None:
                raise _refusal(place, error) from None
            raise StoreError(
                place, error.told, f"a Kubo RPC endpoint that answers ({error.expected}; or ask another store)"
            ) from None

    def _json(self, answer: http.client.HTTPResponse) -> dict[str, object]:
        data = answer.read(_MAX_REPLY_BYTES + 1)
        try:
            value = parse_json(data)
        except ValueError:
            value = None
        if not isinstance(value, dict) or len(data) > _MAX_REPLY_BYTES:
            told = data[:60].decode(errors="replace")
            raise StoreError(self.place, told, "JSON as Kubo's RPC sends it (is this its API port?)")
        return value


class _NotFoundError(StoreError):
    """The node says that it does not have a block."""


def _refusal(place: str, refused: HttpError) -> StoreError:
    """What an answer with another status than 200 says."""
    try:
        message = str(parse_json(refused.body)["Message"])
    except (ValueError, KeyError, TypeError):
        return StoreError(place, refused.told, "a Kubo RPC endpoint (is this its API port?)")
    if "not found" in message or "could not find" in message:
        return _NotFoundError(place, message, "a model that this node holds")
    if "deadline exceeded" in message:
        return StoreError(place, message, "a model that this node or its peers hold; ask another store")
    return StoreError(place, message, "an answer: ask another store")
