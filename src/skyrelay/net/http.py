"""One HTTP client for chain nodes and model stores.

Nothing at the other end is trusted: silence, trickling, endless answers and redirects end in an error. An address may
carry a name and password or a token; neither reaches a message. Plain HTTP goes to this machine alone, unless
`PLAIN_HTTP` says otherwise: anyone on the way could read and change what is sent.
"""

from __future__ import annotations

import base64
import http.client
import ipaddress
import os
import socket
import ssl
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from urllib.parse import SplitResult, unquote, urlsplit

PLAIN_HTTP = "SKYRELAY_PLAIN_HTTP"
"""Environment variable: hosts, separated by commas, that may be spoken to without encryption; ``*`` for any."""


class HttpError(Exception):
    """A request that did not end in an answer of status 200.

    Attributes:
        told: what happened, in a few words, without credentials.
        expected: advice.
        status: of the answer; None where there was none.
        body: the first bytes of such an answer.
        too_long: the answer is longer than the caller takes.
    """

    def __init__(
        self, told: str, expected: str, status: int | None = None, body: bytes = b"", *, too_long: bool = False
    ) -> None:
        super().__init__(f"{told}: {expected}")
        self.told = told
        self.expected = expected
        self.status = status
        self.body = body
        self.too_long = too_long


def public_address(url: str) -> str:
    """An address as messages and files may show it: scheme, host and port; what may be a secret is dots."""
    try:
        parts = urlsplit(url.strip())
        host, port = parts.hostname, parts.port
    except ValueError:
        return "an address that cannot be read"
    if not host or not parts.scheme:
        return "an address without a host"
    shown = f"{parts.scheme}://{f'[{host}]' if ':' in host else host}" + (f":{port}" if port is not None else "")
    return shown + ("/..." if parts.path.strip("/") or parts.query else "")


class Http:
    """POST requests to one address.

    Args:
        url: ``http://`` or ``https://``, a host, perhaps a port, a path, a name and password.
        timeout: longest silence [s].
        keep_alive: use a connection again; then a request must be one that may be sent twice.
    Raises:
        HttpError: it is no such address, or it is plain HTTP to another machine.
    """

    def __init__(self, url: str, *, timeout: float = 20.0, keep_alive: bool = False) -> None:
        parts, port = _split(url)
        self.name = public_address(url)
        assert parts.hostname is not None  # noqa: S101  (`_split` has looked)
        if parts.scheme == "http":
            _allow_plain(parts.hostname)
        self._secure = parts.scheme == "https"
        self._host, self._port = parts.hostname, port
        self._target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        self.has_credentials = bool(parts.username or parts.password)
        self._headers = {}
        if self.has_credentials:
            pair = f"{unquote(parts.username or '')}:{unquote(parts.password or '')}"
            self._headers["Authorization"] = "Basic " + base64.b64encode(pair.encode()).decode("ascii")
        self._timeout = timeout
        self._keep_alive = keep_alive
        self._idle: list[http.client.HTTPConnection] = []

    def read(self, body: bytes, *, most: int, deadline: float, content_type: str = "application/json") -> bytes:
        """The whole answer to a request.

        Args:
            most: longest answer [bytes].
            deadline: longest time for all of it [s].
        Raises:
            HttpError: no answer of status 200, or a longer one.
        """
        with self.post(body, headers={"Content-Type": content_type}, deadline=deadline) as answer:
            data = answer.read(most + 1)
            if len(data) > most:
                raise HttpError(f"over {most} bytes", "an answer that ends before that", too_long=True)
            return data

    def close(self) -> None:
        """Let go of connections that are kept open."""
        while self._idle:
            self._idle.pop().close()

    @contextmanager
    def post(
        self,
        body: bytes | Iterable[bytes] | None = None,
        *,
        target: str | None = None,
        headers: Mapping[str, str] | None = None,
        deadline: float = 300.0,
    ) -> Iterator[http.client.HTTPResponse]:
        """An answer of status 200, to be read before the context ends.

        Args:
            target: path and query in place of the address's own.
        Raises:
            HttpError: whatever goes wrong, also while it is read.
        """
        watch = _Watch(deadline)
        connection = None
        try:
            connection, answer = self._answer(watch, body, target or self._target, {**self._headers, **(headers or {})})
            if answer.status != http.client.OK:
                raise _refusal(answer)
            yield answer
            if watch.late:  # to a body without a length, being cut off looks like an end
                raise TimeoutError
            if self._keep_alive and answer.isclosed() and not answer.will_close:
                self._idle.append(connection)
                connection = None
        except (http.client.HTTPException, OSError, ValueError, HttpError) as error:
            if watch.late:
                raise HttpError(f"not done after {deadline:g} s", "an end") from None
            if isinstance(error, HttpError):
                raise
            raise self._fault(error) from None
        finally:
            watch.end()
            if connection is not None:
                connection.close()

    def _answer(
        self, watch: _Watch, body: bytes | Iterable[bytes] | None, target: str, headers: dict[str, str]
    ) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
        """Ask on a connection that is open, and where the other end has closed that one, on a new one."""
        chunked = body is not None and not isinstance(body, bytes)
        while self._idle:
            connection = self._idle.pop()
            watch.start(connection.sock)
            try:
                connection.request("POST", target, body=body, headers=headers, encode_chunked=chunked)
                return connection, connection.getresponse()
            except (ConnectionError, http.client.BadStatusLine):
                connection.close()
        if self._secure:
            connection = http.client.HTTPSConnection(
                self._host, self._port, timeout=self._timeout, context=ssl.create_default_context()
            )
        else:
            connection = http.client.HTTPConnection(self._host, self._port, timeout=self._timeout)
        try:
            connection.connect()
            watch.start(connection.sock)
            connection.request("POST", target, body=body, headers=headers, encode_chunked=chunked)
            return connection, connection.getresponse()
        except BaseException:
            connection.close()
            raise

    def _fault(self, error: Exception) -> HttpError:
        if isinstance(error, TimeoutError):
            return HttpError(f"silent for {self._timeout:g} s", "an answer")
        if isinstance(error, http.client.IncompleteRead):
            return HttpError("an answer that breaks off", "a whole one")
        if isinstance(error, ssl.SSLError):
            return HttpError(f"no encryption ({error.reason or type(error).__name__})", "a certificate that holds")
        if isinstance(error, OSError):
            return HttpError(error.strerror or type(error).__name__, "a server that listens there")
        return HttpError(f"no HTTP ({type(error).__name__})", "an answer in HTTP")


