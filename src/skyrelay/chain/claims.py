"""Selections by claim: the contract OptimisticSelection, typed, and what is read back from the transactions to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from eth_abi.abi import encode
from eth_hash.auto import keccak

from skyrelay.chain.abi import Event, optimistic_selection
from skyrelay.chain.chain import DEFAULT_GAS, Call, SentTransaction
from skyrelay.chain.client import IovClient, Role
from skyrelay.chain.typed_data import SignedProposal
from skyrelay.core.errors import ChainError

BOND = 1_000
"""What a period's claims are answerable with [the contract's token]."""
SUPPLY = 10**9
CLAIM_GAS, CLAIMED_GAS = 1_000_000, 4_000
"""Gas limit of a claim: for itself and its UAVs' share, and for each proposal."""
CHALLENGE_GAS = 30_000
"""Gas limit of a challenge for each proposal that is replayed: twice what it takes."""
MOST_PROPOSALS, MOST_NEW, MOST_UAVS, MOST_ROUNDS = 255, 128, 64, 6
"""To one UAV in a period, and in a round of it; UAVs in a round; rounds in a period."""
PROVED_GAS = 30_000
"""Gas limit of a proposal that the contract checks at once: twice what it takes."""
NOW = (1 << 48) - 1
IN_NO_LOG = -1
"""Index of an event that a claim stands for, and no log has."""
_MASK = (1 << 64) - 1 | ((1 << 32) - 1) << 96


@dataclass(frozen=True, slots=True)
class Share:
    """What is claimed of one UAV in a round.

    Attributes:
        selected: bit i: it serves its proposal i of the period after this round.
        before: how many it served before the round.
        proposals: new in this round.
    """

    uav: str
    selected: int
    before: int
    proposals: tuple[SignedProposal, ...]

    @property
    def packed(self) -> tuple[str, int, int, list[tuple[int, bytes, bytes]]]:
        """As the contract takes it."""
        return self.uav, self.selected, self.before, [signed.packed for signed in self.proposals]

    def hash(self, offered: int) -> bytes:
        """What the contract keeps of it; ``offered``: position and bandwidth of the UAV, as `offered_by`."""
        packed = b"".join(terms.to_bytes(32, "big") + r + vs for terms, r, vs in self.packed[3])
        return keccak(encode(["uint256"] * 3 + ["bytes32"], [offered, self.selected, self.before, keccak(packed)]))


@dataclass(frozen=True, slots=True)
class Claim:
    """A transaction that claims a zone's round.

    Attributes:
        contract, sender: it was sent to, and by.
        as_of: the block whose reputations it goes by; `NOW` of one that the contract has checked itself.
    """

    contract: str
    sender: str
    zone: int
    round: int
    as_of: int
    shares: tuple[Share, ...]


def read_claim(sent: SentTransaction) -> Claim | None:
    """The claim in a transaction, or what it proves; None where it is another call, or cannot be read."""
    function = optimistic_selection().function_of(sent.data)
    if sent.to is None or function is None or function.name not in ("claim", "prove"):
        return None
    try:
        given = function.decode_arguments(sent.data)
    except (ValueError, OverflowError):
        return None
    zone, round_ = given["zone"], given["round"]
    return Claim(
        sent.to,
        sent.sender,
        zone,
        round_,
        given.get("asOf", NOW),
        tuple(
            Share(
                share["uav"],
                share["selected"],
                share["before"],
                tuple(
                    SignedProposal.unpacked(share["uav"], zone, round_, entry["terms"], entry["r"], entry["vs"])
                    for entry in share["proposals"]
                ),
            )
            for share in given["shares"]
        ),
    )


