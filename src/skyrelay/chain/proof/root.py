"""What a reader of a chain knows from elsewhere: who its validators are, and a block of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from skyrelay.chain.proof.headers import UNREADABLE, Seal, header_hash
from skyrelay.chain.proof.votes import EPOCH, Election
from skyrelay.core.errors import ChainError, UsageError
from skyrelay.core.untrusted import hex_number

MOST_FOLLOWED = 5_000
"""Headers that are followed back from the latest to the validators that are known."""


@dataclass(frozen=True, slots=True)
class TrustRoot:
    """The root of trust.

    Attributes:
        validators: addresses, lower case; None: whoever the first block names.
        head: hash of a block that must be on the chain; None: any chain.
        unsealed: a chain whose headers carry no seals is what was asked for (a development node).
        epoch: blocks after which the network forgets votes on its validators.
    """

    validators: frozenset[str] | None = None
    head: str | None = None
    unsealed: bool = False
    epoch: int = EPOCH

    @classmethod
    def of(
        cls,
        validators: Sequence[str] = (),
        head: str | None = None,
        *,
        unsealed: bool = False,
        epoch: int = EPOCH,
    ) -> TrustRoot:
        """From texts.

        Raises:
            UsageError: one is no address, or no hash.
        """
        for text in validators:
            _require_hex("validators", text, 20, "an address")
        if head is not None:
            _require_hex("head", head, 32, "a block's hash")
        named = frozenset(text.lower() for text in validators)
        return cls(named or None, None if head is None else head.lower(), unsealed, epoch)

    def check(self, name: str, ask: Callable[[str, list[Any]], Any]) -> None:
        """Have a node show that it is of this root, before it is believed anything.

        Args:
            name: of the node, for messages.
            ask: the node's result of a method.
        Raises:
            ChainError: it is not.
        """
        if self.validators is not None:
            latest = _header(name, ask("eth_getBlockByNumber", ["latest", False]), None)
            seal = latest.seal
            if seal.validators is None:
                good = bool(seal.signers) and seal.signers <= self.validators
            else:
                good = _enough(seal, self.validators) or self._voted_in(name, latest, ask)
            if not good:
                found = ", ".join(sorted(seal.validators or seal.signers)) or "nobody"
                wanted = f"the validators {', '.join(sorted(self.validators))}, or whom they have voted in"
                raise ChainError(f"{name}: sealed by", found, wanted)
        if self.head is not None:
            _header(name, ask("eth_getBlockByHash", [self.head, False]), self.head)

    def _voted_in(self, name: str, latest: _Header, ask: Callable[[str, list[Any]], Any]) -> bool:
        """Whether the validators of a block are those that this root's have voted in, by the headers in between."""
        headers, known = [latest], False
        while latest.number and len(headers) < MOST_FOLLOWED:
            told = ask("eth_getBlockByHash", [latest.parent, False])
            if told is None:  # a node that keeps the newest blocks only
                break
            latest = _header(name, told, latest.parent)
            headers.append(latest)
            known = known or latest.seal.validators == self.validators
            # Votes may be older than the last header that names this root's validators, by an epoch at the most.
            if known and (latest.number % self.epoch == 0 or len(headers) % 64 == 0) and self._follows(headers[::-1]):
                return True
        return known and self._follows(headers[::-1])

    def _follows(self, headers: Sequence[_Header]) -> bool:
        """Whether each header after the first that names this root's validators names whom those before voted for."""
        names = [header.seal.validators == self.validators for header in headers]
        first = names.index(True)
        election = Election(self.validators or frozenset(), self.epoch)
        for header in headers[first:]:
            if header.number and not _enough(header.seal, election.validators):  # nobody seals the first block
                return False
            election.count(header.number, header.seal.ballot)
        return True


@dataclass(frozen=True, slots=True)
class _Header:
    """A block's header, worked out again."""

    number: int
    parent: str
    seal: Seal


def _header(name: str, block: Any, digest: str | None) -> _Header:
    """A block's header; the block must have that hash."""
    try:
        found, seal = header_hash(block)
        header = _Header(hex_number(block["number"]), str(block["parentHash"]), seal)
    except UNREADABLE:
        found, header = "none that can be read", None
    if header is None or digest not in (None, found):
        raise ChainError(f"{name}: block", found, digest or "one with a header")
    return header


def _enough(seal: Seal, validators: frozenset[str]) -> bool:
    """A header names these validators, and a quorum of them has sealed it."""
    return seal.validators == validators and len(seal.signers & validators) >= seal.quorum


def _require_hex(place: str, text: str, size: int, what: str) -> None:
    digits = text.lower().removeprefix("0x")
    if not text.lower().startswith("0x") or len(digits) != 2 * size or set(digits) - set("0123456789abcdef"):
        raise UsageError(place, text, f"{what}: 0x and {2 * size} hexadecimal digits")
