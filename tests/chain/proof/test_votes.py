"""A change of validators is believed if more than half of those before have voted so, and not because it is sealed."""

from __future__ import annotations

import gzip
import json
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pytest
import rlp
from eth_hash.auto import keccak
from eth_keys.datatypes import PrivateKey
from tapes import FOLDER, NEWCOMER

from skyrelay.chain.proof.headers import header_hash
from skyrelay.chain.proof.replay import Difference
from skyrelay.chain.proof.root import TrustRoot
from skyrelay.chain.proof.sealed import SealedBlocks
from skyrelay.chain.proof.votes import Ballot, Election
from skyrelay.core.errors import ChainError

Header = dict[str, Any]
KEYS = [PrivateKey(keccak(bytes([i]))) for i in range(6)]
ADDRESSES = [key.public_key.to_canonical_address() for key in KEYS]
NAMES = ["0x" + address.hex() for address in ADDRESSES]
MIX = "0x63746963616c2062797a616e74696e65206661756c7420746f6c6572616e6365"
NOTHING = "0x" + keccak(b"\x80").hex()


def tape(consensus: str) -> list[Header]:
    headers: list[Header] = json.loads(gzip.decompress((FOLDER / f"votes-{consensus}.json.gz").read_bytes()))
    return headers


class Chain:
    """A node that has these headers, and counts how many it gives."""

    def __init__(self, headers: Sequence[Header]) -> None:
        self.headers = {int(header["number"], 16): header for header in headers}
        self.given = 0

    def blocks(self, numbers: Sequence[int], *, whole: bool = False) -> list[Header]:
        del whole
        self.given += len(numbers)
        return [self.headers[number] for number in numbers]

    def receipts(self, hashes: Sequence[str]) -> list[Header]:
        assert not hashes
        return []

    def ask(self, method: str, parameters: list[Any]) -> Header | None:
        if method == "eth_getBlockByNumber":
            return self.headers[max(self.headers)]
        return next((one for one in self.headers.values() if one["hash"] == parameters[0]), None)


class Findings:
    def __init__(self) -> None:
        self.checked: Counter[str] = Counter()
        self.differences: list[Difference] = []
        self.given: dict[str, str] = {}


def read(headers: Sequence[Header], first: int = 1, root: TrustRoot | None = None) -> tuple[list[str], Findings, Chain]:
    found, chain = Findings(), Chain(headers)
    SealedBlocks(chain, NEWCOMER, found, root or TrustRoot()).read(first, max(chain.headers))  # type: ignore[arg-type]
    return [str(difference) for difference in found.differences], found, chain


def forged(blocks: Sequence[tuple[Sequence[int], int, tuple[int, bool] | None]], first: int = 1) -> list[Header]:
    """QBFT headers, each sealed by all whom it names: who they are, who proposes, and the vote, by numbers of keys."""
    headers: list[Header] = []
    parent = "0x" + "00" * 32
    for number, (validators, proposer, vote) in enumerate(blocks, first):
        named = sorted(ADDRESSES[one] for one in validators)
        cast: Any = [] if vote is None else [ADDRESSES[vote[0]], b"\xff" if vote[1] else b""]

        def extra(seals: list[bytes], named: Any = named, cast: Any = cast) -> str:
            return "0x" + rlp.encode([bytes(32), named, cast, b"", seals], infer_serializer=False).hex()

        header: Header = {
            "parentHash": parent, "sha3Uncles": NOTHING, "miner": NAMES[proposer], "stateRoot": NOTHING,
            "transactionsRoot": NOTHING, "receiptsRoot": NOTHING, "logsBloom": "0x" + "00" * 256, "difficulty": "0x1",
            "number": hex(number), "gasLimit": "0x0", "gasUsed": "0x0", "timestamp": hex(number), "mixHash": MIX,
            "nonce": "0x" + "00" * 8, "transactions": [], "extraData": extra([]),
        }  # fmt: skip
        digest, _ = header_hash(header)  # of round 0: what is sealed is what is hashed
        seals = [KEYS[one].sign_msg_hash(bytes.fromhex(digest[2:])).to_bytes() for one in validators]
        headers.append(header | {"extraData": extra(seals), "hash": digest})
        parent = digest
    return headers


@pytest.mark.parametrize("consensus", ["qbft", "ibft"])
def test_validators_whom_real_ones_have_voted_in_and_out_are_believed(consensus: str) -> None:
    lines, found, chain = read(tape(consensus))
    assert lines == []
    assert found.checked["changes of the validators"] == 2
    assert chain.given == len(chain.headers) - 1


@pytest.mark.parametrize("consensus", ["qbft", "ibft"])
@pytest.mark.parametrize("first", [5, 6])
def test_votes_before_the_first_block_are_looked_for(consensus: str, first: int) -> None:
    lines, _, chain = read(tape(consensus), first)
    assert lines == []
    assert chain.given == len(chain.headers), "those before it once, and no more"


