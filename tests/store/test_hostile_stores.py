"""Stores that hang, lie, truncate, trickle or flood: each is refused, the next is asked, and the reason is told.

The servers here misbehave on purpose over real sockets on loopback; well-behaved ones are real (`LocalStore` here, Kubo
in tests/nodes).
"""

import contextlib
import json
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from skyrelay.core.errors import StoreError, UsageError
from skyrelay.store.cid import CHUNK_BYTES, Cid, cid_of
from skyrelay.store.fallback import FallbackStore, open_store
from skyrelay.store.kubo import KuboStore
from skyrelay.store.local import LocalStore
from skyrelay.store.model_store import StoredModel

MODEL = bytes(range(256)) * 4200  # two chunks
CID = cid_of(MODEL)
Answer = Callable[[socket.socket], None]


@contextlib.contextmanager
def server(answer: Answer) -> Iterator[str]:
    """The address of a server that reads a request and hands the connection to ``answer``."""
    listener = socket.create_server(("127.0.0.1", 0))
    stop = threading.Event()

    def serve(connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            request = b""
            while b"\r\n\r\n" not in request:
                request += connection.recv(65536)
            while b"Transfer-Encoding: chunked" in request and not request.endswith(b"\r\n0\r\n\r\n"):
                request += connection.recv(65536)
            answer(connection)
            while not stop.is_set() and answer in (silence, headers_only):
                stop.wait(0.05)

    def accept() -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listener.accept()
                threading.Thread(target=serve, args=(connection,), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        stop.set()
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()


def sends(body: bytes, length: int | None = None, status: str = "200 OK") -> Answer:
    head = f"HTTP/1.1 {status}\r\nContent-Length: {len(body) if length is None else length}\r\n\r\n".encode()
    return lambda connection: connection.sendall(head + body)


def silence(connection: socket.socket) -> None:
    """Nothing at all."""


def headers_only(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1075200\r\n\r\n")


def breaks_off_in_chunks(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + b"400\r\n" + MODEL[:1000])


def floods(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
    while True:
        connection.sendall(bytes(65536))


def trickles(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
    for _ in range(1000):
        connection.sendall(b"x")
        threading.Event().wait(0.02)


def trickles_headers(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n")
    for _ in range(1000):
        connection.sendall(b"x")
        threading.Event().wait(0.02)


flipped = bytearray(MODEL)
flipped[300_000] ^= 1
error = json.dumps({"Message": "block was not found locally", "Code": 0, "Type": "error"}).encode()

HOSTILE = {
    "flips a bit": (sends(bytes(flipped)), "1075200 bytes that hash to bafy"),
    "sends another model": (sends(b"another"), "7 bytes that hash to bafkrei"),
    "sends nothing": (sends(b""), "0 bytes that hash to bafkrei"),
    "truncates": (sends(MODEL[:-1]), "1075199 bytes that hash to"),
    "truncates and closes": (sends(MODEL[:-1], len(MODEL)), "1075199 bytes that hash to"),
    "breaks off": (breaks_off_in_chunks, "an answer that breaks off"),
    "adds a byte": (sends(MODEL + b"\0"), "1075201 bytes that hash to"),
    "hangs": (silence, "silent for 0.3 s"),
    "hangs after the headers": (headers_only, "silent for 0.3 s"),
    "floods": (floods, "over 1200000 bytes"),
    "trickles": (trickles, "not done after 0.6 s"),
    "trickles headers": (trickles_headers, "not done after 0.6 s"),
    "has no such model": (sends(error, status="500 Internal Server Error"), "block was not found locally"),
    "is another server": (sends(b"<html>", status="404 Not Found"), "HTTP 404"),
    "speaks something else": (lambda connection: connection.sendall(b"SSH-2.0-OpenSSH_9\r\n"), "expected a Kubo RPC"),
    "closes": (lambda connection: connection.close(), "expected a Kubo RPC endpoint that answers"),
}


def impatient(url: str) -> KuboStore:
    return KuboStore(url, timeout=0.3, deadline=0.6, max_bytes=1_200_000)


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_store_is_refused_and_the_next_one_asked(kind, tmp_path):
    answer, told = HOSTILE[kind]
    honest = LocalStore(tmp_path / "honest")
    honest.put(MODEL)
    out = tmp_path / "model.onnx"
    with server(answer) as url:
        with pytest.raises(StoreError) as alone:
            impatient(url).fetch(CID, out)
        assert not list(tmp_path.glob("*model*")), "nothing half-written"
        assert url in str(alone.value)
        assert told in str(alone.value)

        notices: list[StoreError] = []
        both = FallbackStore([impatient(url), honest], notices.append)
        assert both.get(CID) == MODEL
        assert both.fetch(CID, out) == len(MODEL)
        assert out.read_bytes() == MODEL
        assert len(notices) == 2
        assert all(url in str(notice) for notice in notices)


def test_an_honest_answer_is_taken():
    with server(sends(MODEL)) as url:
        store = KuboStore(url, timeout=5)
        assert store.get(CID) == MODEL
        assert store.verify(CID) == len(MODEL)


def test_nobody_listens(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as unused:
        url = f"http://127.0.0.1:{unused.getsockname()[1]}"
    store = FallbackStore([KuboStore(url), LocalStore(tmp_path)], lambda fault: pytest.fail(str(fault)))
    with pytest.raises(StoreError, match=r"refused by all 2 stores.*Connection refused.*not here"):
        store.get(CID)
    with pytest.raises(StoreError, match=r"kept by 1 of 2 stores.*Connection refused"):
        store.put(MODEL)
    assert LocalStore(tmp_path).get(CID) == MODEL, "the other store was asked all the same"


@pytest.mark.parametrize(
    ("reply", "told"),
    [
        (b'{"Name":"model","Hash":"%s","Size":"7"}' % str(cid_of(b"another")).encode(), "expected " + str(CID)),
        (b'{"Name":"model"}', "expected " + str(CID)),
        (b"[]", "expected JSON as Kubo's RPC sends it"),
        (b"\xff\xfe", "expected JSON as Kubo's RPC sends it"),
    ],
)
def test_a_store_that_reports_another_address_for_what_it_was_given_is_refused(reply, told):
    with server(sends(reply)) as url, pytest.raises(StoreError, match=told):
        KuboStore(url, timeout=5).put(MODEL)


@pytest.mark.parametrize("reply", [b'{"Pins":[]}', b'{"Pins":null}', b"{}"])
def test_a_pin_that_was_not_set_is_told(reply):
    with server(sends(reply)) as url, pytest.raises(StoreError, match=f"pin: .*expected .{CID}"):
        KuboStore(url, timeout=5).pin(CID)


@pytest.mark.parametrize(
    "address",
    [
        "ftp://127.0.0.1:5001",
        "http://",
        "http://127.0.0.1:port",
        "http://127.0.0.1:99999",
        "http://[::1",
        "http://127.0.0.1:5001/api/v0",
    ],
)
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(StoreError, match=r"store address: is .*expected http://HOST:PORT"):
        open_store(address)


def test_a_password_in_an_address_is_refused_and_not_repeated():
    with pytest.raises(StoreError) as refused:
        open_store("http://me:hunter2@127.0.0.1:5001")
    assert "hunter2" not in str(refused.value)


def test_the_second_store_serves_what_the_first_lacks_and_pin_brings_it_home(tmp_path):
    near, far = LocalStore(tmp_path / "near"), LocalStore(tmp_path / "far")
    far.put(MODEL)
    notices: list[StoreError] = []
    store = FallbackStore([near, far], notices.append)
    assert store.has(CID)
    assert store.verify(CID) == len(MODEL)
    store.pin(CID)
    assert near.get(CID) == MODEL
    assert ["not here" in str(notice) for notice in notices] == [True, True]
    store.pin(CID)
    assert len(notices) == 2, "the first store has it now"
    assert store.models() == [StoredModel(CID, len(MODEL))]
    assert not store.has(Cid.of_block(0x55, b"absent"))


def test_no_store_at_all_is_refused():
    with pytest.raises(UsageError, match="at least one model store"):
        FallbackStore([], lambda fault: pytest.fail(str(fault)))


def test_an_address_without_a_scheme_is_a_folder(tmp_path: Path):
    store = open_store(str(tmp_path / "models"))
    assert isinstance(store, LocalStore)
    assert store.put(MODEL[:CHUNK_BYTES]) == cid_of(MODEL[:CHUNK_BYTES])
