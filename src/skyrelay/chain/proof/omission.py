"""A relayer that acknowledged a proposal and did not hand it in: provable from its signature and the chain.

For consortia whose relayers give such a word: the agents here neither ask for it nor give it.
"""

from __future__ import annotations

from dataclasses import dataclass

from skyrelay.chain.abi import contract
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient
from skyrelay.chain.typed_data import SignedProposal, acknowledgement_signer, sign_acknowledgement
from skyrelay.core.errors import ChainError


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """A relayer's word that it hands a proposal in.

    Attributes:
        proposal: as the vehicle signed it.
        deadline: number of the last block that the proposal may come in.
        signature: the relayer's, of both: 65 bytes, r, s, v.
    """

    proposal: SignedProposal
    deadline: int
    relayer: str
    signature: bytes


def acknowledge(
    keyring: Keyring, relayer: str, proposal: SignedProposal, deadline: int, contract_: str, chain_id: int
) -> Acknowledgement:
    """Give a relayer's word for one contract on one chain."""
    signature = sign_acknowledgement(keyring, relayer, proposal, deadline, contract_, chain_id)
    return Acknowledgement(proposal, deadline, relayer, signature)


def is_omitted(acknowledgement: Acknowledgement, client: IovClient, handed_in: tuple[int, int] | None = None) -> bool:
    """Whether a relayer broke its word, by the chain that the client reads.

    Args:
        handed_in: block and place of the transaction that the relayer says it handed the proposal in with; it needs to
            say so only where the contract passed the proposal over, which leaves no event.
    Raises:
        ChainError: the word is not the relayer's, the proposal nobody's, or the deadline is still to come.
    """
    address, chain_id = client.address, client.chain.chain_id
    proposal, deadline = acknowledgement.proposal, acknowledgement.deadline
    signer = acknowledgement_signer(proposal, deadline, acknowledgement.signature, address, chain_id)
    if signer != acknowledgement.relayer:
        raise ChainError("acknowledgement", signer, f"the signature of {acknowledgement.relayer}")
    vehicle = proposal.signer(address, chain_id)
    if vehicle is None:
        raise ChainError("proposal", None, "one that a vehicle has signed")
    latest = client.chain.block_number
    if latest < deadline:
        raise ChainError("acknowledgement", f"due by block {deadline}", f"at most {latest}, the latest")
    told = proposal.proposal
    wanted = (vehicle, told.uav, told.zone, told.round, told.x, told.y, told.payment, told.demand)
    names = ("vehicle", "uav", "zone", "round", "x", "y", "payment", "demand")
    for event in client.events(0, deadline):
        if event.name == "VehSelectionSubmitted" and tuple(event.args[name] for name in names) == wanted:
            return False
    return handed_in is None or not _contains(client, handed_in, deadline, proposal)


def _contains(client: IovClient, place: tuple[int, int], deadline: int, proposal: SignedProposal) -> bool:
    """The transaction at a place is in time, and hands the proposal in."""
    if place[0] > deadline:
        return False
    sent = client.chain.transaction(*place)
    function = contract().function_of(sent.data)
    if sent.to != client.address or function is None or function.name != "submitSigned":
        return False
    told = proposal.proposal
    for batch in function.decode_arguments(sent.data)["batches"]:
        for entry in batch["proposals"]:
            packed = entry["terms"], entry["r"], entry["vs"]
            if SignedProposal.unpacked(batch["uav"], told.zone, told.round, *packed) == proposal:
                return True
    return False
