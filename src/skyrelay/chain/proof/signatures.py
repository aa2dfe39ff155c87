"""Who signed the proposals that somebody else handed in: read from the transactions' data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from skyrelay.chain.abi import Event, contract
from skyrelay.chain.typed_data import Proposal, SignedProposal


class Signatures:
    """The signed proposals in transactions to one contract.

    Args:
        address, chain_id: of the contract, for which they are signed.
        data_of: the data of an event's transaction.
    """

    def __init__(self, address: str, chain_id: int, data_of: Callable[[Event], bytes]) -> None:
        self._address, self._chain_id = address, chain_id
        self._data_of = data_of
        self._read: tuple[tuple[int, int], list[dict[str, Any]]] = ((-1, -1), [])

    def signer_of(self, event: Event) -> str | None:
        """Who signed what an event VehSelectionSubmitted tells of; None where nobody's signature is there."""
        args = event.args
        wanted = tuple(args[name] for name in ("x", "y", "payment", "demand"))
        for batch in self._batches(event):
            if batch["uav"] != args["uav"]:
                continue
            for entry in batch["proposals"]:
                signed = SignedProposal.unpacked(
                    args["uav"], args["zone"], args["round"], entry["terms"], entry["r"], entry["vs"]
                )
                if _terms(signed.proposal) == wanted:
                    signer = signed.signer(self._address, self._chain_id)
                    if signer == args["vehicle"]:
                        return signer
        return None

    def _batches(self, event: Event) -> list[dict[str, Any]]:
        place = (event.block, event.transaction)
        if self._read[0] != place:
            data = self._data_of(event)
            function = contract().function_of(data)
            batches = []
            if function is not None and function.name == "submitSigned":
                batches = function.decode_arguments(data)["batches"]
            self._read = (place, batches)
        return self._read[1]


def _terms(proposal: Proposal) -> tuple[int, int, int, int]:
    return proposal.x, proposal.y, proposal.payment, proposal.demand
