"""Roots against published ones, and proofs against the trie they are taken from."""

from __future__ import annotations

import pytest
import rlp
from eth_hash.auto import keccak
from hypothesis import given
from hypothesis import strategies as st
from trie import HexaryTrie

from skyrelay.chain.proof.headers import UNREADABLE
from skyrelay.chain.proof.trie import encode, list_root, proven, root

keys = st.binary(min_size=32, max_size=32)
values = st.binary(min_size=1, max_size=80)


def test_known_roots() -> None:
    """From the Yellow Paper (no entry) and Ethereum's common tests (trieanyorder.json: singleItem, puppy)."""
    empty = "56e81f171bcc55a6ff8345e692c0f86e5b48e01b996cadc001622fb5e363b421"
    assert root({}).hex() == list_root([]).hex() == empty
    assert root({b"A": b"a" * 50}).hex() == "d23786fb4a010da3ce639d66d5e904a11dbc02746d1ce25029e53290cabf28ab"
    # 0x80 is the key of the first place, 0x01 of the second.
    assert list_root([b"a", b"b"]) == root({b"\x80": b"a", b"\x01": b"b"})


@given(st.dictionaries(keys, values, min_size=1, max_size=40), keys, st.data())
def test_a_proof_shows_what_is_there_and_what_is_not(
    entries: dict[bytes, bytes], other: bytes, data: st.DataObject
) -> None:
    nodes: dict[bytes, bytes] = {}
    top = root(entries, nodes)
    for key in [*list(entries)[:3], other]:
        assert proven(top, key, list(nodes.values())) == entries.get(key)
    key = data.draw(st.sampled_from(list(entries)))
    changed = entries | {key: entries[key] + b"\0"}
    assert root(changed) != top
    if len(entries) > 1:
        with pytest.raises(ValueError, match="no node with hash"):
            proven(root(changed), key, list(nodes.values()))


@given(st.dictionaries(keys, values, min_size=1, max_size=40), keys)
def test_another_implementation_has_the_same_roots_and_takes_the_same_proofs(
    entries: dict[bytes, bytes], other: bytes
) -> None:
    """py-trie, as Ethereum's Python clients used it."""
    theirs = HexaryTrie({})
    for key, value in entries.items():
        theirs[key] = value
    top = root(entries)
    assert top == theirs.root_hash
    for key in [*list(entries)[:3], other]:
        proof = theirs.get_proof(key)
        assert proven(top, key, [encode(node) for node in proof]) == entries.get(key)
        nodes: dict[bytes, bytes] = {}
        root(entries, nodes)
        own = [rlp.decode(node) for node in nodes.values()]
        assert HexaryTrie.get_from_proof(top, key, own) == entries.get(key, b"")


@given(st.lists(values, max_size=300))
def test_the_root_of_a_list_tells_its_order_and_length(items: list[bytes]) -> None:
    assert list_root([*items, b"more"]) != list_root(items)
    if items != items[::-1]:
        assert list_root(items[::-1]) != list_root(items)


@pytest.mark.parametrize("node", [[], [b""] * 3, [b"", b"value"]])
def test_a_node_of_another_form_is_refused(node: list[bytes]) -> None:
    encoded = encode(node)
    with pytest.raises(UNREADABLE):
        proven(bytes(keccak(encoded)), b"key", [encoded])
