"""The audit: is every selection, by the chain's own record, what the published algorithm gives.

On a run folder the record is executed again, block by block, then the contract's events are followed by the Python
reference, then the tables and the summary beside the record are compared with it. On a node, with nothing but the
contract's address, each block's hash is worked out from what the node tells of it, down to every transaction and
receipt, and the validators' seals on it are checked; the events of these receipts are then followed the same way.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skyrelay.chain import evm
from skyrelay.chain.abi import Event, contract
from skyrelay.chain.chain import LogEntry, SentTransaction
from skyrelay.chain.claims import read_claim
from skyrelay.chain.client import IovClient
from skyrelay.chain.embedded.ledger import FILE_NAME, Block
from skyrelay.chain.genuine import creates_claims, genuine_code, require_genuine
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.proof.reference import SETTLER, ReferenceContract
from skyrelay.chain.proof.replay import Difference, replay
from skyrelay.chain.proof.root import TrustRoot
from skyrelay.chain.proof.sealed import SealedBlocks
from skyrelay.chain.proof.signatures import Signatures
from skyrelay.core.errors import ChainError, RunFolderError
from skyrelay.core.untrusted import parse_json
from skyrelay.runfolder.reader import read_table

CHAIN_FOLDER = "chain"
SUMMARY = "summary.json"
EVENTS = "events.parquet"

Progress = Callable[[str], None]


def in_silence(stage: str) -> None:
    """Show no progress."""


@dataclass
class AuditReport:
    """What an audit compared and what it found.

    Attributes:
        subject: the run folder, or the endpoint and the contract.
        checked: how many of each thing were compared.
        differences: every one found; none where all agree.
        given: what nothing here can confirm, by name: the reader compares it with a source of their own.
        unchecked: what was not compared with anything, in words.
        events: of the contract, as the chain has them.
        told: these, and before the claims' those that they stand for.
        gas: of each transaction to the contract after its founding, on the embedded chain.
        timestamps: of the embedded chain's blocks [s], by number.
        blocks: of the embedded chain, as they were executed again.
    """

    subject: str
    checked: Counter[str] = field(default_factory=Counter)
    differences: list[Difference] = field(default_factory=list)
    given: dict[str, str] = field(default_factory=dict)
    unchecked: list[str] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    told: list[Event] = field(default_factory=list)
    gas: list[int] = field(default_factory=list)
    timestamps: dict[int, int] = field(default_factory=dict)
    blocks: Sequence[Block] = ()

    @property
    def agrees(self) -> bool:
        """Nothing differs."""
        return not self.differences


def audit_run(folder: Path, progress: Progress = in_silence, *, head: str | None = None) -> AuditReport:
    """Audit a run folder.

    Args:
        progress: is told the name of each stage.
        head: hash of the record's last block, from elsewhere; None: any record.
    Raises:
        RunFolderError: the folder has no chain's record or no summary.
    """
    report = AuditReport(str(folder))
    if not (folder / CHAIN_FOLDER / FILE_NAME).is_file():
        raise RunFolderError(folder, None, f"a run's folder with {CHAIN_FOLDER}/{FILE_NAME} (a run on a node is "
                             "audited there: --chain URL --contract ADDRESS)")  # fmt: skip
    summary = _summary(folder / SUMMARY, report)
    progress("executing the record again")
    done = replay(folder / CHAIN_FOLDER)
    report.differences += done.differences
    report.checked["blocks"] = len(done.blocks)
    report.checked["transactions"] = done.transactions
    if head is not None and head.lower() != done.head:
        report.differences.append(Difference("the record's last block", done.head, head.lower()))
    _compare_summary(summary, {"chain_head": done.head, "blocks": len(done.blocks)}, report)

    address = summary.get("contract") if summary else None
    deployed = _deployments(done.blocks, done.chain_id)
    if address not in deployed:
        if summary is not None:
            report.differences.append(Difference(f"{SUMMARY}: contract", str(address), " or ".join(deployed) or "none"))
        address = deployed[0] if deployed else None
    if address is None:
        return report

    progress("rebuilding every selection")
    logs = [
        entry
        for block in done.blocks
        for receipt in block.receipts
        for entry in receipt.logs
        if entry.address == address
    ]
    transactions = {
        (block.number, index): SentTransaction(transaction.sender, transaction.nonce, transaction.to, transaction.data)
        for block in done.blocks
        for index, transaction in enumerate(block.transactions)
    }
    times = report.timestamps = {block.number: block.timestamp for block in done.blocks}
    events = report.events = _follow(logs, transactions, times, address, done.chain_id, report)
    _check_claims_contracts(address, transactions, events, report)
    report.gas = _gas(done.blocks, address, events)
    report.blocks = done.blocks
    progress("comparing the tables")
    _compare_events(folder, events, report)
    return report


def audit_node(
    chain: NodeChain, address: str, progress: Progress = in_silence, *, root: TrustRoot | None = None
) -> AuditReport:
    """Audit a contract on a node.

    Nothing that the node says is taken on trust but what `AuditReport.given` names.

    Args:
        progress: is told the name of each stage.
        root: what the reader knows of the chain; None: nothing, and that its blocks must be sealed.
    Raises:
        ChainError: the chain is out of reach, or the address is not this contract's.
    """
    client = IovClient.connect(chain, address)
    report = AuditReport(f"{client.address} on chain {chain.chain_id}")
    last = chain.block_number
    progress("reading the events")
    told = chain.logs(client.address, 0, last)
    progress("checking blocks, seals, transactions and receipts")
    blocks = SealedBlocks(chain, client.address, report, root or TrustRoot())
    blocks.read(told[0].block if told else last, last)
    if blocks.logs != told:
        report.differences.append(
            Difference("eth_getLogs", f"{len(told)} logs", f"the {len(blocks.logs)} of the blocks' receipts")
        )
    progress("rebuilding every selection")
    events = report.events = _follow(
        blocks.logs, blocks.transactions, blocks.times, client.address, chain.chain_id, report
    )
    if any(event.name == "RoleGranted" and event.args["role"] == SETTLER for event in events):
        report.unchecked.append("the code of the contract of claims: every claim is worked out again, bonds are not")
    for event in [event for event in events if event.name == "Deployed"][:1]:
        helper = event.args["extension"].lower()
        creation = blocks.transactions[event.block, event.transaction]
        try:
            genuine = genuine_code(client.address, helper, creation, chain.chain_id)
        except ChainError as error:
            report.differences.append(Difference(error.place, str(error.value), error.expected))
        else:
            blocks.check_code({client.address: genuine.contract, helper: genuine.extension})
    return report


def _follow(
    logs: Sequence[LogEntry],
    transactions: Mapping[tuple[int, int], SentTransaction],
    times: Mapping[int, int],
    address: str,
    chain_id: int,
    report: AuditReport,
) -> list[Event]:
    """Have the reference follow the contract's events."""

    def sender_of(event: Event) -> str | None:
        """Who called the contract; None where another contract did, be it one under construction."""
        sent = transactions[event.block, event.transaction]
        called = sent.to
        if called is None:
            called = f"0x{evm.contract_address(int(sent.sender, 16), sent.nonce):040x}"
        return sent.sender if called == address else None

    events = []
    for entry in logs:
        try:
            events.append(contract().event(entry))
        except ChainError as error:
            report.differences.append(Difference(error.place, str(error.value), error.expected))
    signatures = Signatures(address, chain_id, lambda event: transactions[event.block, event.transaction].data)
    reference = ReferenceContract(
        sender_of,
        lambda block: times[block],
        signatures.signer_of,
        lambda event: read_claim(transactions[event.block, event.transaction]),
        (address, chain_id),
    )
    reference.follow(events)
    report.told = reference.told
    report.checked.update(reference.checked)
    report.differences += reference.differences
    return events