class ClaimClient:
    """The contract that takes claims for a SkyRelay.

    Args:
        client: of SkyRelay, deployed with a `settling` of 3 blocks or more.
        address: of the contract.
    """

    def __init__(self, client: IovClient, address: str) -> None:
        self.client, self.address = client, address

    @classmethod
    def deploy(cls, client: IovClient, sender: str, timestamp: int | None = None) -> ClaimClient:
        """Deploy it and give it its role; ``sender``, the administrator, has all of its tokens.

        Raises:
            ContractError: SkyRelay's settings allow no claims.
        """
        data = optimistic_selection().creation(client.parameters, client.address, BOND, SUPPLY)
        call = Call(sender, None, data, min(8_000_000, client.chain.block_gas_limit), "constructor")
        receipt = client.execute([call], timestamp)[0]
        assert receipt.created is not None  # noqa: S101  (it was created, or `execute` would have raised)
        client.execute([client.grant_role(sender, Role.SETTLER, receipt.created)], timestamp)
        return cls(client, receipt.created)

    # What is sent

    def claim(self, sender: str, zone: int, round_: int, as_of: int, shares: Sequence[Share]) -> Call:
        """`claim` a zone's round."""
        gas = CLAIM_GAS + CLAIMED_GAS * sum(len(share.proposals) for share in shares)
        return self._call(sender, gas, "claim", zone, round_, as_of, [share.packed for share in shares])

    def prove(self, sender: str, zone: int, round_: int, shares: Sequence[Share]) -> Call:
        """`prove`: decide a zone's period by one round, with everything checked at once."""
        gas = CLAIM_GAS + PROVED_GAS * sum(len(share.proposals) for share in shares)
        return self._call(sender, gas, "prove", zone, round_, [share.packed for share in shares])

    def challenge(self, sender: str, zone: int, period: int, part: Part) -> Call:
        """`challenge`: prove that a UAV's share in the last of some rounds is wrong."""
        replayed = sum(len(shown.share.proposals) for shown in part.rounds if shown.share is not None)
        return self._call(sender, DEFAULT_GAS + CHALLENGE_GAS * replayed, "challenge", zone, period, part.packed)

    def finalise(self, sender: str, zone: int, period: int) -> Call:
        """`finalise`: the bond of a period comes back."""
        return self._call(sender, DEFAULT_GAS, "finalise", zone, period)

    def transfer(self, sender: str, to: str, amount: int) -> Call:
        """`transfer` some of the tokens that bonds are made of."""
        return self._call(sender, DEFAULT_GAS, "transfer", to, amount)

    # What is read

    def balance(self, account: str) -> int:
        """Tokens of an account."""
        return int(self._ask("balanceOf", account)[0])

    def state(self, zone: int, period: int) -> int:
        """Of a period's claims: 0 none, 1 open, 2 final, 3 void."""
        return int(self._ask("claims", zone, period)[0])

    def part(self, zone: int, period: int, uav: str) -> Part:
        """A UAV's part of what has been claimed of a zone's period, from the chain."""
        events = self.client.events()
        rounds = []
        for event in events:
            if (event.name, event.args.get("zone"), event.args.get("period")) != ("ZoneAllocated", zone, period):
                continue
            claim = read_claim(self.client.chain.transaction(event.block, event.transaction))
            if claim is not None and claim.contract == self.address:
                before = [e for e in events if (e.block, e.transaction) < (event.block, event.transaction)]
                rounds.append(self.shown(claim, uav, before))
        return Part(uav, tuple(rounds))

    def shown(self, claim: Claim, uav: str, before: Sequence[Event]) -> Shown:
        """One claim as it is shown again.

        Args:
            before: the events of SkyRelay until it was made.
        """
        leaves = tuple((share.uav, share.hash(offered_by(before, share.uav))) for share in claim.shares)
        own = next((share for share in claim.shares if share.uav == uav), None)
        return Shown(claim.round, leaves, offered_by(before, uav), own)

    @cached_property
    def _functions(self) -> dict[str, Any]:
        return optimistic_selection().functions

    def _call(self, sender: str, gas: int, name: str, *arguments: Any) -> Call:
        data = self._functions[name].encode(*arguments)
        return Call(sender, self.address, data, min(gas, self.client.chain.block_gas_limit), name)

    def _ask(self, name: str, *arguments: Any) -> list[Any]:
        function = self._functions[name]
        call = Call(self.client.chain.account("reader"), self.address, function.encode(*arguments), name=name)
        answer = self.client.chain.query([call])[0]
        if not answer.status:
            raise optimistic_selection().error(name, answer.output, None)
        return list(function.decode_output(answer.output))


@dataclass(frozen=True, slots=True)
class Shown:
    """A claimed round as it is shown again: all its leaves, and one UAV's share, None where it has none."""

    round: int
    leaves: tuple[tuple[str, bytes], ...]
    offered: int
    share: Share | None


@dataclass(frozen=True, slots=True)
class Part:
    """A UAV's part of a period, round by round."""

    uav: str
    rounds: tuple[Shown, ...]

    @property
    def packed(self) -> tuple[Any, ...]:
        """As the contract takes it."""
        nothing: tuple[Any, ...] = (self.uav, 0, 0, [])
        return self.uav, [
            (shown.round, list(shown.leaves), shown.offered, nothing if shown.share is None else shown.share.packed)
            for shown in self.rounds
        ]


def offered_by(events: Sequence[Event], uav: str) -> int:
    """Position and bandwidth of a UAV as packed in its record, by the last of these events that tells of them.

    Raises:
        ChainError: none does.
    """
    for event in reversed(events):
        if event.name in ("UAVRegistered", "UAVUpdated") and event.args["uav"] == uav:
            args = event.args
            word = args["x"] & 0xFFFFFFFF | (args["y"] & 0xFFFFFFFF) << 32 | args["bandwidth"] << 96
            return int(word & _MASK)
    raise ChainError("UAV", uav, "one that has registered before it was claimed of")
