"""JSON-RPC over HTTP to the nodes of one chain: in batches, over several endpoints, whatever forms answers take."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import Any

from skyrelay.core.errors import ChainError
from skyrelay.core.untrusted import parse_json
from skyrelay.net.http import Http, HttpError

BATCH = 100
"""Requests in one HTTP call; fewer where a node says so."""
MAX_REPLY_BYTES = 64 << 20
"""Of one answer; a batch whose answer is longer is asked in halves."""
REQUEST_SECONDS = 60.0
"""What one HTTP call may take, from the first byte sent to the last received."""

Request = tuple[str, list[Any]]
Vouch = Callable[[str, Callable[[str, list[Any]], Any]], None]
Reply = dict[str, Any]
"""``result``, or ``error`` with at least a ``message``."""

_RATE_LIMITS = ("rate limit", "rate-limit", "too many requests", "request limit", "capacity exceeded")
_FOR_GOOD = (301, 302, 303, 307, 308, 401, 403, 404, 405)
"""HTTP statuses that no waiting mends."""


class _Endpoint:
    """One address of a node.

    Attributes:
        known: it has shown that it is of the chain that is asked for.
        fault: why it will not answer however long one waits; None where it may.
        single: it takes one request at a time, as an object.
    """

    def __init__(self, url: str) -> None:
        try:
            self._http = Http(url, timeout=30.0, keep_alive=True)
        except HttpError as error:
            raise ChainError("chain url", error.told, error.expected) from None
        self.name = self._http.name
        self.known = False
        self.fault: str | None = None
        self.single = False

    def ask(self, requests: Sequence[Request]) -> list[Reply]:
        """Replies in order.

        Raises:
            HttpError: there is no answer of status 200.
            _BatchRefusedError: the node answers the whole batch by one error.
            ValueError: it answers something else than JSON-RPC.
        """
        body: Any = [
            {"jsonrpc": "2.0", "id": number, "method": method, "params": parameters}
            for number, (method, parameters) in enumerate(requests)
        ]
        if self.single and len(requests) == 1:
            body = body[0]
        data = self._http.read(json.dumps(body).encode(), most=MAX_REPLY_BYTES, deadline=REQUEST_SECONDS)
        told = parse_json(data, size=MAX_REPLY_BYTES)
        if isinstance(told, dict):
            if len(requests) == 1 and ("result" in told or self.single):
                return [_normal(told)]
            raise _BatchRefusedError(str(_normal(told)["error"]["message"]) if told.get("error") else "one object")
        if not isinstance(told, list):
            raise ValueError(f"a {type(told).__name__} where replies belong")  # noqa: TRY004
        replies = {}
        for reply in told:
            if not isinstance(reply, dict) or not isinstance(reply.get("id"), int | str):
                raise ValueError("a reply without an id")  # noqa: TRY004
            replies[str(reply["id"])] = _normal(reply)
        if len(requests) != len(replies):
            raise ValueError(f"{len(replies)} replies to {len(requests)} requests")
        try:
            return [replies[str(number)] for number in range(len(requests))]
        except KeyError:
            raise ValueError("replies to something else") from None


class _BatchRefusedError(Exception):
    """One error, or one object, in place of a list of replies."""


class Endpoints:
    """The nodes of one chain, asked in turn: the next one serves when one does not.

    Each has to show the chain's id and first block before it is believed, and again after it was out of reach.

    Args:
        urls: at least one.
        chain_id: what the id must be; None: the first node's.
        genesis: what the hash of block 0 must be; None: the first node's.
        vouch: looks at whatever else a node must show; given its name and what asks it.
    Raises:
        ChainError: an address is none.
    """

    def __init__(
        self, urls: Sequence[str], chain_id: int | None, genesis: str | None, vouch: Vouch | None = None
    ) -> None:
        if not urls:
            raise ChainError("chain url", None, "http:// or https:// and a node's address")
        self._endpoints = [_Endpoint(url) for url in urls]
        self._batch = BATCH
        self._vouch = vouch
        self._identity: tuple[int | None, str | None] = (chain_id, genesis)

    @property
    def name(self) -> str:
        """The address that answers now, without credentials."""
        return self._endpoints[0].name

    def ask(self, requests: Sequence[Request], patience: float) -> list[Reply]:
        """Replies in order.

        Every request may be repeated safely: a transaction is the same bytes each time.

        Args:
            patience: how long no node may answer [s].
        Raises:
            ChainError: none did, or one is of another chain.
        """
        replies: list[Reply] = []
        while len(replies) < len(requests):
            rest = requests[len(replies) :]
            replies += self._some(rest[: self._batch], patience)
        return replies

    def _some(self, part: Sequence[Request], patience: float) -> list[Reply]:
        """Replies to these, or to the first of them."""
        deadline = time.monotonic() + patience
        pause = 0.1
        while True:
            endpoint = self._endpoints[0]
            try:
                self._introduce(endpoint)
                replies = endpoint.ask(part)
            except _BatchRefusedError as refused:
                if len(part) == 1 and endpoint.single:
                    reason = str(refused)
                else:
                    endpoint.single = len(part) == 1
                    part = part[: max(len(part) // 2, 1)]
                    self._batch = max(len(part), 1)
                    continue
            except HttpError as error:
                reason = f"{error.told}; {error.expected}"
                if (error.too_long or error.status == 413) and len(part) > 1:
                    part = part[: len(part) // 2]
                    continue
                if error.status in _FOR_GOOD:
                    endpoint.fault = reason
                endpoint.known = False
            except ValueError as error:
                reason = f"no JSON-RPC: {error}"
                endpoint.known = False
            else:
                endpoint.fault = None
                if time.monotonic() + pause > deadline or not any(map(_rate_limited, replies)):
                    return replies
                reason = "rate limited"
            if time.monotonic() + pause > deadline or all(one.fault for one in self._endpoints):
                names = ", ".join(one.name for one in self._endpoints)
                expected = f"a node that answers JSON-RPC within {patience:g} s ({endpoint.name}: {reason})"
                raise ChainError("chain url", names, expected)
            time.sleep(pause)
            pause = min(2 * pause, 2.0)
            self._endpoints.append(self._endpoints.pop(0))

    def _introduce(self, endpoint: _Endpoint) -> None:
        """Have an endpoint show which chain it is of."""
        if endpoint.known:
            return
        first_block: Request = ("eth_getBlockByNumber", ["0x0", False])
        chain_id, block = [endpoint.ask([request])[0] for request in (("eth_chainId", []), first_block)]
        if _rate_limited(chain_id) or _rate_limited(block):
            raise ValueError("rate limited")
        if "error" in chain_id:
            raise ValueError(str(chain_id["error"]["message"]))
        try:
            number = int(chain_id["result"], 16)
        except (TypeError, ValueError):
            raise ValueError("no chain id") from None
        told = block.get("result")
        genesis = str(told.get("hash")) if isinstance(told, dict) else None
        expected_id, expected_genesis = self._identity
        if expected_id not in (None, number):
            raise ChainError(f"{endpoint.name}: chain id", number, f"{expected_id}: this is another network")
        if expected_genesis not in (None, genesis):
            raise ChainError(f"{endpoint.name}: first block", genesis, f"{expected_genesis}: this is another network")
        if self._vouch is not None:

            def ask(method: str, parameters: list[Any]) -> Any:
                return endpoint.ask([(method, parameters)])[0].get("result")

            self._vouch(endpoint.name, ask)
        self._identity = (number, genesis)
        endpoint.known = True


def _normal(reply: dict[str, Any]) -> Reply:
    """A reply with a result, or with an error that is an object with a message."""
    error = reply.get("error")
    if error is None:
        return {"result": reply.get("result")}
    if not isinstance(error, dict):
        error = {"message": str(error)}
    return {"error": {**error, "message": str(error.get("message", error))}}


def _rate_limited(reply: Reply) -> bool:
    error = reply.get("error")
    if error is None:
        return False
    message = error["message"].lower()
    return error.get("code") == 429 or any(words in message for words in _RATE_LIMITS)
