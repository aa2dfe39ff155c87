"""The relayer: signs nothing for itself, and hands in what vehicles have signed, many proposals to a transaction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import DEFAULT_GAS, Call
from skyrelay.chain.client import DECIMETRES, SIGNED_GAS, IovClient
from skyrelay.chain.typed_data import Proposal, SignedProposal, sign_proposal
from skyrelay.protocol.messages import Offer

BATCH = 200
"""Proposals in one transaction: 20 kB, and beyond it a proposal becomes no cheaper."""


@dataclass(frozen=True)
class Relay:
    """Of one host.

    Args:
        keyring: of its vehicles; each signs with a key of its own.
        account: who sends the transactions, any account of the chain.
        once_a_round: whether proposals are for a claim: their round, and not their record, has them count once.
    """

    keyring: Keyring
    account: str
    once_a_round: bool = False

    def sign(self, client: IovClient, offers: Sequence[tuple[str, Offer]]) -> list[SignedProposal]:
        """Each vehicle's offer, by its address, signed for the record that the contract has of it now."""
        vehicles = [vehicle for vehicle, _ in offers]
        written = (
            [0] * len(vehicles) if self.once_a_round else [info.timestamp for info in client.vehicle_infos(vehicles)]
        )
        return [
            sign_proposal(
                self.keyring,
                vehicle,
                Proposal(
                    uav=offer.proposal.uav,
                    zone=offer.record.zone,
                    round=offer.proposal.round,
                    x=round(offer.record.x * DECIMETRES),
                    y=round(offer.record.y * DECIMETRES),
                    payment=round(offer.record.payment),
                    demand=offer.proposal.demand,
                    since=since,
                ),
                client.address,
                client.chain.chain_id,
            )
            for (vehicle, offer), since in zip(offers, written, strict=True)
        ]

    def calls(self, client: IovClient, proposals: Sequence[SignedProposal]) -> list[Call]:
        """The transactions, in the order of the proposals; each fits a block."""
        room = (client.chain.block_gas_limit - DEFAULT_GAS) // SIGNED_GAS
        size = max(1, min(BATCH, room))
        return [
            client.submit_signed(self.account, proposals[start : start + size])
            for start in range(0, len(proposals), size)
        ]
