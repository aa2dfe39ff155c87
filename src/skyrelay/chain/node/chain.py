"""A chain behind an Ethereum JSON-RPC endpoint: QBFT, IBFT, Clique networks with free gas.

Plain JSON-RPC in batches: long extra data, which typed clients stumble over on proof-of-authority chains, is never
looked at. Transactions are signed here, once; whatever happens after that, only the same bytes are sent again, so
that a resend can never change the state twice.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Answer, Call, LogEntry, Receipt, SentTransaction
from skyrelay.chain.node.rpc import Endpoints, Reply, Request
from skyrelay.chain.proof.root import TrustRoot
from skyrelay.core.errors import ChainError
from skyrelay.core.untrusted import hex_bytes, hex_number

WINDOW = 1000
"""Transactions under way at once: a node's pool holds some thousands, shared by all who send."""
LOG_BLOCKS = 2000
"""Blocks that one search for logs covers; fewer where a node says so."""


class NodeChain:
    """A chain, by way of its nodes.

    Args:
        urls: endpoints of the same chain; the next one serves when one does not answer. Each has to show the chain's
            id and its first block.
        keyring: of this host's members.
        chain_id: what the chain's id must be; None where any will do.
        genesis: what the hash of its first block must be; None where any will do.
        root: validators and a block that every endpoint has to show before it is believed; None: whoever it is.
        confirmations: blocks on top of a receipt's before it counts: 0 where blocks are final (QBFT, IBFT), on Clique
            half of the signers and one.
        patience: how long nodes may be out of reach, or nothing of ours be mined, before that is an error [s].
        poll: between two looks for receipts [s].
        rebroadcast: without a receipt for so long, a transaction is sent again, byte for byte [s].
    Raises:
        ChainError: no endpoint answers, or the chain is another.
    """

    def __init__(
        self,
        urls: str | Sequence[str],
        keyring: Keyring,
        *,
        chain_id: int | None = None,
        genesis: str | None = None,
        root: TrustRoot | None = None,
        confirmations: int = 0,
        patience: float = 120.0,
        poll: float = 0.25,
        rebroadcast: float = 5.0,
    ) -> None:
        self._nodes = Endpoints(
            [urls] if isinstance(urls, str) else list(urls), chain_id, genesis, root.check if root else None
        )
        self._keyring = keyring
        self._confirmations = confirmations
        self._patience = patience
        self._poll = poll
        self._rebroadcast = rebroadcast
        # The first contact tells at once that an address is wrong; patience is for a node that was there.
        first = self._post(
            [("eth_chainId", []), ("eth_getBlockByNumber", ["latest", False])], patience=min(5.0, patience)
        )
        with _readable("eth_getBlockByNumber"):
            self._chain_id = hex_number(_result(first[0], "eth_chainId"))
            self._block_gas_limit = hex_number(_result(first[1], "eth_getBlockByNumber")["gasLimit"])

    # The Chain protocol

    @property
    def chain_id(self) -> int:
        """The network's number."""
        return self._chain_id

    @property
    def block_number(self) -> int:
        """Number of the latest block that counts: `confirmations` below the head."""
        return max(self._head() - self._confirmations, 0)

    @property
    def block_gas_limit(self) -> int:
        """Gas limit of the latest block when this was connected."""
        return self._block_gas_limit

    def account(self, name: str) -> str:
        """The address of a member of this host."""
        return self._keyring.account(name)

    def vouch(self, member: str, message: bytes) -> bytes:
        """The signature of a member of this host under a message that is no transaction; see `Keyring.vouch`."""
        return self._keyring.vouch(member, message)

    def send(self, calls: Sequence[Call], timestamp: int | None = None) -> list[Receipt]:  # noqa: ARG002
        """Sign, send, and wait until every call is mined and confirmed.

        Calls of one sender are mined in their order; between senders the order is the network's.

        Args:
            timestamp: not heeded: the network has its own clock.
        Raises:
            ChainError: a node refuses a transaction for good; or for longer than ``patience`` no node answers or
                nothing is mined. What was sent may then still be mined: look before sending it anew.
        """
        receipts: list[Receipt] = []
        for start in range(0, len(calls), WINDOW):
            receipts += self._send_window(calls[start : start + WINDOW])
        return receipts

    def query(self, calls: Sequence[Call]) -> list[Answer]:
        """Ask the latest state."""
        requests_ = [("eth_call", [_message(call), "latest"]) for call in calls]
        return [_answer(reply, call.name) for reply, call in zip(self._batch(requests_), calls, strict=True)]

    def logs(self, address: str, from_block: int, to_block: int) -> list[LogEntry]:
        """All logs of a contract in these blocks, both included, in order."""
        ranges = [
            (start, min(start + LOG_BLOCKS - 1, to_block)) for start in range(from_block, to_block + 1, LOG_BLOCKS)
        ]
        found: list[LogEntry] = []
        while ranges:
            replies = self._batch(
                [
                    ("eth_getLogs", [{"address": address, "fromBlock": hex(first), "toBlock": hex(last)}])
                    for first, last in ranges
                ]
            )
            asked, ranges = ranges, []
            for number, ((first, last), reply) in enumerate(zip(asked, replies, strict=True)):
                if "error" in reply and first < last:  # most likely more blocks or more logs than it gives at once
                    middle = (first + last) // 2
                    ranges = [(first, middle), (middle + 1, last), *asked[number + 1 :]]
                    break
                with _readable("eth_getLogs"):
                    found += [_log(entry) for entry in _result(reply, "eth_getLogs")]
        return found

    def code(self, address: str) -> bytes:
        """The code of a contract; empty where there is none."""
        with _readable("eth_getCode"):
            return hex_bytes(self._one("eth_getCode", address, "latest"))

    def transaction(self, block: int, index: int) -> SentTransaction:
        """The transaction at a place of a block, as the node tells it."""
        method = "eth_getTransactionByBlockNumberAndIndex"
        told = self._one(method, hex(block), hex(index))
        with _readable(method):
            to = told["to"]
            return SentTransaction(
                _address(told["from"]),
                hex_number(told["nonce"]),
                None if to is None else _address(to),
                hex_bytes(told["input"]),
            )

    # Beyond it

    def blocks(self, numbers: Sequence[int], *, whole: bool = False) -> list[dict[str, Any]]:
        """Blocks, as the node tells them.

        Args:
            whole: with their transactions, not only the hashes of those.
        Raises:
            ChainError: the node lacks one.
        """
        return self._told("eth_getBlockByNumber", [[hex(number), whole] for number in numbers], "block")

    def receipts(self, hashes: Sequence[str]) -> list[dict[str, Any]]:
        """Receipts of transactions, as the node tells them.

        Raises:
            ChainError: the node lacks one.
        """
        return self._told("eth_getTransactionReceipt", [[digest] for digest in hashes], "receipt of transaction")

    def account_proofs(self, addresses: Sequence[str], block: int) -> list[dict[str, Any]]:
        """What a block's state has at these addresses, each with its proof (EIP-1186), as the node tells it.

        Raises:
            ChainError: the node gives none.
        """
        return self._told("eth_getProof", [[address, [], hex(block)] for address in addresses], "proof of account")

    def _told(self, method: str, parameters: Sequence[list[Any]], what: str) -> list[dict[str, Any]]:
        replies = self._batch([(method, params) for params in parameters])
        found: list[dict[str, Any]] = []
        for params, reply in zip(parameters, replies, strict=True):
            result = _result(reply, method)
            if not isinstance(result, dict):
                raise ChainError(f"{self._nodes.name}: {what}", params[0], "one that the node has")
            found.append(result)
        return found

    # Sending

    def _send_window(self, calls: Sequence[Call]) -> list[Receipt]:
        signed = self._sign(calls)
        found: dict[str, dict[str, Any]] = {}
        unsent = dict(signed)
        progress = (0, 0)
        last_progress = last_broadcast = time.monotonic()
        while True:
            if unsent:
                accepted = self._broadcast(unsent)
                unsent = {digest: raw for digest, raw in unsent.items() if digest not in accepted}
                last_broadcast = time.monotonic()
            found.update(self._receipts([digest for digest in signed if digest not in found]))
            head = self._head() if len(found) == len(signed) and self._confirmations else 0
            if len(found) == len(signed) and self._confirmed(found, head):
                return self._as_receipts(calls, [found[digest] for digest in signed])
            now = time.monotonic()
            if (len(found), head) != progress:
                progress, last_progress = (len(found), head), now
            elif now - last_progress > self._patience:
                raise ChainError(
                    f"{self._nodes.name}: transactions",
                    f"{len(found)} of {len(signed)} mined, the head at {self._head()}",
                    f"progress within {self._patience:g} s; the rest may still be mined",
                )
            if now - last_broadcast > self._rebroadcast:
                unsent = {digest: raw for digest, raw in signed.items() if digest not in found}
            time.sleep(self._poll)

    def _sign(self, calls: Sequence[Call]) -> dict[str, bytes]:
        """Signed transactions by their hashes, nonces following on what each sender has under way."""
        senders = list(dict.fromkeys(call.sender for call in calls))
        replies = self._batch([("eth_getTransactionCount", [sender, "pending"]) for sender in senders])
        with _readable("eth_getTransactionCount"):
            nonces = {
                sender: hex_number(_result(reply, "eth_getTransactionCount"))
                for sender, reply in zip(senders, replies, strict=True)
            }
        signed = {}
        for call in calls:
            digest, raw = self._keyring.sign(
                call.sender, call.to, call.data, call.gas, nonces[call.sender], self._chain_id
            )
            nonces[call.sender] += 1
            signed[digest] = raw
        return signed

    def _broadcast(self, transactions: dict[str, bytes]) -> set[str]:
        """Send the same bytes, once more if need be; the hashes of those that a node has taken.

        Raises:
            ChainError: a node refuses one for good.
        """
        replies = self._batch([("eth_sendRawTransaction", ["0x" + raw.hex()]) for raw in transactions.values()])
        taken = set()
        for digest, reply in zip(transactions, replies, strict=True):
            message = reply["error"]["message"].lower() if "error" in reply else ""
            if "error" not in reply or "already known" in message or "known transaction" in message:
                taken.add(digest)
            elif "nonce too low" in message or "already imported" in message:
                # Mined already, or another transaction took the nonce: the receipt will tell, or patience will end.
                taken.add(digest)
            elif not any(word in message for word in _TRANSIENT):
                raise ChainError(f"{self._nodes.name}: transaction", digest, f"one that the node takes ({message})")
        return taken

    def _receipts(self, digests: Sequence[str]) -> dict[str, dict[str, Any]]:
        """The receipts that are there; a node that knows nothing of one yet may say so by an error."""
        replies = self._batch([("eth_getTransactionReceipt", [digest]) for digest in digests])
        found = {digest: reply.get("result") for digest, reply in zip(digests, replies, strict=True)}
        return {
            digest: receipt
            for digest, receipt in found.items()
            if isinstance(receipt, dict) and isinstance(receipt.get("blockNumber"), str)  # None while it is pending
        }

    def _confirmed(self, found: dict[str, dict[str, Any]], head: int) -> bool:
        """All receipts are deep enough below ``head``, and still the same; those that moved are forgotten."""
        if not self._confirmations:
            return True
        with _readable("eth_getTransactionReceipt"):
            if head < max(hex_number(r["blockNumber"]) for r in found.values()) + self._confirmations:
                return False
        again = self._receipts(list(found))
        moved = [digest for digest in found if again.get(digest, {}).get("blockHash") != found[digest]["blockHash"]]
        for digest in moved:
            del found[digest]
        return not moved

    def _as_receipts(self, calls: Sequence[Call], found: Sequence[dict[str, Any]]) -> list[Receipt]:
        with _readable("eth_getTransactionReceipt"):
            return self._receipts_of(calls, found)

    def _receipts_of(self, calls: Sequence[Call], found: Sequence[dict[str, Any]]) -> list[Receipt]:
        failed = [place for place, receipt in enumerate(found) if hex_number(receipt["status"]) == 0]
        reasons = dict(zip(failed, self._reasons([(calls[i], found[i]) for i in failed]), strict=True))
        receipts = []
        for place, (call, receipt) in enumerate(zip(calls, found, strict=True)):
            output, halt = reasons.get(place, (b"", None))
            created = receipt.get("contractAddress") if call.to is None else None
            receipts.append(
                Receipt(
                    hash=receipt["transactionHash"],
                    block=hex_number(receipt["blockNumber"]),
                    transaction=hex_number(receipt["transactionIndex"]),
                    sender=call.sender,
                    to=call.to,
                    created=created.lower() if created and place not in reasons else None,
                    status=place not in reasons,
                    gas_used=hex_number(receipt["gasUsed"]),
                    logs=tuple(_log(entry) for entry in receipt["logs"]),
                    output=output,
                    halt=halt,
                )
            )
        return receipts

    def _reasons(self, failed: Sequence[tuple[Call, dict[str, Any]]]) -> list[tuple[bytes, str | None]]:
        """Revert data of failed calls: from the receipt where the node tells it there (``revertReason``).

        Where it does not, the call is asked again on the state after its block. Another call of the same block may
        have changed the answer; then the state before the block is asked.
        """
        requests_: list[Request] = []
        for call, receipt in failed:
            block = hex_number(receipt["blockNumber"])
            requests_ += [("eth_call", [_message(call) | {"gas": hex(call.gas)}, hex(n)]) for n in (block, block - 1)]
        replies = self._batch(requests_)
        reasons: list[tuple[bytes, str | None]] = []
        for place, (call, receipt) in enumerate(failed):
            after, before = (_revert_data(reply) for reply in replies[2 * place : 2 * place + 2])
            data = hex_bytes(receipt.get("revertReason") or "0x") or after or before or b""
            spent = hex_number(receipt["gasUsed"]) == call.gas
            reasons.append((data, "out of gas or invalid operation" if not data and spent else None))
        return reasons

    # Requests

    def _head(self) -> int:
        with _readable("eth_blockNumber"):
            return hex_number(self._one("eth_blockNumber"))

    def _one(self, method: str, *params: Any) -> Any:
        return _result(self._batch([(method, list(params))])[0], method)

    def _batch(self, requests_: Sequence[Request]) -> list[Reply]:
        return self._post(requests_, self._patience) if requests_ else []

    def _post(self, requests_: Sequence[Request], patience: float) -> list[Reply]:
        """Replies in order; asked again, at each endpoint in turn, until one answers."""
        return self._nodes.ask(requests_, patience)


