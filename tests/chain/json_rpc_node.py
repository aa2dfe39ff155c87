"""A node of one process: the embedded chain behind JSON-RPC, which can misbehave on request."""

from __future__ import annotations

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

import rlp
from eth_account import Account
from eth_hash.auto import keccak

from skyrelay.chain.chain import Call, Receipt
from skyrelay.chain.embedded.chain import EmbeddedChain


class Node:
    """Takes signed transactions, mines when asked for a receipt.

    Attributes:
        lost_answers: how many of the next batches of transactions are taken, but answered by a closed connection.
        blind: how many of the next receipts are "not found" though they are there.
        gone_until: no connection is answered before this moment.
        forget_pool: the pool is emptied once, as by a restart.
        full_pool: how many of the next transactions are turned away.
        blocks_by_themselves: a new block whenever somebody asks for the head.
        seen: raw transactions as they came, again and again.
    """

    def __init__(self) -> None:
        self.chain = EmbeddedChain(gas_limit=100_000_000)
        self.pool: dict[str, dict[str, Any]] = {}
        self.receipts: dict[str, Receipt] = {}
        self.seen: list[str] = []
        self.lost_answers = 0
        self.blind = 0
        self.gone_until = 0.0
        self.forget_pool = False
        self.full_pool = 0
        self.blocks_by_themselves = False
        node = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["content-length"])))
                lose = node.lost_answers > 0 and any(r["method"] == "eth_sendRawTransaction" for r in body)
                if time.monotonic() < node.gone_until:
                    self.close_connection = True
                    return
                answer = json.dumps([node.answer(request) for request in body]).encode()
                if lose:
                    node.lost_answers -= 1
                    self.close_connection = True
                    return
                self.send_response(200)
                self.send_header("content-length", str(len(answer)))
                self.end_headers()
                self.wfile.write(answer)

            def log_message(self, *args: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        self._lock = threading.Lock()

    def __enter__(self) -> Node:
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.server.shutdown()
        self.server.server_close()

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            try:
                result = getattr(self, "_" + request["method"])(*request["params"])
            except RpcError as error:
                return {"id": request["id"], "error": error.tree}
            return {"id": request["id"], "result": result}

    def _eth_chainId(self) -> str:  # noqa: N802
        return hex(self.chain.chain_id)

    def _eth_blockNumber(self) -> str:  # noqa: N802
        if self.blocks_by_themselves:
            self.chain.send([Call(self.chain.account("anyone"), None, b"")])
        return hex(self.chain.block_number)

    def _eth_getBlockByNumber(self, number: str, full: bool) -> dict[str, Any]:  # noqa: N802
        n = self.chain.block_number if number == "latest" else int(number, 16)
        block = self.chain.blocks[n - 1] if n else None
        return {
            "number": hex(n),
            "gasLimit": hex(self.chain.block_gas_limit),
            "extraData": "0x" + "ab" * 97,  # as a proof-of-authority chain's, longer than the 32 bytes of Ethereum
            "hash": block.hash if block else "0x00",
            "parentHash": block.parent if block else "0x00",
        }

    def _eth_getTransactionCount(self, address: str, tag: str) -> str:  # noqa: N802
        count = self.chain._state.nonces.get(int(address, 16), 0)
        return hex(count + sum(t["sender"] == address for t in self.pool.values()))

    def _eth_sendRawTransaction(self, raw: str) -> str:  # noqa: N802
        data = bytes.fromhex(raw[2:])
        digest = "0x" + keccak(data).hex()
        known = raw in self.seen
        self.seen.append(raw)
        if self.full_pool:
            self.full_pool -= 1
            raise RpcError({"code": -32000, "message": "txpool is full"})
        sender = Account.recover_transaction(raw).lower()
        nonce, price, gas, to, _, payload, *_ = rlp.decode(data)
        assert price == b""
        if known and digest in self.pool:
            raise RpcError({"code": -32000, "message": "already known"})
        number = int.from_bytes(nonce, "big")
        if number < self.chain._state.nonces.get(int(sender, 16), 0):
            raise RpcError({"code": -32000, "message": "nonce too low"})
        self.pool[digest] = {
            "sender": sender,
            "nonce": number,
            "call": Call(sender, "0x" + to.hex() if to else None, payload, int.from_bytes(gas, "big")),
        }
        return digest

    def _eth_getTransactionReceipt(self, digest: str) -> dict[str, Any] | None:  # noqa: N802
        if self.forget_pool:
            self.forget_pool = False
            self.pool.clear()
        self._mine()
        receipt = self.receipts.get(digest)
        if receipt is None:
            return None
        if self.blind:
            self.blind -= 1
            raise RpcError({"code": -32000, "message": "transaction indexing is in progress"})
        block = self.chain.blocks[receipt.block - 1]
        return {
            "transactionHash": digest,
            "blockNumber": hex(receipt.block),
            "blockHash": block.hash,
            "transactionIndex": hex(receipt.transaction),
            "status": hex(receipt.status),
            "gasUsed": hex(receipt.gas_used),
            "contractAddress": receipt.created,
            "logs": [self._log(entry) for entry in receipt.logs],
        }

    def _mine(self) -> None:
        """What is next by each sender's nonce, in the order of arrival."""
        ready, counts = [], {}
        for digest, t in self.pool.items():
            sender = t["sender"]
            expected = counts.get(sender, self.chain._state.nonces.get(int(sender, 16), 0))
            if t["nonce"] == expected:
                ready.append(digest)
                counts[sender] = expected + 1
        if ready:
            receipts = self.chain.send([self.pool.pop(digest)["call"] for digest in ready])
            self.receipts.update(zip(ready, receipts, strict=True))

    def _eth_call(self, message: dict[str, str], tag: str) -> str:
        call = Call(message["from"], message.get("to"), bytes.fromhex(message["data"][2:]))
        (answer,) = self.chain.query([call])
        if not answer.status:
            raise RpcError({"code": 3, "message": "execution reverted", "data": "0x" + answer.output.hex()})
        return "0x" + answer.output.hex()

    def _eth_getCode(self, address: str, tag: str) -> str:  # noqa: N802
        return "0x" + self.chain.code(address).hex()

    def _eth_getLogs(self, query: dict[str, str]) -> list[dict[str, Any]]:  # noqa: N802
        first, last = int(query["fromBlock"], 16), int(query["toBlock"], 16)
        return [self._log(entry) for entry in self.chain.logs(query["address"], first, last)]

    def _eth_getTransactionByBlockNumberAndIndex(self, block: str, index: str) -> dict[str, Any]:  # noqa: N802
        transaction = self.chain.blocks[int(block, 16) - 1].transactions[int(index, 16)]
        return {
            "from": transaction.sender,
            "to": transaction.to,
            "nonce": hex(transaction.nonce),
            "input": "0x" + transaction.data.hex(),
        }

    def _log(self, entry: Any) -> dict[str, Any]:
        return {
            "address": entry.address,
            "topics": ["0x" + topic.hex() for topic in entry.topics],
            "data": "0x" + entry.data.hex(),
            "blockNumber": hex(entry.block),
            "transactionIndex": hex(entry.transaction),
            "logIndex": hex(entry.index),
        }


class RpcError(Exception):
    def __init__(self, tree: dict[str, Any]) -> None:
        self.tree = tree