@pytest.mark.parametrize("consensus", ["qbft", "ibft"])
def test_an_agent_follows_votes_from_the_validators_that_it_knows(consensus: str) -> None:
    headers = tape(consensus)
    _, at_first = header_hash(headers[1])
    _, voted_in = header_hash(headers[9])
    assert at_first.validators is not None and voted_in.validators is not None  # noqa: PT018
    TrustRoot.of(sorted(at_first.validators)).check("node", Chain(headers[:10]).ask)
    TrustRoot.of(sorted(voted_in.validators)).check("node", Chain(headers).ask)
    for known in (sorted(at_first.validators)[:3], [*sorted(at_first.validators)[:3], NEWCOMER]):
        with pytest.raises(ChainError, match="sealed by"):
            TrustRoot.of(known).check("node", Chain(headers[:10]).ask)


ALL = (0, 1, 2, 3)
QUIET = (ALL, 0, None)


def test_a_newcomer_whom_fewer_voted_for_is_named_though_all_have_sealed() -> None:
    """By what seals alone say, more than a third of those before stand behind each of these blocks."""
    grown = (*ALL, 4)
    votes = [(ALL, 0, (4, True)), (ALL, 1, (4, True))]
    lines, *_ = read(forged([QUIET, *votes, (grown, 2, None)]))
    assert any(line.startswith("block 4: validators: ") for line in lines)
    good = forged([QUIET, *votes, (ALL, 2, (4, True)), (grown, 3, None)])
    assert read(good)[0] == []
    known = TrustRoot.of(NAMES[:4])
    known.check("node", Chain(good).ask)
    for bad in ([QUIET, *votes, (grown, 2, None)], [QUIET, (grown, 2, None)], [QUIET, *votes, ((*ALL, 5), 2, None)]):
        with pytest.raises(ChainError, match="sealed by"):
            known.check("node", Chain(forged(bad)).ask)


@pytest.mark.parametrize(
    "votes",
    [
        [(ALL, 0, (4, True)), (ALL, 0, (4, True)), (ALL, 0, (4, True))],
        [(ALL, 0, (4, True)), (ALL, 1, (4, True)), (ALL, 5, (4, True))],
        [(ALL, 0, (4, True)), (ALL, 1, (4, True)), (ALL, 2, (4, False))],
        [(ALL, 0, (4, True)), (ALL, 1, (4, True)), (ALL, 2, (5, True))],
        [(ALL, 0, (4, True)), (ALL, 1, (4, True)), (ALL, 1, (4, False)), (ALL, 2, (4, True))],
    ],
    ids=["one thrice", "a stranger's", "against", "for another", "taken back"],
)
def test_votes_that_do_not_count(votes: list[tuple[Sequence[int], int, tuple[int, bool]]]) -> None:
    lines, *_ = read(forged([QUIET, *votes, ((*ALL, 4), 2, None)]))
    assert any(line.startswith(f"block {len(votes) + 2}: validators: ") for line in lines)


def test_an_epoch_forgets_votes() -> None:
    votes = [(ALL, 0, (4, True)), (ALL, 1, (4, True)), (ALL, 2, (4, True)), ((*ALL, 4), 3, None)]
    assert read(forged(votes), root=TrustRoot(epoch=10))[0] == []
    assert read(forged(votes), root=TrustRoot(epoch=3))[0] != []
    late = forged([QUIET, QUIET, *votes])
    assert read(late, 3, TrustRoot(epoch=3))[0] == [], "the epoch's first block votes already"


def test_validators_that_a_contract_chooses_are_told_in_a_line() -> None:
    lines, *_ = read(forged([((), 0, None)]))
    assert any("validators that a contract chooses are not supported" in line for line in lines)


def test_a_look_back_is_paid_for_once() -> None:
    """Each block of a hostile node's may name others."""
    headers = forged([(ALL, 0, None)] * 50 + [((*ALL, 4 + i % 2), 0, None) for i in range(20)], 0)
    lines, _, chain = read(headers, 40)
    assert len([line for line in lines if ": validators: " in line]) == 20
    assert chain.given <= len(headers)


def test_who_has_gone_has_no_votes_left() -> None:
    election = Election(frozenset(NAMES[:4]))
    election.count(1, Ballot(NAMES[3], NAMES[4], admit=True))
    for number in range(3):
        election.count(2 + number, Ballot(NAMES[number], NAMES[3], admit=False))
    assert election.validators == frozenset(NAMES[:3])
    election.count(5, Ballot(NAMES[0], NAMES[4], admit=True))
    assert election.validators == frozenset(NAMES[:3])
    election.count(6, Ballot(NAMES[1], NAMES[4], admit=True))
    assert election.validators == frozenset(NAMES[:3]) | {NAMES[4]}