_TRANSIENT = ("txpool is full", "pool is full", "timeout", "timed out", "not ready", "syncing", "unavailable", "busy")
"""In what a node says when the same bytes may be welcome later."""


@contextmanager
def _readable(method: str) -> Iterator[None]:
    """What does not have the form of an answer becomes an error of one line."""
    try:
        yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ChainError(f"chain: {method}", None, f"an answer of Ethereum's JSON-RPC ({error!r})") from None


def _message(call: Call) -> dict[str, str]:
    message = {"from": call.sender, "data": "0x" + call.data.hex()}
    return message if call.to is None else message | {"to": call.to}


def _result(reply: dict[str, Any], method: str) -> Any:
    if "error" in reply:
        raise ChainError(f"chain: {method}", reply["error"]["message"], "an answer")
    return reply["result"]


def _answer(reply: dict[str, Any], name: str) -> Answer:
    if "error" not in reply:
        with _readable(name or "eth_call"):
            return Answer(True, hex_bytes(reply["result"]))
    data = _revert_data(reply)
    if data is None:
        raise ChainError(f"chain: {name}", reply["error"]["message"], "an answer")
    return Answer(False, data)


def _revert_data(reply: dict[str, Any]) -> bytes | None:
    """What a call reverted with, as the nodes tell it; None where it did not revert."""
    error = reply.get("error")
    if error is None:
        return None
    data = error.get("data")
    if isinstance(data, dict):
        data = data.get("data") or data.get("result")
    if isinstance(data, str) and "0x" in data:
        with _readable("eth_call"):
            return hex_bytes(data[data.index("0x") :])  # some write "Reverted 0x..."
    return b"" if "revert" in str(error.get("message", "")).lower() else None


def _log(entry: dict[str, Any]) -> LogEntry:
    return LogEntry(
        _address(entry["address"]),
        tuple(hex_bytes(topic) for topic in entry["topics"]),
        hex_bytes(entry["data"]),
        hex_number(entry["blockNumber"]),
        hex_number(entry["transactionIndex"]),
        hex_number(entry["logIndex"]),
    )


def _address(text: Any) -> str:
    return "0x" + hex_bytes(text).hex()
