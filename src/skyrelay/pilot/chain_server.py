"""A signed chain over HTTP, for many processes."""

from __future__ import annotations

import json
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import socket
from types import TracebackType
from typing import Any

from skyrelay.core.errors import ChainError, UsageError
from skyrelay.core.untrusted import parse_json
from skyrelay.pilot.access import Access
from skyrelay.pilot.signed_chain import INVALID, PARSE, SERVER, RpcError, SignedChain

LARGEST_BODY = 8 * 1024 * 1024
"""Bytes of a request."""
LARGEST_BATCH = 1000
"""Calls in a request."""
DEEPEST = 16
"""Levels of lists and objects within each other in a request."""
CONNECTIONS = 256
"""Open at once; one more is closed unanswered."""
IDLE_SECONDS = 60.0
"""Without a whole request for so long, a connection is closed."""


class ChainServer:
    """Serves a chain over HTTP; `serve` blocks until `stop`.

    Args:
        listen: ``HOST:PORT``; port 0 takes any.
        token: that every request must carry, as a bearer or as the password of basic authentication; None for none,
            which only loopback allows.
    Raises:
        UsageError: the address is none or is taken, or is not loopback and there is no token.
    """

    def __init__(self, chain: SignedChain, listen: str, token: str | None = None) -> None:
        self.access = Access(listen, token, "--listen")
        self._chain = chain
        self._failure: ChainError | None = None
        try:
            self._http = _Http(self.access.address, self)
        except OSError as error:
            raise UsageError("--listen", listen, f"an address that is free ({error.strerror})") from None

    @property
    def url(self) -> str:
        """Where it answers."""
        host, port = self._http.server_address[:2]
        return f"http://{host!s}:{port}"

    def serve(self) -> None:
        """Answer until `stop`.

        Raises:
            ChainError: the disk is full.
        """
        with self._http:
            self._http.serve_forever(poll_interval=0.1)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Have `serve` return; not from the thread that serves."""
        self._http.shutdown()

    def answer(self, body: bytes) -> bytes:
        """The reply to a request's body."""
        try:
            tree = parse_json(body, size=LARGEST_BODY, depth=DEEPEST)
        except ValueError:
            tree = None
        if tree is None:
            return _encode(_reply(None, RpcError(PARSE, f"the body is no JSON of {DEEPEST} levels at most")))
        batch = tree if isinstance(tree, list) else [tree]
        if not batch or len(batch) > LARGEST_BATCH:
            return _encode(_reply(None, RpcError(INVALID, f"a batch of {len(batch)}: expected 1 to {LARGEST_BATCH}")))
        valid = [_is_request(item) for item in batch]
        calls = [(item["method"], item.get("params") or []) for item, ok in zip(batch, valid, strict=True) if ok]
        try:
            results = iter(self._chain.answer_all(calls))
        except ChainError as error:
            self._failure = error
            threading.Thread(target=self.stop).start()
            results = iter([RpcError(SERVER, "the chain cannot write and stops")] * len(calls))
        replies = [
            _reply(item["id"], next(results)) if ok else _reply(None, RpcError(INVALID, "no JSON-RPC request"))
            for item, ok in zip(batch, valid, strict=True)
        ]
        return _encode(replies if isinstance(tree, list) else replies[0])

    def __enter__(self) -> ChainServer:
        threading.Thread(target=self.serve, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


class _Http(ThreadingHTTPServer):
    """A thread a connection, so many at once and no more."""

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, address: tuple[str, int], server: ChainServer) -> None:
        self.chain_server = server
        self._free = threading.BoundedSemaphore(CONNECTIONS)
        super().__init__(address, _Handler)

    def process_request(self, request: socket | tuple[bytes, socket], client_address: Any) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: socket | tuple[bytes, socket], client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A connection that broke is the client's affair; anything else is ours."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = IDLE_SECONDS
    disable_nagle_algorithm = True
    server: _Http

    def do_POST(self) -> None:
        server = self.server.chain_server
        length = self.headers.get("content-length", "")
        if not server.access.allows(self.headers.get("authorization")):
            self._refuse(HTTPStatus.UNAUTHORIZED, "the server's token is expected")
        elif self.headers.get_content_type() != "application/json":
            # A page in a browser can send other types to this machine without being asked about it.
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "application/json is expected")
        elif not (length.isascii() and length.isdigit()):
            self._refuse(HTTPStatus.LENGTH_REQUIRED, "a content-length is expected")
        elif int(length[:12]) > LARGEST_BODY:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"at most {LARGEST_BODY} bytes are expected")
        else:
            body = self.rfile.read(int(length))
            if len(body) == int(length):
                self._respond(HTTPStatus.OK, server.answer(body))

    def _refuse(self, status: HTTPStatus, message: str) -> None:
        self.close_connection = True  # what else is on the line was not read
        self._respond(status, _encode(_reply(None, RpcError(INVALID, message))))

    def _respond(self, status: HTTPStatus, content: bytes) -> None:
        self.send_response(status)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", str(len(content)))
        if self.close_connection:
            self.send_header("connection", "close")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: what clients send is theirs."""


def _is_request(item: Any) -> bool:
    return (
        isinstance(item, dict)
        and isinstance(item.get("method"), str)
        and isinstance(item.get("params", []), list | None)
        and isinstance(item.get("id"), int | str | None)
        and "id" in item
    )


def _reply(number: Any, result: Any | RpcError) -> dict[str, Any]:
    outcome = {"error": result.tree} if isinstance(result, RpcError) else {"result": result}
    return {"jsonrpc": "2.0", "id": number} | outcome


def _encode(tree: Any) -> bytes:
    return json.dumps(tree, separators=(",", ":")).encode()
