"""The control room's server: one page, and a feed to it over WebSockets. Nothing that a client sends is acted upon.

On loopback it answers whoever asks for it by a loopback name, and pages that it served itself (a page of another site
must not read the fleet through its visitor's browser). Elsewhere it wants a token, which a page gives as the name of a
WebSocket protocol: that way it stands in no URL and in no log.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import http
import ipaddress
import re
from collections import deque
from collections.abc import AsyncIterator
from urllib.parse import parse_qs

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from skyrelay.core.errors import UsageError
from skyrelay.report.page import render_live
from skyrelay.runfolder.feed import LONGEST_MESSAGE, Feed, Header

PROTOCOL = Subprotocol("skyrelay-live-1")
MOST_CLIENTS = 64
KEPT_RECORDS = 5_000
KEPT_BYTES = 64 * 2**20
"""Of the feed's past, for a page that comes later."""
WAITING = 256
"""Messages that a client may be behind before it is let go; its page comes back for what it missed."""
LONGEST_QUESTION = 1024
_TOKEN = re.compile(r"[A-Za-z0-9_-]{16,128}")
_NO_TOKEN, _READ_ONLY, _TOO_SLOW, _FULL = 4001, 1008, 1013, 1013


class ControlRoom:
    """Takes a feed and gives it to every page that is open."""

    def __init__(self, token: str | None = None) -> None:
        if token is not None and not _TOKEN.fullmatch(token):
            raise UsageError("the token", None, "16 to 128 letters, digits, - and _ (its value is not shown)")
        self._token = token
        self._header: str | None = None
        self._session = ""
        self._past: deque[tuple[int, str]] = deque()
        self._kept = 0
        self._clients: set[asyncio.Queue[str | None]] = set()
        self._page = render_live().encode()

    async def follow(self, feed: Feed) -> None:
        """Take the feed to its end.

        Raises:
            RunFolderError: the feed is one of a recorded run and that cannot be told.
        """
        async for message in feed:
            text = message.model_dump_json()
            if len(text) > LONGEST_MESSAGE:
                continue  # no page would take it
            if isinstance(message, Header):
                self._header, self._session = text, message.session
                self._past.clear()
                self._kept = 0
            else:
                self._past.append((message.step, text))
                self._kept += len(text)
                while len(self._past) > KEPT_RECORDS or self._kept > KEPT_BYTES:
                    self._kept -= len(self._past.popleft()[1])
            for client in self._clients:
                if client.full():
                    _end(client)
                else:
                    client.put_nowait(text)

    @contextlib.asynccontextmanager
    async def open(self, host: str, port: int) -> AsyncIterator[Server]:
        """Serve until the block is left.

        Raises:
            UsageError: the address is not loopback and there is no token, or it cannot be had.
        """
        if self._token is None and not _loopback(host):
            raise UsageError("--host", host, "a loopback address such as 127.0.0.1, or a --token-file")
        try:
            server = await serve(
                self._tell, host, port, process_request=self._answer, subprotocols=[PROTOCOL], compression=None,
                max_size=LONGEST_QUESTION, server_header=None, open_timeout=10, close_timeout=2,
            )  # fmt: skip
        except OSError as error:
            reason = error.strerror or str(error)
            raise UsageError("--host, --port", f"{host}:{port}", f"an address that is free ({reason})") from error
        async with server:
            yield server

    def _answer(self, _connection: ServerConnection, request: Request) -> Response | None:
        """The page, or None where a WebSocket may be opened."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or len(origins) > 1:
            return _response(http.HTTPStatus.BAD_REQUEST, b"One Host and at most one Origin.\n")
        host = hosts[0]
        if self._token is None and not _loopback(_name(host)):
            return _response(http.HTTPStatus.FORBIDDEN, b"Ask for it by a loopback name.\n")
        path = request.path.partition("?")[0]
        if path == "/":
            return _response(http.HTTPStatus.OK, self._page, "text/html; charset=utf-8")
        if path != "/feed":
            return _response(http.HTTPStatus.NOT_FOUND, b"There is / and /feed.\n")
        if origins and origins[0] not in (f"http://{host}", f"https://{host}"):
            return _response(http.HTTPStatus.FORBIDDEN, b"Another site's page may not read the fleet.\n")
        return None

    async def _tell(self, connection: ServerConnection) -> None:
        if not self._trusts(connection):
            await connection.close(_NO_TOKEN, "no token, or not the server's")
            return
        if len(self._clients) >= MOST_CLIENTS:
            await connection.close(_FULL, "too many pages are open")
            return
        queue: asyncio.Queue[str | None] = asyncio.Queue(WAITING)
        past = self._missed(connection)
        self._clients.add(queue)  # nothing was awaited since: no record falls between the past and the queue
        listening = asyncio.create_task(self._listen(connection, queue))
        try:
            for text in past:
                await connection.send(text)
            while (text_or_end := await queue.get()) is not None:
                await connection.send(text_or_end)
            await connection.close(_TOO_SLOW, "too far behind")
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(queue)
            listening.cancel()

    async def _listen(self, connection: ServerConnection, queue: asyncio.Queue[str | None]) -> None:
        """A page has nothing to say; who says something, or has gone, is let go."""
        with contextlib.suppress(ConnectionClosed):
            await connection.recv()
            await connection.close(_READ_ONLY, "this feed is read-only")
        _end(queue)

    def _trusts(self, connection: ServerConnection) -> bool:
        if self._token is None:
            return True
        request = connection.request
        offered = request.headers.get_all("Sec-WebSocket-Protocol") if request else []
        names = [name.strip() for line in offered for name in line.split(",")]
        wanted = f"token.{self._token}".encode()
        return any(hmac.compare_digest(name.encode(), wanted) for name in names)

    def _missed(self, connection: ServerConnection) -> list[str]:
        """The header, and of the past what a page does not have."""
        if self._header is None:
            return []
        query = connection.request.path.partition("?")[2] if connection.request else ""
        try:
            asked = parse_qs(query, max_num_fields=4)
        except ValueError:
            asked = {}
        after = -1
        if asked.get("session") == [self._session] and re.fullmatch(r"\d{1,10}", asked.get("after", [""])[0]):
            after = int(asked["after"][0])
        return [self._header, *(text for step, text in self._past if step > after)]


def _end(client: asyncio.Queue[str | None]) -> None:
    """Instead of what waits for a client, the end."""
    while not client.empty():
        client.get_nowait()
    client.put_nowait(None)


def _response(status: http.HTTPStatus, body: bytes, kind: str = "text/plain; charset=utf-8") -> Response:
    headers = Headers(
        {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Connection": "close",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
        }
    )
    return Response(status.value, status.phrase, headers, body)


def _name(host: str) -> str:
    """Of a Host header, what stands before the port."""
    match = re.fullmatch(r"(?:\[([0-9a-fA-F:.]+)\]|([^:\[\]]*))(?::\d*)?", host)
    return (match[1] or match[2]) if match else ""


def _loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
