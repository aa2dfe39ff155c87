"""What the HTTP client does with servers of every kind, and what it tells of an address."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from skyrelay.net.http import PLAIN_HTTP, Http, HttpError, public_address

Behaviour = Callable[[socket.socket], None]


def whole_request(connection: socket.socket) -> None:
    """Read a request whose body is ``{}``, or as much of it as comes."""
    data = more = connection.recv(65536)
    while more and not data.endswith(b"{}"):
        more = connection.recv(65536)
        data += more


@contextmanager
def server(behave: Behaviour) -> Iterator[str]:
    """A server that does this to each connection after it has read something."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            with connection:
                whole_request(connection)
                try:
                    behave(connection)
                except OSError:
                    continue

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join(5)


def says(head: bytes, body: bytes = b"") -> Behaviour:
    return lambda connection: connection.sendall(head + b"\r\n\r\n" + body)


def trickles(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
    waiting = threading.Event()
    while not waiting.wait(0.02):
        connection.sendall(b"x")


def trickles_headers(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n")
    waiting = threading.Event()
    while not waiting.wait(0.02):
        connection.sendall(b"X: y\r\n")


@pytest.mark.parametrize(
    ("behaviour", "told"),
    [
        (says(b"HTTP/1.1 200 OK\r\ncontent-length: 2000", b"x" * 2000), "over 1000 bytes"),
        (says(b"HTTP/1.1 200 OK", b"x" * 2000), "over 1000 bytes"),
        (trickles, "not done after 0.3 s"),
        (trickles_headers, "not done after 0.3 s|no HTTP"),
        (says(b"HTTP/1.1 401 No\r\ncontent-length: 0"), "401 Unauthorized"),
        (says(b"HTTP/1.1 429 No\r\ncontent-length: 0"), "429 Too Many Requests"),
        (says(b"HTTP/1.1 307 No\r\ncontent-length: 0\r\nlocation: http://example.org"), "redirects are not followed"),
        (says(b"SSH-2.0"), "no HTTP"),
        (lambda connection: connection.close(), "RemoteDisconnected|Connection reset"),
    ],
)
def test_an_answer_that_is_none(behaviour: Behaviour, told: str) -> None:
    with server(behaviour) as url, pytest.raises(HttpError, match=told):
        Http(url.replace("//", "//me:secret@"), timeout=5).read(b"{}", most=1000, deadline=0.3)


def test_nobody_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(HttpError, match="Connection refused"):
        Http(f"http://127.0.0.1:{port}").read(b"", most=10, deadline=5)


def test_a_connection_is_used_again_and_one_that_has_gone_is_not_missed() -> None:
    connections = []

    def twice_then_gone(connection: socket.socket) -> None:
        connections.append(connection)
        connection.sendall(b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\nok")
        whole_request(connection)
        connection.sendall(b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\nok")

    with server(twice_then_gone) as url:
        client = Http(url, keep_alive=True)
        assert [client.read(b"{}", most=10, deadline=5) for _ in range(5)] == [b"ok"] * 5
        client.close()
    assert len(connections) == 3


def test_credentials_are_sent_and_not_shown() -> None:
    seen = []

    def record(connection: socket.socket) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n")

    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            seen.append(connection.recv(65536))
            record(connection)

    thread = threading.Thread(target=serve)
    thread.start()
    client = Http(f"http://me:p%40ss@127.0.0.1:{listener.getsockname()[1]}/key-1234?token=abc")
    client.read(b"{}", most=10, deadline=5)
    thread.join(5)
    listener.close()
    assert seen[0].startswith(b"POST /key-1234?token=abc HTTP/1.1\r\n")
    assert b"Authorization: Basic bWU6cEBzcw==" in seen[0]
    assert client.name == f"http://127.0.0.1:{client.name.split(':')[2].split('/')[0]}/..."


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("https://me:secret@node.example:8545", "https://node.example:8545"),
        ("https://node.example/v3/0123secret", "https://node.example/..."),
        ("https://node.example/?token=secret", "https://node.example/..."),
        ("wss://me:secret@[::1]:1/", "wss://[::1]:1"),
        ("https://me:secret@", "an address without a host"),
        ("https://me:secret@node:port/", "an address that cannot be read"),
        ("me:secret@node", "an address without a host"),
    ],
)
def test_what_is_shown_of_an_address(url: str, shown: str) -> None:
    assert public_address(url) == shown
    if not url.startswith("https://") or "an address" in shown:
        with pytest.raises(HttpError) as refused:
            Http(url)
        assert "secret" not in str(refused.value)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.9.9.9", "[::1]", "localhost", "LOCALHOST"])
def test_plain_http_to_this_machine(host: str) -> None:
    Http(f"http://{host}:8545")


@pytest.mark.parametrize("host", ["10.0.0.1", "node.example", "127.0.0.1.example", "localhost.example", "2130706433"])
def test_plain_http_to_another_machine_is_refused_unless_named(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(PLAIN_HTTP, raising=False)
    with pytest.raises(HttpError, match="https:// to another machine"):
        Http(f"http://{host}:8545")
    Http(f"https://{host}:8545")
    monkeypatch.setenv(PLAIN_HTTP, "other, " + host)
    Http(f"http://{host}:8545")
    monkeypatch.setenv(PLAIN_HTTP, "*")
    Http(f"http://{host}:8545")


@pytest.mark.parametrize(
    "url", ["http://host\r\nX: y", "http://a b/", "ftp://host", "host:8545", "", "http://ho\u0073t\u00e9/"]
)
def test_what_is_no_address(url: str) -> None:
    with pytest.raises(HttpError, match=r"http:// or https://"):
        Http(url)
