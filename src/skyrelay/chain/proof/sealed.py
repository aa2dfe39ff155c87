"""Reads a contract's blocks from a node and believes only what the validators' seals cover."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from eth_hash.auto import keccak

from skyrelay.chain.chain import LogEntry, SentTransaction
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.proof.headers import (
    UNREADABLE,
    Seal,
    Transaction,
    account_code_hash,
    header_hash,
    may_have_logs,
    raw_transaction,
    receipt_logs,
    receipts_root,
    transaction,
    transactions_root,
)
from skyrelay.chain.proof.replay import Difference
from skyrelay.chain.proof.root import TrustRoot
from skyrelay.chain.proof.trie import proven
from skyrelay.chain.proof.votes import Ballot, Election
from skyrelay.core.errors import ChainError
from skyrelay.core.untrusted import hex_bytes, hex_number

_ANY = TrustRoot()
_BY_VALIDATORS, _BY_ONE, _BY_NOBODY = "a quorum of validators", "one signer", "nobody"
"""How the headers of a chain are sealed: by QBFT and IBFT, by Clique, not at all."""

_AT_ONCE = 100
"""Blocks that are asked for together."""


@runtime_checkable
class Findings(Protocol):
    """Where the checks leave what they did and found: an `AuditReport`."""

    checked: Counter[str]
    differences: list[Difference]
    given: dict[str, str]


class SealedBlocks:
    """The blocks of one contract.

    Args:
        report: takes counts, differences, and what the reader must know to be right.
        root: what the reader knows.

    Attributes:
        logs: of the contract, as the receipts have them, in order.
        transactions: those in blocks with logs, by block and place.
        times: of the blocks, by number [s].
    """

    def __init__(self, chain: NodeChain, address: str, report: Findings, root: TrustRoot = _ANY) -> None:
        self.logs: list[LogEntry] = []
        self.transactions: dict[tuple[int, int], SentTransaction] = {}
        self.times: dict[int, int] = {}
        self._chain = chain
        self._address = address
        self._report = report
        self._parent: str | None = None
        self._root = root
        self._kind: str | None = None
        self._first_validators: frozenset[str] | None = None
        self._validators: frozenset[str] | None = None
        self._first_parent = ""
        self._election: Election | None = None
        self._ballots: list[tuple[int, Ballot | None]] = []
        self._looked_back = False
        self._head_seen = False
        self._sealed: Counter[str] = Counter()
        self._state = (0, "0x")

    def read(self, first: int, last: int) -> None:
        """Read and check the blocks from ``first`` to ``last``, both included.

        Raises:
            ChainError: the node is out of reach, or lacks one of them or of their receipts.
        """
        for start in range(first, last + 1, _AT_ONCE):
            numbers = range(start, min(start + _AT_ONCE, last + 1))
            checked = []
            for number, told in zip(numbers, self._chain.blocks(numbers, whole=True), strict=True):
                place = f"block {number}"
                try:
                    self._check_header(place, number, told)
                    checked.append((place, number, told, self._check_transactions(place, told)))
                except UNREADABLE as error:
                    self._differs(place, f"not readable ({error!r})", "a block of Ethereum's JSON-RPC")
                    self._parent = None
            self._read_logs(checked)
        self._check_root(last)
        self._report.given[f"block {last}"] = self._parent or "none that can be read"
        sealers = ", ".join(f"{address} ({count:,})" for address, count in sorted(self._sealed.items()))
        self._report.given["blocks sealed by"] = sealers or "nobody: this chain's headers carry no seals"

    def check_code(self, contracts: Mapping[str, bytes]) -> None:
        """Check that these codes stand at these addresses in the last block's state, by proof.

        Raises:
            ChainError: the node is out of reach, or gives no proof.
        """
        block, root = self._state
        for (address, expected), proof in zip(
            contracts.items(), self._chain.account_proofs(list(contracts), block), strict=True
        ):
            code = self._chain.code(address)
            place = f"code of {address} in block {block}"
            try:
                nodes = [hex_bytes(node) for node in proof["accountProof"]]
                account = proven(hex_bytes(root), keccak(hex_bytes(address)), nodes)
                proven_hash = b"" if account is None else account_code_hash(account)
            except UNREADABLE as error:
                self._differs(place, f"no proof ({error!r})", f"one that leads to the state's root {root}")
                continue
            self._report.checked["contracts' code proven"] += 1
            if code != expected:
                self._differs(place, f"{len(code)} other bytes", "the code of this version")
            elif proven_hash != keccak(code):
                self._differs(place, f"0x{keccak(code).hex()}", f"0x{proven_hash.hex()} by the state")

    def _check_header(self, place: str, number: int, told: Mapping[str, Any]) -> None:
        digest, seal = header_hash(told)
        self._report.checked["blocks"] += 1
        if hex_number(told["number"]) != number:
            self._differs(f"{place}: number", str(hex_number(told["number"])), str(number))
        if told["hash"] != digest:
            self._differs(f"{place}: hash", str(told["hash"]), f"{digest} by its header")
        if self._parent is not None and told["parentHash"] != self._parent:
            self._differs(f"{place}: parent", str(told["parentHash"]), f"{self._parent}, the block before")
        if self._parent is None and not self._ballots:
            self._first_parent = told["parentHash"]
        self._check_seal(place, number, seal)
        self._parent = digest
        self._head_seen |= digest == self._root.head
        self._state = (number, told["stateRoot"])
        self.times[number] = hex_number(told["timestamp"])

    def _check_seal(self, place: str, number: int, seal: Seal) -> None:
        """Enough of the validators, and validators whom those before them have voted for."""
        self._sealed.update(seal.signers)
        self._report.checked["seals"] += len(seal.signers)
        kind = _BY_VALIDATORS if seal.validators is not None else _BY_ONE if seal.signers else _BY_NOBODY
        if self._kind is None:
            self._kind, self._first_validators = kind, seal.validators
        if kind != self._kind:
            self._differs(f"{place}: sealed by", kind, f"{self._kind}, as the blocks before it")
        if seal.validators is None:
            return
        if not seal.validators:
            told = "those that may seal (validators that a contract chooses are not supported)"
            self._differs(f"{place}: validators", "none in its header", told)
        if not seal.signers <= seal.validators:
            strangers = ", ".join(sorted(seal.signers - seal.validators))
            self._differs(f"{place}: sealed by", strangers, "validators that its header names")
        entitled = len(seal.signers & seal.validators)
        if entitled < seal.quorum:
            self._differs(f"{place}: seals", f"of {entitled} validators", f"of {seal.quorum} at least")
        if seal.proposer not in seal.validators:
            self._differs(f"{place}: proposed by", str(seal.proposer), "a validator that its header names")
        self._count(place, number, seal)
        self._validators = seal.validators

    def _count(self, place: str, number: int, seal: Seal) -> None:
        """The validators are those that the votes before the block have left; then its own vote."""
        validators = seal.validators or frozenset()
        election = self._election
        if election is not None and validators != self._validators:
            self._report.checked["changes of the validators"] += 1
        if election is not None and validators != election.validators and not self._looked_back:
            election = self._elected_before(place)  # they may have voted before the first block that is read here
        if election is not None and validators != election.validators:
            self._differs(
                f"{place}: validators",
                ", ".join(sorted(validators)),
                f"{', '.join(sorted(election.validators))}, as more than half of them have voted",
            )
        if election is None or validators != election.validators:
            election = Election(validators, self._root.epoch)
        election.count(number, seal.ballot)
        self._ballots.append((number, seal.ballot))
        self._election = election

    def _elected_before(self, place: str) -> Election:
        """Counted anew from where the first block's epoch began; earlier blocks are known by the next one's hash."""
        self._looked_back = True
        first = self._ballots[0][0]
        start = first - first % self._root.epoch
        wanted, ballots, validators = self._first_parent, self._ballots[::-1], self._first_validators
        try:
            for end in range(first, start, -_AT_ONCE):
                numbers = range(max(end - _AT_ONCE, start), end)
                for number, told in zip(reversed(numbers), reversed(self._chain.blocks(numbers)), strict=True):
                    digest, seal = header_hash(told)
                    if digest != wanted:
                        raise ValueError(f"block {number} has the hash {digest}, not {wanted}")
                    wanted, validators = str(told["parentHash"]), seal.validators
                    ballots.append((number, seal.ballot))
        except (ChainError, *UNREADABLE) as error:
            self._differs(f"{place}: votes before block {first}", f"not readable ({error})", "those of its epoch")
        election = Election(validators or frozenset(), self._root.epoch)
        for number, ballot in reversed(ballots):
            election.count(number, ballot)
        return election

    def _check_root(self, last: int) -> None:
        """What was read is of the chain that the reader knows."""
        root, place = self._root, f"block {last}: sealed by"
        if self._kind == _BY_NOBODY and not root.unsealed and (root.head is None or root.head != self._parent):
            self._differs(place, _BY_NOBODY, "validators (a chain without seals only where it is asked for)")
        if root.validators is not None:
            expected = f"the validators {', '.join(sorted(root.validators))}"
            if self._kind == _BY_VALIDATORS and root.validators not in (self._first_validators, self._validators):
                self._differs(place, ", ".join(sorted(self._validators or ())), expected)
            elif self._kind != _BY_VALIDATORS and (not self._sealed or not self._sealed.keys() <= root.validators):
                self._differs(place, ", ".join(sorted(self._sealed)) or "nobody", expected)
        if root.head is not None and not self._head_seen:
            self._differs(f"blocks to {last}", f"none of the hash {root.head}", "that block among them")

    def _check_transactions(self, place: str, told: Mapping[str, Any]) -> list[Transaction]:
        root = transactions_root([raw_transaction(entry) for entry in told["transactions"]])
        if told["transactionsRoot"] != root:
            self._differs(f"{place}: transactions", f"with root {root}", str(told["transactionsRoot"]))
        if not may_have_logs(told, self._address):
            return []
        found = [transaction(entry) for entry in told["transactions"]]
        self._report.checked["signatures of transactions"] += len(found)
        for index, (entry, known) in enumerate(zip(told["transactions"], found, strict=True)):
            for name, value in (("hash", known.hash), ("from", known.sender)):
                if str(entry[name]).lower() != value:
                    self._differs(
                        f"{place}, transaction {index}: {name}", str(entry[name]), f"{value} by its signature"
                    )
        return found

    def _read_logs(self, blocks: Sequence[tuple[str, int, Mapping[str, Any], list[Transaction]]]) -> None:
        hashes = [transaction.hash for _, _, _, transactions in blocks for transaction in transactions]
        told = iter(self._chain.receipts(hashes))
        for place, number, block, transactions in blocks:
            if not transactions:
                continue
            receipts = [next(told) for _ in transactions]
            try:
                root = receipts_root(receipts)
                if block["receiptsRoot"] != root:
                    self._differs(f"{place}: receipts", f"with root {root}", str(block["receiptsRoot"]))
                self._report.checked["receipts"] += len(receipts)
                self.logs += [log for log in receipt_logs(receipts, number) if log.address == self._address]
            except UNREADABLE as error:
                self._differs(
                    place, f"receipts not readable ({error!r})", "receipts in the form of Ethereum's JSON-RPC"
                )
            for index, known in enumerate(transactions):
                self.transactions[number, index] = SentTransaction(known.sender, known.nonce, known.to, known.data)

    def _differs(self, place: str, found: str, expected: str) -> None:
        self._report.differences.append(Difference(place, found, expected))
