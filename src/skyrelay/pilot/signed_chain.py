"""The embedded chain as an Ethereum node's: takes signed transactions, answers JSON-RPC's methods.

What a client has been told is in the pool is on the disk: the signed bytes are appended to a journal before they are
mined, and the journal also says, after a restart, which signed transaction a recorded one was. A block is made at the
end of every request that brought transactions; there is nobody to agree with.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from eth_hash.auto import keccak

from skyrelay.chain.chain import Call, LogEntry, Receipt
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.embedded.ledger import Block
from skyrelay.chain.evm.gas import intrinsic_gas
from skyrelay.chain.signed import SignedTransaction, read_signed
from skyrelay.core.errors import ChainError
from skyrelay.core.untrusted import hex_bytes, hex_number
from skyrelay.pilot.journal import Journal

CALL_GAS = 200_000_000
"""Gas of a question: some seconds of this machine's time, no more."""
POOL = 5000
"""Transactions that may wait for an earlier one of their sender."""
MOST_LOGS = 10_000
"""Logs in an answer."""
FILE_NAME = "signed.txt"

PARSE, INVALID, UNKNOWN, PARAMS, SERVER, REVERT = -32700, -32600, -32601, -32602, -32000, 3
"""JSON-RPC's codes of errors, and the two that Ethereum's nodes use."""
_NOBODY = "0x" + "00" * 20
_TAGS = ("latest", "pending", "safe", "finalized")


class RpcError(Exception):
    """What a client is told instead of a result."""

    def __init__(self, code: int, message: str, data: str | None = None) -> None:
        super().__init__(message)
        self.tree: dict[str, Any] = {"code": code, "message": message} | ({} if data is None else {"data": data})


