"""Signed reports of who was heard how strongly, and what the reputation authority makes of them.

A report is bound to contract, chain, period and witness, as beacons are to their session. What lowers a reputation is
all reports of the period together: their hash goes into the transaction that does it, behind the arguments, which
contracts do not look at, so that whoever is handed the reports can check that it was for these.

No agent of a run sends such reports yet: beacons carry no strength (docs/decisions/0087-plausible-places.md).
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from skyrelay.chain.accounts import signer

_MARK = b"SkyRelay witness report 1"
MAX_HEARD = 4_096
"""Members that one report tells of."""


@dataclass(frozen=True, slots=True)
class WitnessReport:
    """What one member heard in a period.

    Attributes:
        witness: its address.
        period: the number of the period.
        heard: by the sender's address, the mean strength over the one that is just heard [dB], and of how many beacons.
        signature: [65] by the witness.
    """

    witness: str
    period: int
    heard: Mapping[str, tuple[float, int]]
    signature: bytes

    def signed(self, contract: tuple[str, int]) -> bool:
        """The witness has signed it, for this contract (address, chain id), and its numbers can be."""
        try:
            content = _content(contract, self.witness, self.period, self.heard)
        except (ValueError, struct.error, OverflowError):
            return False
        return signer(content, self.signature) == self.witness


def report(
    contract: tuple[str, int],
    witness: str,
    period: int,
    heard: Mapping[str, tuple[float, int]],
    vouch: Callable[[bytes], bytes],
) -> WitnessReport:
    """Sign what was heard.

    Args:
        contract: address and chain id.
        vouch: the witness's signature of a message (`Keyring.vouch`).
    Raises:
        ValueError: a number or an address does not fit.
    """
    kept = {sender: (round(strength, 1), count) for sender, (strength, count) in heard.items()}
    return WitnessReport(witness, period, kept, vouch(_content(contract, witness, period, kept)))


def evidence(contract: tuple[str, int], reports: Iterable[WitnessReport]) -> bytes:
    """[32] the hash of a period's reports, whatever their order."""
    digests = sorted(
        hashlib.sha256(_content(contract, one.witness, one.period, one.heard) + one.signature).digest()
        for one in reports
    )
    return hashlib.sha256(_MARK + b"".join(digests)).digest()


def lowered(reputations: Mapping[str, float], implausible: Iterable[str], step: float) -> dict[str, float]:
    """The reputations [0-100] of implausible members, lower by a step; of those that are known."""
    return {one: max(reputations[one] - step, 0.0) for one in implausible if one in reputations}


def _content(contract: tuple[str, int], witness: str, period: int, heard: Mapping[str, tuple[float, int]]) -> bytes:
    if len(heard) > MAX_HEARD or witness in heard:
        raise ValueError("a report of others, and not of too many")
    parts = [_MARK, _address(contract[0]), struct.pack(">QQ", contract[1], period), _address(witness)]
    for sender, (strength, count) in sorted(heard.items()):
        if not math.isfinite(strength) or not 0 < count < 2**16:
            raise ValueError("strengths that are numbers, of some beacons")
        parts.append(_address(sender) + struct.pack(">hH", round(10 * strength), count))
    return b"".join(parts)


def _address(text: str) -> bytes:
    data = bytes.fromhex(text.removeprefix("0x"))
    if len(data) != 20:
        raise ValueError("an address of 20 bytes")
    return data
