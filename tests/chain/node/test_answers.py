"""Nodes that answer in their own way: each is understood, or named in one line."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from json_rpc_node import Node

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Call
from skyrelay.chain.node.chain import NodeChain
from skyrelay.core.errors import ChainError

CHAIN = {
    "eth_chainId": "0x539",
    "eth_getBlockByNumber": {"number": "0x0", "gasLimit": "0x1fffffffffff", "hash": "0x00"},
}


@contextmanager
def odd_node(answer: Callable[[Any], Any], status: int = 200) -> Iterator[str]:
    """A node whose answer to a body is what ``answer`` makes of it."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["content-length"])))
            told = answer(body)
            data = told if isinstance(told, bytes) else json.dumps(told).encode()
            self.send_response(status)
            self.send_header("content-length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *args: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()


def connect(*urls: str, **options: Any) -> NodeChain:
    return NodeChain(list(urls), Keyring(b"k" * 32), poll=0.01, **{"patience": 2.0, **options})


def replies(body: Any, result: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    told = [{"id": request["id"], **result(request)} for request in (body if isinstance(body, list) else [body])]
    return told if isinstance(body, list) else told[0]


def known(request: dict[str, Any]) -> dict[str, Any]:
    return {"result": CHAIN.get(request["method"], "0x0")}


def test_an_error_of_null_is_none() -> None:
    with odd_node(lambda body: replies(body, lambda request: known(request) | {"error": None})) as url:
        chain = connect(url)
        assert (chain.chain_id, chain.block_number) == (1337, 0)


def test_an_error_that_is_a_text_is_told() -> None:
    def answer(request: dict[str, Any]) -> dict[str, Any]:
        return {"error": "method off"} if request["method"] == "eth_getCode" else known(request)

    with odd_node(lambda body: replies(body, answer)) as url, pytest.raises(ChainError, match="method off"):
        connect(url).code("0x" + "12" * 20)


@pytest.mark.parametrize("most", [1, 3])
def test_batches_shrink_to_what_a_node_takes(most: int) -> None:
    longest = []

    def answer(body: Any) -> Any:
        if isinstance(body, list) and len(body) > most:
            return {"jsonrpc": "2.0", "id": None, "error": {"code": -32005, "message": f"batch limit {most} exceeded"}}
        longest.append(len(body) if isinstance(body, list) else 1)
        return replies(body, known)

    with odd_node(answer) as url:
        blocks = connect(url).blocks(range(10))
    assert len(blocks) == 10
    assert max(longest) <= most


def test_a_node_that_takes_no_batch_at_all() -> None:
    def answer(body: Any) -> Any:
        if isinstance(body, list):
            return {"jsonrpc": "2.0", "id": None, "error": {"code": -32600, "message": "no batches here"}}
        return replies(body, known)

    with odd_node(answer) as url:
        assert len(connect(url).blocks(range(4))) == 4


def test_a_batch_that_is_refused_whatever_its_size_is_told() -> None:
    refusal = {"jsonrpc": "2.0", "id": None, "error": {"code": -32005, "message": "batch limit 0 exceeded"}}
    with odd_node(lambda _: refusal) as url, pytest.raises(ChainError, match="batch limit 0 exceeded"):
        connect(url)


def test_ranges_of_logs_are_halved() -> None:
    asked = []

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        if request["method"] != "eth_getLogs":
            return known(request)
        query = request["params"][0]
        first, last = int(query["fromBlock"], 16), int(query["toBlock"], 16)
        if last - first >= 100:
            return {"error": {"code": -32005, "message": "query exceeds 100 blocks"}}
        asked.append((first, last))
        return {"result": []}

    with odd_node(lambda body: replies(body, answer)) as url:
        assert connect(url).logs("0x" + "12" * 20, 0, 4_999) == []
    covered = sorted(number for first, last in set(asked) for number in range(first, last + 1))
    assert covered == list(range(5_000))


def test_logs_that_no_range_gets_are_told() -> None:
    def answer(request: dict[str, Any]) -> dict[str, Any]:
        return {"error": {"message": "logs are off"}} if request["method"] == "eth_getLogs" else known(request)

    with odd_node(lambda body: replies(body, answer)) as url, pytest.raises(ChainError, match="logs are off"):
        connect(url).logs("0x" + "12" * 20, 0, 4_999)


def test_a_receipt_of_a_pending_transaction_is_none_yet() -> None:
    with Node() as node:
        told = node._eth_getTransactionReceipt
        pending = 3

        def sometimes(digest: str) -> dict[str, Any] | None:
            nonlocal pending
            receipt = told(digest)
            if receipt is not None and pending:
                pending -= 1
                return receipt | {"blockNumber": None, "blockHash": None, "transactionIndex": None, "status": None}
            return receipt

        node._eth_getTransactionReceipt = sometimes  # type: ignore[method-assign]
        chain = connect(node.url)
        (receipt,) = chain.send([Call(chain.account("a"), None, b"")])
        assert receipt.status
        assert pending == 0


@pytest.mark.parametrize(
    ("status", "told"),
    [(401, "401 Unauthorized"), (403, "403 Forbidden"), (404, "404 Not Found"), (429, "429 Too Many Requests")],
)
def test_a_refusal_is_told_by_name_without_the_credentials(status: int, told: str) -> None:
    with odd_node(lambda _: {}, status) as url, pytest.raises(ChainError, match=told) as refused:
        connect(url.replace("//", "//me:hunter2@") + "/v3/0123456789secret?key=secret")
    assert not any(secret in str(refused.value) for secret in ("hunter2", "secret"))


def test_a_rate_limit_within_an_answer_is_waited_for() -> None:
    refused = 3

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        nonlocal refused
        if refused:
            refused -= 1
            return {"error": {"code": 429, "message": "Too many requests"}}
        return known(request)

    with odd_node(lambda body: replies(body, answer)) as url:
        assert connect(url).chain_id == 1337


HOSTILE: list[Any] = [
    b"[" * 400_000,
    b'[{"id":0,"result":' + b'{"a":' * 400_000,
    b"",
    b"\xff\xfe[]",
    [],
    [None],
    [{"id": {}, "result": 1}],
    [{"result": "0x1"}],
    {"id": 0},
    "text",
    7,
    None,
]


@pytest.mark.parametrize("told", HOSTILE, ids=range(len(HOSTILE)))
def test_an_answer_that_is_none_ends_in_one_line(told: Any) -> None:
    with odd_node(lambda _: told) as url, pytest.raises(ChainError, match="chain url") as refused:
        connect(url, patience=0.1)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("result", [None, 7, [], {}, "", "0xzz", "x", [7], {"blockNumber": 7}, "0x" + "f" * 5_000])
@pytest.mark.parametrize(
    "method", ["eth_blockNumber", "eth_getLogs", "eth_getCode", "eth_getTransactionCount", "eth_call"]
)
def test_a_result_of_another_form_ends_in_one_line(method: str, result: Any) -> None:
    def answer(request: dict[str, Any]) -> dict[str, Any]:
        return {"result": result} if request["method"] == method else known(request)

    with odd_node(lambda body: replies(body, answer)) as url:
        chain = connect(url, patience=0.2)
        member = chain.account("a")
        for use in (
            lambda: chain.block_number,
            lambda: chain.logs(member, 0, 1),
            lambda: chain.code(member),
            lambda: chain.query([Call(member, member, b"")]),
            lambda: chain.send([Call(member, None, b"")]),
        ):
            try:
                use()
            except ChainError as error:
                assert "\n" not in str(error)  # noqa: PT017  (any other exception is the failure)


def test_another_chain_behind_the_next_address_is_refused() -> None:
    with Node() as node, odd_node(lambda body: replies(body, known)) as other:
        chain = connect(node.url, other)
        node.__exit__(None, None, None)
        with pytest.raises(ChainError, match=r"chain id: is 1337; expected 31337: this is another network"):
            chain.block_number  # noqa: B018


def test_another_chain_of_the_same_id_is_refused() -> None:
    def answer(request: dict[str, Any]) -> dict[str, Any]:
        if request["method"] == "eth_getBlockByNumber":
            return {"result": {"number": "0x0", "gasLimit": "0xffffff", "hash": "0x" + "ab" * 32}}
        return {"result": hex(31337)}

    with Node() as node, odd_node(lambda body: replies(body, answer)) as other:
        chain = connect(node.url, other)
        node.gone_until = float("inf")
        with pytest.raises(ChainError, match=r"first block: is .*abab.*this is another network"):
            chain.block_number  # noqa: B018


def test_a_node_that_comes_back_with_another_chain_is_refused() -> None:
    chain_id = 1337

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        return {"result": hex(chain_id)} if request["method"] == "eth_chainId" else known(request)

    down = False
    with odd_node(lambda body: b"" if down else replies(body, answer)) as url:
        chain = connect(url, patience=0.5)
        down = True
        with pytest.raises(ChainError, match="chain url"):
            chain.block_number  # noqa: B018
        down, chain_id = False, 7
        with pytest.raises(ChainError, match=r"chain id: is 7; expected 1337"):
            chain.block_number  # noqa: B018


def test_the_chain_can_be_pinned_by_id_and_first_block() -> None:
    with Node() as node:
        assert connect(node.url, chain_id=31337, genesis="0x00").chain_id == 31337
        with pytest.raises(ChainError, match="chain id: is 31337; expected 1"):
            connect(node.url, chain_id=1)
        with pytest.raises(ChainError, match="first block"):
            connect(node.url, genesis="0x" + "12" * 32)