def _check_claims_contracts(
    address: str, transactions: Mapping[tuple[int, int], SentTransaction], events: Sequence[Event], report: AuditReport
) -> None:
    """Whoever may settle a zone by claims is this version's contract for that."""
    founded = {(event.block, event.transaction) for event in events if event.name == "Deployed"}
    for event in events:
        if event.name == "RoleGranted" and event.args["role"] == SETTLER:
            account = event.args["account"]
            found = any(
                creates_claims(sent, account, address, transactions[place])
                for sent in transactions.values()
                if sent.to is None
                for place in founded
            )
            report.checked["contracts of claims"] += 1
            if not found:
                expected = "this version's contract of claims, with the rules of this SkyRelay"
                report.differences.append(Difference(f"block {event.block}: settler", account, expected))


def _gas(blocks: Sequence[Block], address: str, events: Sequence[Event]) -> list[int]:
    """Of what came after the founding: deployment, roles and models are not counted as the run's."""
    founding = {
        (event.block, event.transaction) for event in events if event.name in ("RoleGranted", "ModelRegistered")
    }
    claims = {(event.block, event.transaction) for event in events if event.name == "ZoneAllocated"}
    return [
        receipt.gas_used
        for block in blocks
        for index, (transaction, receipt) in enumerate(zip(block.transactions, block.receipts, strict=True))
        if (transaction.to == address or (block.number, index) in claims) and (block.number, index) not in founding
    ]