class SignedChain:
    """The embedded chain as a node's, for signed transactions; all methods of it take turns.

    Args:
        state: folder of the record and the journal; None keeps both in memory.
        chain_id: of a new chain; of an old one it must agree where given.
    Raises:
        ChainError: the record or the journal is damaged, or open in another process.
    """

    def __init__(self, state: Path | None, chain_id: int | None = None) -> None:
        self._lock = threading.RLock()
        self.chain = EmbeddedChain(state, chain_id=chain_id)
        self._pool: dict[str, dict[int, SignedTransaction]] = {}
        self._arrived: list[SignedTransaction] = []
        self._places: dict[str, tuple[int, int]] = {}  # of each mined transaction, by its signed hash
        self._signed: dict[tuple[int, int], SignedTransaction] = {}
        self._waiting = 0
        self._journal: Journal | None = None
        try:
            if state is not None:
                journal = Journal(state / FILE_NAME)
                self._take_up(journal.entries())  # what is mined of it now is in it already
                self._journal = journal
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the record."""
        with self._lock:
            self.chain.close()
            if self._journal is not None:
                self._journal.close()

    def answer_all(self, calls: Sequence[tuple[str, list[Any]]]) -> list[Any | RpcError]:
        """Results in order; what they have brought is mined when this returns.

        Raises:
            ChainError: the disk is full; nothing more can be kept.
        """
        with self._lock:
            answers: list[Any | RpcError] = []
            for place, (method, params) in enumerate(calls):
                sends = method == "eth_sendRawTransaction"
                if not sends or place == 0 or calls[place - 1][0] != method:
                    self._mine()  # what comes after a transaction sees what it did
                try:
                    answers.append(self._answer(method, params))
                except RpcError as error:
                    answers.append(error)
            self._mine()
            return answers

    # Methods

    def _answer(self, method: str, params: list[Any]) -> Any:
        handler = _METHODS.get(method)
        if handler is None:
            raise RpcError(UNKNOWN, f"the method {method[:60]} does not exist here")
        try:
            return handler(self, *params)
        except TypeError as error:
            # Only a wrong number of parameters: every parameter is checked before it is used.
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                raise
            raise RpcError(PARAMS, f"{method}: another number of parameters") from None

    def _chain_id(self) -> str:
        return hex(self.chain.chain_id)

    def _network(self) -> str:
        return str(self.chain.chain_id)

    def _version(self) -> str:
        return f"SkyRelay/{version('skyrelay')}"

    def _head(self) -> str:
        return hex(self.chain.block_number)

    def _count(self, address: Any, tag: Any = "latest") -> str:
        sender = _address(address)
        self._require_latest(tag)
        nonce = self.chain.nonce(sender)
        waiting = self._pool.get(sender, {})
        while tag == "pending" and nonce in waiting:
            nonce += 1
        return hex(nonce)

    def _code(self, address: Any, tag: Any = "latest") -> str:
        self._require_latest(tag)
        return _hex(self.chain.code(_address(address)))

    def _balance(self, address: Any, tag: Any = "latest") -> str:
        _address(address)
        self._require_latest(tag)
        return "0x0"  # there is no coin on this chain

    def _free(self) -> str:
        return "0x0"

    def _call(self, message: Any, tag: Any = "latest") -> str:
        call = self._question(message, tag)
        (answer,) = self.chain.query([call], call.gas)
        if not answer.status:
            raise RpcError(REVERT, "execution reverted", _hex(answer.output))
        return _hex(answer.output)

    def _estimate(self, message: Any, tag: Any = "latest") -> str:
        """The least limit under which the call succeeds, to 1/64 above (what a call leaves to its caller)."""
        call = self._question(message, tag)
        least = intrinsic_gas(call.data, call.to is None)
        high = self.chain.block_gas_limit - least
        (answer,) = self.chain.query([call], high)
        if not answer.status:
            raise RpcError(REVERT, "execution reverted", _hex(answer.output))
        low = -1
        while high - low > max(1, high // 64):
            middle = (low + high) // 2
            (answer,) = self.chain.query([call], middle)
            low, high = (low, middle) if answer.status else (middle, high)
        return hex(least + high)

    def _send(self, raw: Any) -> str:
        try:
            transaction = read_signed(_bytes(raw))
        except ChainError as error:
            raise RpcError(SERVER, str(error)) from None
        sender, nonce, chain = transaction.sender, transaction.nonce, self.chain
        if transaction.chain_id not in (None, chain.chain_id):
            raise RpcError(SERVER, f"invalid chain id: this chain is {chain.chain_id}")
        if transaction.hash in self._places:
            raise RpcError(SERVER, "already known")
        waiting = self._pool.get(sender, {})
        if nonce in waiting:
            same = waiting[nonce].hash == transaction.hash
            raise RpcError(SERVER, "already known" if same else "replacement transaction underpriced")
        if nonce < chain.nonce(sender):
            raise RpcError(SERVER, f"nonce too low: next nonce {chain.nonce(sender)}, tx nonce {nonce}")
        if transaction.value or transaction.price:
            raise RpcError(SERVER, "insufficient funds: value and gas price must be 0, there is no coin on this chain")
        if transaction.gas > chain.block_gas_limit:
            raise RpcError(SERVER, f"exceeds block gas limit {chain.block_gas_limit}")
        if transaction.gas < intrinsic_gas(transaction.data, transaction.to is None):
            raise RpcError(SERVER, "intrinsic gas too low")
        if self._waiting >= POOL:
            self._mine()
        if self._waiting >= POOL:
            raise RpcError(SERVER, "txpool is full")
        self._enqueue(transaction)
        return transaction.hash

    def _receipt(self, digest: Any) -> dict[str, Any] | None:
        place = self._places.get(_hash(digest))
        if place is None:
            return None
        block = self.chain.blocks[place[0] - 1]
        receipt, kind = block.receipts[place[1]], self._kind(place)
        told = {
            "transactionHash": digest.lower(),
            "transactionIndex": hex(receipt.transaction),
            "blockHash": block.hash,
            "blockNumber": hex(receipt.block),
            "from": receipt.sender,
            "to": receipt.to,
            "cumulativeGasUsed": hex(sum(r.gas_used for r in block.receipts[: receipt.transaction + 1])),
            "gasUsed": hex(receipt.gas_used),
            "contractAddress": receipt.created,
            "logs": [self._log(entry, block) for entry in receipt.logs],
            "logsBloom": _bloom([receipt]),
            "type": hex(kind),
            "effectiveGasPrice": "0x0",
            "status": hex(receipt.status),
        }
        return told | ({"revertReason": _hex(receipt.output)} if receipt.output else {})

    def _transaction(self, digest: Any) -> dict[str, Any] | None:
        place = self._places.get(_hash(digest))
        return None if place is None else self._told(place)

    def _transaction_at(self, block: Any, index: Any) -> dict[str, Any] | None:
        place = (self._number(block), _quantity(index))
        there = 0 < place[0] <= self.chain.block_number
        return self._told(place) if there and place[1] < len(self.chain.blocks[place[0] - 1].transactions) else None

    def _block(self, tag: Any, whole: Any = False) -> dict[str, Any] | None:
        return self._header(self._number(tag), bool(whole))

    def _block_by_hash(self, digest: Any, whole: Any = False) -> dict[str, Any] | None:
        wanted = _hash(digest)
        if wanted == self.chain.genesis_hash:
            return self._header(0, False)
        numbers = (block.number for block in reversed(self.chain.blocks) if block.hash == wanted)
        number = next(numbers, None)
        return None if number is None else self._header(number, bool(whole))

    def _logs(self, wanted: Any) -> list[dict[str, Any]]:
        if not isinstance(wanted, dict):
            raise RpcError(PARAMS, "eth_getLogs: a filter object is expected")
        if "blockHash" in wanted:
            block = self._block_by_hash(wanted["blockHash"])
            if block is None:
                raise RpcError(SERVER, "unknown block")
            first = last = int(block["number"], 16)
        else:
            first, last = (self._number(wanted.get(name) or "latest") for name in ("fromBlock", "toBlock"))
        addresses = wanted.get("address")
        among = None if addresses is None else {_address(a) for a in _listed(addresses)}
        topics = [None if t is None else {_bytes(x) for x in _listed(t)} for t in _listed(wanted.get("topics") or [])]
        found: list[dict[str, Any]] = []
        for block_ in self.chain.blocks[max(first, 1) - 1 : last]:
            for receipt in block_.receipts:
                for entry in receipt.logs:
                    if (among is None or entry.address in among) and _matches(entry, topics):
                        if len(found) >= MOST_LOGS:
                            raise RpcError(SERVER, f"more than {MOST_LOGS} logs: ask for fewer blocks")
                        found.append(self._log(entry, block_))
        return found

    # Within

    def _question(self, message: Any, tag: Any) -> Call:
        self._require_latest(tag)
        if not isinstance(message, dict):
            raise RpcError(PARAMS, "a transaction object is expected")
        to, data = message.get("to"), message.get("input") or message.get("data") or "0x"
        gas = CALL_GAS if message.get("gas") is None else min(_quantity(message["gas"]), CALL_GAS)
        sender = _address(message.get("from") or _NOBODY)
        return Call(sender, None if to is None else _address(to), _bytes(data), gas)

    def _require_latest(self, tag: Any) -> None:
        if tag not in _TAGS and self._number(tag) != self.chain.block_number:
            raise RpcError(SERVER, f"the state of block {tag} is not kept, only the latest block's")

    def _number(self, tag: Any) -> int:
        if tag in _TAGS:
            return self.chain.block_number
        return 0 if tag == "earliest" else _quantity(tag)

    def _header(self, number: int, whole: bool) -> dict[str, Any] | None:
        """A block; roots are left out, as this chain has none."""
        if not 0 <= number <= self.chain.block_number:
            return None
        block: Block | None = self.chain.blocks[number - 1] if number else None
        places = [(number, index) for index in range(len(block.transactions))] if block else []
        return {
            "number": hex(number),
            "hash": block.hash if block else self.chain.genesis_hash,
            "parentHash": block.parent if block else "0x" + "00" * 32,
            "timestamp": hex(block.timestamp if block else self.chain.genesis_timestamp),
            "gasLimit": hex(self.chain.block_gas_limit),
            "gasUsed": hex(block.gas_used if block else 0),
            "baseFeePerGas": "0x0",
            "difficulty": "0x0",
            "extraData": "0x",
            "miner": _NOBODY,
            "logsBloom": _bloom(block.receipts if block else ()),
            "transactions": [self._told(place) if whole else self._hash_at(place) for place in places],
            "uncles": [],
        }

    def _hash_at(self, place: tuple[int, int]) -> str:
        """The signed transaction's hash; of one that the chain's owner made in its own process, the record's."""
        signed = self._signed.get(place)
        return signed.hash if signed else self.chain.blocks[place[0] - 1].receipts[place[1]].hash

    def _kind(self, place: tuple[int, int]) -> int:
        signed = self._signed.get(place)
        return signed.raw[0] if signed and signed.raw[0] < 0x80 else 0

    def _told(self, place: tuple[int, int]) -> dict[str, Any]:
        block = self.chain.blocks[place[0] - 1]
        transaction = block.transactions[place[1]]
        return {
            "hash": self._hash_at(place),
            "blockHash": block.hash,
            "blockNumber": hex(block.number),
            "transactionIndex": hex(place[1]),
            "type": hex(self._kind(place)),
            "from": transaction.sender,
            "to": transaction.to,
            "nonce": hex(transaction.nonce),
            "gas": hex(transaction.gas),
            "gasPrice": "0x0",
            "value": "0x0",
            "input": _hex(transaction.data),
        }

    def _log(self, entry: LogEntry, block: Block) -> dict[str, Any]:
        return {
            "address": entry.address,
            "topics": [_hex(topic) for topic in entry.topics],
            "data": _hex(entry.data),
            "blockNumber": hex(entry.block),
            "blockHash": block.hash,
            "transactionHash": self._hash_at((entry.block, entry.transaction)),
            "transactionIndex": hex(entry.transaction),
            "logIndex": hex(entry.index),
            "removed": False,
        }

    # Mining

    def _mine(self) -> None:
        """Journal what has arrived, then mine what is next by each sender's nonce, in the order of arrival."""
        if not self._arrived:
            return
        if self._journal is not None:
            self._journal.append(self._arrived)
        ready: list[SignedTransaction] = []
        taken: Counter[str] = Counter()
        for sender in (transaction.sender for transaction in self._arrived):
            waiting = self._pool.get(sender, {})
            while (nonce := self.chain.nonce(sender) + taken[sender]) in waiting:
                ready.append(waiting.pop(nonce))
                taken[sender] += 1
            if not waiting:
                self._pool.pop(sender, None)
        self._arrived.clear()
        self._waiting -= len(ready)
        if not ready:
            return
        now = max(int(time.time()), self.chain.timestamp)
        receipts = self.chain.send([Call(t.sender, t.to, t.data, t.gas) for t in ready], now)
        for transaction, receipt in zip(ready, receipts, strict=True):
            self._note(transaction, (receipt.block, receipt.transaction))

    def _enqueue(self, transaction: SignedTransaction) -> None:
        self._pool.setdefault(transaction.sender, {})[transaction.nonce] = transaction
        self._arrived.append(transaction)
        self._waiting += 1

    def _note(self, transaction: SignedTransaction, place: tuple[int, int]) -> None:
        self._places[transaction.hash] = place
        self._signed[place] = transaction

    def _take_up(self, journal: Sequence[SignedTransaction]) -> None:
        """Find each signed transaction in the record by sender and nonce; what is not there yet is mined now."""
        mined = {
            (transaction.sender, transaction.nonce): (block.number, index)
            for block in self.chain.blocks
            for index, transaction in enumerate(block.transactions)
        }
        for signed in journal:
            place = mined.get((signed.sender, signed.nonce))
            if place is None:
                self._enqueue(signed)
                continue
            recorded = self.chain.blocks[place[0] - 1].transactions[place[1]]
            if (recorded.to, recorded.gas, recorded.data) == (signed.to, signed.gas, signed.data):
                self._note(signed, place)
        self._mine()


