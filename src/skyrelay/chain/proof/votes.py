"""Who the validators of a QBFT or IBFT chain are, by the votes in its headers.

Each block may hold one vote of its proposer: that an account becomes a validator, or is one no longer. Once more than
half of the validators have voted so, the next header names one more, or one fewer. Where an epoch begins, all votes
are forgotten. What a header names is believed only if it follows so from the headers before.

Source: the rules of EIP-225, as GoQuorum applies them to Istanbul.
"""

from __future__ import annotations

from dataclasses import dataclass

EPOCH = 30_000
"""Blocks from one forgetting of votes to the next, where nobody says otherwise: GoQuorum's, and our own networks'."""


@dataclass(frozen=True, slots=True)
class Ballot:
    """A block's vote: of its proposer, for or against an account."""

    proposer: str
    candidate: str
    admit: bool


class Election:
    """The validators after each block.

    Args:
        validators: before the first block that is counted.
        epoch: blocks from one forgetting of votes to the next.

    Attributes:
        validators: that the next header must name.
    """

    def __init__(self, validators: frozenset[str], epoch: int = EPOCH) -> None:
        self.validators = validators
        self._epoch = epoch
        self._votes: dict[tuple[str, str], bool] = {}  # by proposer and candidate

    def count(self, number: int, ballot: Ballot | None) -> None:
        """Take a block's vote; None where it has none."""
        if number % self._epoch == 0:
            self._votes.clear()
        if ballot is None or ballot.proposer not in self.validators:
            return
        self._votes.pop((ballot.proposer, ballot.candidate), None)  # the latest of a proposer counts
        if ballot.admit == (ballot.candidate in self.validators):
            return  # it is so already
        self._votes[ballot.proposer, ballot.candidate] = ballot.admit
        if 2 * sum(candidate == ballot.candidate for _, candidate in self._votes) <= len(self.validators):
            return
        self.validators ^= {ballot.candidate}
        # What was voted of who has changed is settled; who has gone has no votes.
        gone = set() if ballot.admit else {ballot.candidate}
        self._votes = {
            (proposer, candidate): admit
            for (proposer, candidate), admit in self._votes.items()
            if candidate != ballot.candidate and proposer not in gone
        }
