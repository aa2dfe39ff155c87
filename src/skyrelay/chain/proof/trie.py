"""Merkle Patricia tries: the root that a block's header names, and the proof of one entry.

Source: Ethereum Yellow Paper, appendix D.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import rlp
from eth_hash.auto import keccak

Node = bytes | list[Any]
"""Of a trie, before its encoding: nothing, or a list of two items (leaf, extension) or seventeen (branch)."""

_LEAF, _ODD = 0x20, 0x10


def encode(item: Node) -> bytes:
    """RLP of bytes and lists of them."""
    return bytes(rlp.encode(item, infer_serializer=False))


def decode(data: bytes) -> Any:
    """What RLP of one item encodes: bytes, or a list of such.

    Raises:
        ValueError: it is none, or its lists stand within each other deeper than any header or node has them.
    """
    try:
        return rlp.decode(data, strict=True)
    except RecursionError:
        raise ValueError("RLP of lists too deep within each other") from None
    except rlp.RLPException as error:
        raise ValueError(f"no RLP ({error})") from None


def list_root(items: Iterable[bytes]) -> bytes:
    """Root of a list: the keys are the places, in RLP (a block's transactions and receipts)."""
    return root({encode(i.to_bytes((i.bit_length() + 7) // 8, "big")): item for i, item in enumerate(items)})


def root(entries: Mapping[bytes, bytes], nodes: dict[bytes, bytes] | None = None) -> bytes:
    """Root of a trie.

    Args:
        entries: values by key; no key begins another, no value is empty.
        nodes: takes the encoding of every node by its hash, which is what proofs are made of.
    """
    store: dict[bytes, bytes] = {} if nodes is None else nodes
    encoded = encode(_node(sorted((_nibbles(key), value) for key, value in entries.items()), 0, store))
    digest = bytes(keccak(encoded))
    store[digest] = encoded
    return digest


def proven(root_hash: bytes, key: bytes, proof: Sequence[bytes]) -> bytes | None:
    """The value that a proof shows at a key; None where it shows that there is none.

    Args:
        proof: encodings of nodes, among them all on the way from the root.
    Raises:
        ValueError: the proof does not reach from the root to an answer.
    """
    by_hash = {bytes(keccak(encoded)): encoded for encoded in proof}
    path, reference = _nibbles(key), root_hash
    node: Node = reference
    while True:
        if isinstance(node, bytes):
            if not node:
                return None
            if node not in by_hash:
                raise ValueError(f"no node with hash 0x{node.hex()}")
            node = decode(by_hash[node])
        elif len(node) == 17:
            if not path:
                return bytes(node[16]) or None
            node, path = node[path[0]], path[1:]
        elif len(node) == 2:
            prefix = _nibbles(node[0])
            prefix, leaf = prefix[1 if prefix[0] & 1 else 2 :], prefix[0] & 2
            if path[: len(prefix)] != prefix or (leaf and path != prefix):
                return None
            if leaf:
                return bytes(node[1])
            node, path = node[1], path[len(prefix) :]
        else:
            raise ValueError(f"a node of {len(node)} items")


def _node(entries: Sequence[tuple[bytes, bytes]], depth: int, nodes: dict[bytes, bytes]) -> Node:
    """The node over sorted entries (keys as nibbles) that agree in what is before ``depth``."""
    if not entries:
        return b""
    first, last = entries[0][0], entries[-1][0]
    if len(entries) == 1:
        return [_path(first[depth:], _LEAF), entries[0][1]]
    end = depth
    while first[end] == last[end]:
        end += 1
    if end > depth:
        return [_path(first[depth:end], 0), _reference(_node(entries, end, nodes), nodes)]
    branch: list[Any] = [b""] * 17
    start = 0
    for place in range(1, len(entries) + 1):
        nibble = entries[start][0][depth]
        if place == len(entries) or entries[place][0][depth] != nibble:
            branch[nibble] = _reference(_node(entries[start:place], depth + 1, nodes), nodes)
            start = place
    return branch


def _reference(node: Node, nodes: dict[bytes, bytes]) -> Node:
    """What stands for a node in the one above it: itself where it is short, else its hash."""
    encoded = encode(node)
    if len(encoded) < 32:
        return node
    digest = bytes(keccak(encoded))
    nodes[digest] = encoded
    return digest


def _nibbles(key: bytes) -> bytes:
    return bytes(nibble for byte in key for nibble in (byte >> 4, byte & 15))


def _path(nibbles: bytes, flag: int) -> bytes:
    """A path in a leaf (`_LEAF`) or an extension, with its parity."""
    if len(nibbles) % 2:
        flag |= _ODD | nibbles[0]
        nibbles = nibbles[1:]
    pairs = zip(nibbles[::2], nibbles[1::2], strict=True)
    return bytes([flag, *(high << 4 | low for high, low in pairs)])