_METHODS: dict[str, Callable[..., Any]] = {
    "eth_blockNumber": SignedChain._head,
    "eth_call": SignedChain._call,
    "eth_chainId": SignedChain._chain_id,
    "eth_estimateGas": SignedChain._estimate,
    "eth_gasPrice": SignedChain._free,
    "eth_getBalance": SignedChain._balance,
    "eth_getBlockByHash": SignedChain._block_by_hash,
    "eth_getBlockByNumber": SignedChain._block,
    "eth_getCode": SignedChain._code,
    "eth_getLogs": SignedChain._logs,
    "eth_getTransactionByBlockNumberAndIndex": SignedChain._transaction_at,
    "eth_getTransactionByHash": SignedChain._transaction,
    "eth_getTransactionCount": SignedChain._count,
    "eth_getTransactionReceipt": SignedChain._receipt,
    "eth_maxPriorityFeePerGas": SignedChain._free,
    "eth_sendRawTransaction": SignedChain._send,
    "net_version": SignedChain._network,
    "web3_clientVersion": SignedChain._version,
}


def _hex(data: bytes) -> str:
    return "0x" + data.hex()


def _bytes(text: Any) -> bytes:
    try:
        return hex_bytes(text)
    except ValueError:
        raise RpcError(PARAMS, "hexadecimal data with 0x before it is expected") from None


