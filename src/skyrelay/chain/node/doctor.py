"""Why a network stands still: what its nodes say of blocks, validators, peers, clocks and pools, compared."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from typing import Any

from skyrelay.chain.proof.headers import UNREADABLE, Seal, header_hash
from skyrelay.core.untrusted import parse_json
from skyrelay.net.http import Http, HttpError

_MOST = 8 << 20
_BLOCKS = 20
"""Newest blocks in whose seals validators are looked for."""
_CLOCK = 3.0
"""Seconds that a clock may be off: answers tell whole seconds, and nodes wait for a block from the future."""


@dataclass
class NodeHealth:
    """What one node says.

    Attributes:
        fault: why it says nothing; None where it answers.
        clock: how far its clock is ahead of this machine's [s]; None where its answers carry no date.
        hashes: of the newest blocks that it has, by number.
        seals: of the same blocks.
    """

    name: str
    fault: str | None = None
    chain_id: str | None = None
    genesis: str | None = None
    height: int = -1
    timestamp: int = 0
    peers: int | None = None
    pending: int | None = None
    queued: int | None = None
    clock: float | None = None
    hashes: dict[int, str] = field(default_factory=dict)
    seals: dict[int, Seal] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What was found: nothing, where blocks are being made.

    Attributes:
        nodes: one for each address.
        moves: the highest block grew while it was watched.
        findings: one line each, what is likeliest first.
    """

    nodes: list[NodeHealth]
    moves: bool
    findings: list[str]


def diagnose(urls: Sequence[str], watch: float = 5.0) -> Diagnosis:
    """Ask each node, wait, and ask again.

    Args:
        watch: seconds between; longer than the network's block period.
    """
    before = [_examine(url) for url in urls]
    top = max((node.height for node in before), default=-1)
    deadline = time.monotonic() + watch
    while True:
        nodes = [_examine(url) for url in urls]
        moves = max((node.height for node in nodes), default=-1) > top >= 0
        if moves or time.monotonic() > deadline:
            return Diagnosis(nodes, moves, _findings(nodes, moves, watch))
        time.sleep(0.25)


def _examine(url: str) -> NodeHealth:
    try:
        http = Http(url, timeout=5.0)
    except HttpError as error:
        return NodeHealth("an address", f"{error.told}: expected {error.expected}")
    node = NodeHealth(http.name)
    try:
        node.chain_id = str(_ask(http, node, "eth_chainId"))
        node.genesis = str(dict(_ask(http, node, "eth_getBlockByNumber", "0x0", False)).get("hash"))
        latest = _ask(http, node, "eth_getBlockByNumber", "latest", False)
        node.height, node.timestamp = int(latest["number"], 16), int(latest["timestamp"], 16)
        for number in range(max(node.height - _BLOCKS + 1, 0), node.height + 1):
            block = _ask(http, node, "eth_getBlockByNumber", hex(number), False)
            node.hashes[number] = str(block["hash"])
            try:
                node.seals[number] = header_hash(block)[1]
            except UNREADABLE:
                continue  # a chain of another kind: it has no seals to look at
    except HttpError as error:
        node.fault = f"{error.told}: expected {error.expected}"
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        node.fault = f"no answer of Ethereum's JSON-RPC ({error!r})"
    else:
        node.peers = _number(http, node, "net_peerCount")
        try:
            pool = _ask(http, node, "txpool_status")
            node.pending, node.queued = int(pool["pending"], 16), int(pool["queued"], 16)
        except (HttpError, KeyError, TypeError, ValueError):
            node.pending = None  # the node does not tell everybody
    return node


def _number(http: Http, node: NodeHealth, method: str) -> int | None:
    try:
        return int(_ask(http, node, method), 16)
    except (HttpError, TypeError, ValueError):
        return None


def _ask(http: Http, node: NodeHealth, method: str, *parameters: Any) -> Any:
    body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": parameters}).encode()
    with http.post(body, headers={"Content-Type": "application/json"}, deadline=10.0) as answer:
        date = answer.getheader("Date")
        data = answer.read(_MOST)
    if date is not None and node.clock is None:
        try:
            # The date is cut to a second: half of one is its mean error.
            node.clock = parsedate_to_datetime(date).timestamp() + 0.5 - time.time()
        except ValueError:
            node.clock = None
    told = parse_json(data, size=_MOST)
    if told.get("error") is not None:
        raise ValueError(str(told["error"])[:120])
    return told["result"]


def _findings(nodes: Sequence[NodeHealth], moves: bool, watch: float) -> list[str]:
    found = [f"{node.name} does not answer: {node.fault}" for node in nodes if node.fault is not None]
    alive = [node for node in nodes if node.fault is None]
    if not alive:
        return found
    for what, values in (
        ("chain ids", {node.name: node.chain_id for node in alive}),
        ("first blocks", {node.name: node.genesis for node in alive}),
    ):
        if len(set(values.values())) > 1:
            found.append(f"different networks, by their {what}: " + _list(values))
    found += _forks(alive)
    best = max(alive, key=lambda node: node.height)
    if not moves:
        age = time.time() - best.timestamp
        found.append(f"no new block in {watch:g} s: the highest is {best.height}, {age:,.0f} s old")
        found += _quorum(best, alive)
        waiting = max((node.pending or 0 for node in alive), default=0)
        if waiting:
            found.append(f"pool: {waiting:,} transactions wait for a block")
    for node in alive:
        if node.height < best.height - 3:
            found.append(f"{node.name} is {best.height - node.height} blocks behind")
        if node.peers == 0 and len(nodes) > 1:
            found.append(f"{node.name} has no peers: its enode list, or a firewall")
        if node.clock is not None and abs(node.clock) > _CLOCK:
            found.append(f"{node.name}: its clock is {node.clock:+.0f} s off this machine's")
        if node.queued:
            found.append(
                f"{node.name}: {node.queued:,} transactions wait for an earlier one of their sender (its nonce)"
            )
    if best.timestamp > time.time() + _CLOCK:
        ahead = best.timestamp - time.time()
        found.append(f"the latest block is {ahead:,.0f} s in the future: a validator's clock is ahead")
    return found


def _forks(alive: Sequence[NodeHealth]) -> list[str]:
    """Nodes that hold different blocks at the highest number that all of them have."""
    common = set.intersection(*(set(node.hashes) for node in alive))
    if not common:
        return []
    number = max(common)
    hashes = {node.name: node.hashes[number][:18] for node in alive}
    return [f"a fork: block {number} differs: " + _list(hashes)] if len(set(hashes.values())) > 1 else []


def _quorum(best: NodeHealth, alive: Sequence[NodeHealth]) -> list[str]:
    """Whether enough validators are there, by the seals of the newest blocks and by who is linked to whom."""
    seal = best.seals.get(best.height)
    if seal is None or seal.validators is None:
        return []
    found = []
    names = seal.validators
    most = max(((node.peers or 0) + 1 for node in alive), default=0)
    if most < seal.quorum:
        found.append(f"no quorum: {seal.quorum} of {len(names)} validators must sign, no node sees more than {most}")
    seen = frozenset().union(*(one.signers for one in best.seals.values()))
    silent = sorted(names - seen)
    if silent:
        found.append(f"validators that signed none of the last {len(best.seals)} blocks: {', '.join(silent)}")
    return found


def _list(values: Mapping[str, str | None]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())
