"""A chain behind an Ethereum JSON-RPC endpoint: QBFT, IBFT, Clique networks with free gas.

Plain JSON-RPC in batches: long extra data, which typed clients stumble over on proof-of-authority chains, is never
looked at. Transactions are signed here, once; whatever happens after that, only the same bytes are sent again, so
that a resend can never change the state twice.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import requests

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Answer, Call, LogEntry, Receipt
from skyrelay.core.errors import ChainError

BATCH = 100
"""Requests in one HTTP call: nodes limit it."""
WINDOW = 1000
"""Transactions under way at once: a node's pool holds some thousands, shared by all who send."""
LOG_BLOCKS = 2000
"""Blocks that one search for logs covers: nodes limit it."""

_Request = tuple[str, list[Any]]


class NodeChain:
    """A chain, by way of its nodes.

    Args:
        urls: endpoints of the same chain; the next one serves when one does not answer.
        keyring: of this host's members.
        chain_id: what the chain's id must be; None where any will do.
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
        confirmations: int = 0,
        patience: float = 120.0,
        poll: float = 0.25,
        rebroadcast: float = 5.0,
    ) -> None:
        self._urls = [urls] if isinstance(urls, str) else list(urls)
        if not self._urls or not all(url.startswith(("http://", "https://")) for url in self._urls):
            raise ChainError("chain url", ", ".join(self._urls), "http:// or https:// and a node's address")
        self._keyring = keyring
        self._confirmations = confirmations
        self._patience = patience
        self._poll = poll
        self._rebroadcast = rebroadcast
        self._session = requests.Session()
        # The first contact tells at once that an address is wrong; patience is for a node that was there.
        first = self._post([("eth_chainId", []), ("eth_getBlockByNumber", ["latest", False])], patience=5.0)
        self._chain_id = int(_result(first[0], "eth_chainId"), 16)
        self._block_gas_limit = int(_result(first[1], "eth_getBlockByNumber")["gasLimit"], 16)
        if chain_id is not None and self._chain_id != chain_id:
            raise ChainError(f"{self._urls[0]}: chain id", self._chain_id, f"{chain_id}: this is another network")

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
        replies = self._batch(
            [
                ("eth_getLogs", [{"address": address, "fromBlock": hex(first), "toBlock": hex(last)}])
                for first, last in ranges
            ]
        )
        return [_log(entry) for reply in replies for entry in _result(reply, "eth_getLogs")]

    def code(self, address: str) -> bytes:
        """The code of a contract; empty where there is none."""
        return _bytes(self._one("eth_getCode", address, "latest"))

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
                raise ChainError(f"{self._urls[0]}: {what}", params[0], "one that the node has")
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
                    f"{self._urls[0]}: transactions",
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
        nonces = {
            sender: int(_result(reply, "eth_getTransactionCount"), 16)
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
            message = str(reply.get("error", {}).get("message", "")).lower()
            if "error" not in reply or "already known" in message or "known transaction" in message:
                taken.add(digest)
            elif "nonce too low" in message or "already imported" in message:
                # Mined already, or another transaction took the nonce: the receipt will tell, or patience will end.
                taken.add(digest)
            elif not any(word in message for word in _TRANSIENT):
                raise ChainError(f"{self._urls[0]}: transaction", digest, f"one that the node takes ({message})")
        return taken

    def _receipts(self, digests: Sequence[str]) -> dict[str, dict[str, Any]]:
        """The receipts that are there; a node that knows nothing of one yet may say so by an error."""
        replies = self._batch([("eth_getTransactionReceipt", [digest]) for digest in digests])
        return {digest: reply["result"] for digest, reply in zip(digests, replies, strict=True) if reply.get("result")}

    def _confirmed(self, found: dict[str, dict[str, Any]], head: int) -> bool:
        """All receipts are deep enough below ``head``, and still the same; those that moved are forgotten."""
        if not self._confirmations:
            return True
        if head < max(int(r["blockNumber"], 16) for r in found.values()) + self._confirmations:
            return False
        again = self._receipts(list(found))
        moved = [digest for digest in found if again.get(digest, {}).get("blockHash") != found[digest]["blockHash"]]
        for digest in moved:
            del found[digest]
        return not moved

    def _as_receipts(self, calls: Sequence[Call], found: Sequence[dict[str, Any]]) -> list[Receipt]:
        failed = [place for place, receipt in enumerate(found) if int(receipt["status"], 16) == 0]
        reasons = dict(zip(failed, self._reasons([(calls[i], found[i]) for i in failed]), strict=True))
        receipts = []
        for place, (call, receipt) in enumerate(zip(calls, found, strict=True)):
            output, halt = reasons.get(place, (b"", None))
            created = receipt.get("contractAddress") if call.to is None else None
            receipts.append(
                Receipt(
                    hash=receipt["transactionHash"],
                    block=int(receipt["blockNumber"], 16),
                    transaction=int(receipt["transactionIndex"], 16),
                    sender=call.sender,
                    to=call.to,
                    created=created.lower() if created and place not in reasons else None,
                    status=place not in reasons,
                    gas_used=int(receipt["gasUsed"], 16),
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
        requests_: list[_Request] = []
        for call, receipt in failed:
            block = int(receipt["blockNumber"], 16)
            requests_ += [("eth_call", [_message(call) | {"gas": hex(call.gas)}, hex(n)]) for n in (block, block - 1)]
        replies = self._batch(requests_)
        reasons: list[tuple[bytes, str | None]] = []
        for place, (call, receipt) in enumerate(failed):
            after, before = (_revert_data(reply) for reply in replies[2 * place : 2 * place + 2])
            data = _bytes(receipt.get("revertReason") or "0x") or after or before or b""
            spent = int(receipt["gasUsed"], 16) == call.gas
            reasons.append((data, "out of gas or invalid operation" if not data and spent else None))
        return reasons

    # Requests

    def _head(self) -> int:
        return int(self._one("eth_blockNumber"), 16)

    def _one(self, method: str, *params: Any) -> Any:
        return _result(self._batch([(method, list(params))])[0], method)

    def _batch(self, requests_: Sequence[_Request]) -> list[dict[str, Any]]:
        replies: list[dict[str, Any]] = []
        for start in range(0, len(requests_), BATCH):
            replies += self._post(requests_[start : start + BATCH], self._patience)
        return replies

    def _post(self, requests_: Sequence[_Request], patience: float) -> list[dict[str, Any]]:
        """One batch's replies, in order; tried again, at each endpoint in turn, until one answers.

        Every request may be repeated safely: a transaction is the same bytes each time.
        """
        body: Any = [
            {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
            for number, (method, params) in enumerate(requests_)
        ]
        deadline = time.monotonic() + patience
        pause = 0.1
        while True:
            try:
                response = self._session.post(self._urls[0], json=body, timeout=30)
                response.raise_for_status()
                replies = {reply["id"]: reply for reply in response.json()}
                return [replies[number] for number in range(len(body))]
            except (requests.RequestException, ValueError, KeyError, TypeError) as error:
                if time.monotonic() + pause > deadline:
                    reason = type(error).__name__
                    raise ChainError(
                        "chain url",
                        ", ".join(self._urls),
                        f"a node that answers JSON-RPC within {patience:g} s ({reason})",
                    ) from error
                time.sleep(pause)
                pause = min(2 * pause, 2.0)
                self._urls.append(self._urls.pop(0))


_TRANSIENT = ("txpool is full", "pool is full", "timeout", "timed out", "not ready", "syncing", "unavailable", "busy")
"""In what a node says when the same bytes may be welcome later."""


def _message(call: Call) -> dict[str, str]:
    message = {"from": call.sender, "data": "0x" + call.data.hex()}
    return message if call.to is None else message | {"to": call.to}


def _result(reply: dict[str, Any], method: str) -> Any:
    if "error" in reply:
        raise ChainError(f"chain: {method}", str(reply["error"].get("message", reply["error"])), "an answer")
    return reply["result"]


def _answer(reply: dict[str, Any], name: str) -> Answer:
    if "error" not in reply:
        return Answer(True, _bytes(reply["result"]))
    data = _revert_data(reply)
    if data is None:
        raise ChainError(f"chain: {name}", str(reply["error"].get("message", reply["error"])), "an answer")
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
        return _bytes(data[data.index("0x") :])  # some write "Reverted 0x..."
    return b"" if "revert" in str(error.get("message", "")).lower() else None


def _log(entry: dict[str, Any]) -> LogEntry:
    return LogEntry(
        entry["address"].lower(),
        tuple(_bytes(topic) for topic in entry["topics"]),
        _bytes(entry["data"]),
        int(entry["blockNumber"], 16),
        int(entry["transactionIndex"], 16),
        int(entry["logIndex"], 16),
    )


def _bytes(text: str) -> bytes:
    return bytes.fromhex(text.removeprefix("0x"))