def _address(text: Any) -> str:
    if len(_bytes(text)) != 20:
        raise RpcError(PARAMS, "an address of 20 bytes is expected")
    return str(text).lower()


def _hash(text: Any) -> str:
    if len(_bytes(text)) != 32:
        raise RpcError(PARAMS, "a hash of 32 bytes is expected")
    return str(text).lower()


def _quantity(text: Any) -> int:
    try:
        return hex_number(text)
    except ValueError:
        raise RpcError(PARAMS, "a hexadecimal number with 0x before it is expected") from None


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _matches(entry: LogEntry, topics: Sequence[set[bytes] | None]) -> bool:
    return len(topics) <= len(entry.topics) and all(
        wanted is None or topic in wanted for wanted, topic in zip(topics, entry.topics, strict=False)
    )


def _bloom(receipts: Sequence[Receipt]) -> str:
    """The filter of 2,048 bits over the logs' addresses and topics, as the yellow paper has it."""
    bits = 0
    for receipt in receipts:
        for entry in receipt.logs:
            for item in (bytes.fromhex(entry.address[2:]), *entry.topics):
                digest = keccak(item)
                for place in (0, 2, 4):
                    bits |= 1 << int.from_bytes(digest[place : place + 2], "big") % 2048
    return f"0x{bits:0512x}"