def _deployments(blocks: Sequence[Block], chain_id: int) -> list[str]:
    """Addresses where this version's contract was created, with this version's extension."""
    codes = {address: code for block in blocks for address, code in block.writes.codes.items()}
    topic = contract().topic("Deployed")
    found = []
    for block in blocks:
        for sent, receipt in zip(block.transactions, block.receipts, strict=True):
            for entry in [entry for entry in receipt.logs if entry.topics[:1] == (topic,)]:
                creation = SentTransaction(sent.sender, sent.nonce, sent.to, sent.data)
                try:
                    helper = str(contract().event(entry).args["extension"])
                    code, helper_code = codes.get(entry.address, b""), codes.get(helper, b"")
                    require_genuine(entry.address, code, helper, helper_code, creation, chain_id)
                except ChainError:
                    continue
                found.append(entry.address)
    return found


def _summary(path: Path, report: AuditReport) -> Mapping[str, Any] | None:
    """The run's summary; None, and a difference, where it is damaged."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise RunFolderError(path, None, f"the summary of a run ({error.strerror})") from error
    try:
        tree = parse_json(text)
    except ValueError as error:
        report.differences.append(Difference(SUMMARY, f"not readable ({error})", "JSON"))
        return None
    if not isinstance(tree, dict):
        report.differences.append(Difference(SUMMARY, "no object", "a JSON object"))
        return None
    return tree


def _compare_summary(summary: Mapping[str, Any] | None, expected: Mapping[str, Any], report: AuditReport) -> None:
    for key, value in expected.items() if summary is not None else ():
        report.checked["summary entries"] += 1
        if summary is not None and summary.get(key) != value:
            report.differences.append(Difference(f"{SUMMARY}: {key}", str(summary.get(key)), str(value)))


def _compare_events(folder: Path, events: Sequence[Event], report: AuditReport) -> None:
    """The run's table of events is the chain's."""
    try:
        table = read_table(folder, "events")
    except RunFolderError as error:
        place, found = error.place.removeprefix(f"{folder}/"), str(error.value or "not readable")
        report.differences.append(Difference(place, found, error.expected))
        return
    if len(table["block"]) != len(events):
        report.differences.append(Difference(f"{EVENTS}: rows", str(len(table["block"])), str(len(events))))
    names = ("block", "tx", "log", "name", "args")
    rows = zip(*(table[name][: len(events)].tolist() for name in names), strict=True)
    for number, (row, event) in enumerate(zip(rows, events, strict=False)):
        report.checked["rows of the events table"] += 1
        expected = (event.block, event.transaction, event.index, event.name, json.dumps(event.args))
        for column, found, value in zip(names, row, expected, strict=True):
            if found != value:
                report.differences.append(Difference(f"{EVENTS}: row {number}, {column}", str(found), str(value)))
