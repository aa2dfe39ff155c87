"""What a reader of a chain knows from elsewhere: who its validators are, and a block of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from skyrelay.chain.proof.headers import UNREADABLE, header_hash
from skyrelay.core.errors import ChainError, UsageError


@dataclass(frozen=True, slots=True)
class TrustRoot:
    """The root of trust.

    Attributes:
        validators: addresses, lower case; None: whoever the first block names.
        head: hash of a block that must be on the chain; None: any chain.
        unsealed: a chain whose headers carry no seals is what was asked for (a development node).
    """

    validators: frozenset[str] | None = None
    head: str | None = None
    unsealed: bool = False

    @classmethod
    def of(cls, validators: Sequence[str] = (), head: str | None = None, *, unsealed: bool = False) -> TrustRoot:
        """From texts.

        Raises:
            UsageError: one is no address, or no hash.
        """
        for text in validators:
            _require_hex("validators", text, 20, "an address")
        if head is not None:
            _require_hex("head", head, 32, "a block's hash")
        named = frozenset(text.lower() for text in validators)
        return cls(named or None, None if head is None else head.lower(), unsealed)

    def check(self, name: str, ask: Callable[[str, list[Any]], Any]) -> None:
        """Have a node show that it is of this root, before it is believed anything.

        Args:
            name: of the node, for messages.
            ask: the node's result of a method.
        Raises:
            ChainError: it is not.
        """
        if self.validators is not None:
            sealers, entitled = _sealed(name, ask("eth_getBlockByNumber", ["latest", False]), None)
            if entitled is None:
                good = bool(sealers) and sealers <= self.validators
            else:
                good = entitled == self.validators and len(sealers & entitled) >= -(-2 * len(entitled) // 3)
            if not good:
                found = ", ".join(sorted(entitled or sealers)) or "nobody"
                raise ChainError(f"{name}: sealed by", found, f"the validators {', '.join(sorted(self.validators))}")
        if self.head is not None:
            _sealed(name, ask("eth_getBlockByHash", [self.head, False]), self.head)


def _sealed(name: str, block: Any, digest: str | None) -> tuple[frozenset[str], frozenset[str] | None]:
    """Who sealed a block, and who was entitled to; the block must have that hash."""
    try:
        found, seal = header_hash(block)
    except UNREADABLE:
        found, seal = "none that can be read", None
    if seal is None or digest not in (None, found):
        raise ChainError(f"{name}: block", found, digest or "one with a header")
    return seal.signers, seal.validators


def _require_hex(place: str, text: str, size: int, what: str) -> None:
    digits = text.lower().removeprefix("0x")
    if not text.lower().startswith("0x") or len(digits) != 2 * size or set(digits) - set("0123456789abcdef"):
        raise UsageError(place, text, f"{what}: 0x and {2 * size} hexadecimal digits")