class _Watch:
    """Shuts a socket down when its time is over: a read that trickles never runs into the timeout of a silence."""

    def __init__(self, seconds: float) -> None:
        self.late = False
        self._wire: socket.socket | None = None
        self._timer = threading.Timer(seconds, self._cut)
        self._timer.daemon = True
        self._timer.start()

    def start(self, wire: socket.socket | None) -> None:
        """Watch this socket from now on."""
        self._wire = wire
        if self.late:
            self._cut()

    def end(self) -> None:
        """Watch no longer."""
        self._timer.cancel()

    def _cut(self) -> None:
        self.late = True
        if self._wire is not None:
            with suppress(OSError):  # it has just ended by itself
                self._wire.shutdown(socket.SHUT_RDWR)


def _split(url: str) -> tuple[SplitResult, int | None]:
    try:
        parts = urlsplit(url)
        port = parts.port
        good = parts.scheme in ("http", "https") and bool(parts.hostname) and url.isascii() and url.isprintable()
    except ValueError:
        good = False
    if not good or " " in url:
        raise HttpError(public_address(url), "http:// or https:// and a host, as http://127.0.0.1:8545")
    return parts, port


def _allow_plain(host: str) -> None:
    """Let plain HTTP pass to this machine, and to hosts that the operator named."""
    try:
        local = ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = host.rstrip(".").lower() == "localhost"
    allowed = [name.strip().lower() for name in os.environ.get(PLAIN_HTTP, "").split(",")]
    if not local and "*" not in allowed and host.lower() not in allowed:
        raise HttpError(
            f"http://{host}", f"https:// to another machine ({PLAIN_HTTP}={host} where the way to it is your own)"
        )


_BY_NAME = {
    401: ("401 Unauthorized", "the right name and password or token in the address"),
    403: ("403 Forbidden", "an address and credentials that may ask this"),
    404: ("404 Not Found", "the path of the service in the address"),
    429: ("429 Too Many Requests", "fewer requests, or another endpoint"),
}


def _refusal(answer: http.client.HTTPResponse) -> HttpError:
    """What another status than 200 means."""
    told, expected = _BY_NAME.get(answer.status, (str(answer.status), "status 200"))
    if 300 <= answer.status < 400:
        expected = "the address that it redirects to: redirects are not followed"
    return HttpError(f"HTTP {told}", expected, answer.status, answer.read(4096))
