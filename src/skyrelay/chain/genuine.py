"""Is a contract this version's: its creation is worked out again on the own machine, and its code compared whole.

The bytes of deployed code alone do not say so: the constructor writes values into them, the address of the extension
among them, and it sets storage. What created the contract says it all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from skyrelay.chain import evm
from skyrelay.chain.abi import contract, extension, optimistic_selection
from skyrelay.chain.chain import SentTransaction
from skyrelay.core.errors import ChainError

_GAS = 30_000_000


@dataclass(frozen=True, slots=True)
class GenuineCode:
    """What must stand at the addresses of the contract and of its extension."""

    contract: bytes
    extension: bytes


def genuine_code(address: str, extension_address: str, creation: SentTransaction, chain_id: int) -> GenuineCode:
    """The codes that a creation gives.

    Args:
        address, extension_address: of the contract; of its extension, by its event Deployed.
        creation: the transaction that emitted it.
    Raises:
        ChainError: that transaction does not create this version's contract at this address.
    """
    sender = int(creation.sender, 16)
    if creation.to is not None or evm.contract_address(sender, creation.nonce) != int(address, 16):
        raise ChainError("contract", address, "one that a transaction of its own has created, not another contract")
    arguments = contract().creation_arguments(creation.data)
    named = None if arguments is None else arguments.get("extension", extension_address)
    if arguments is None or str(named).lower() != extension_address.lower():
        raise ChainError("contract", address, "the code of this version's SkyRelay contract: another one was created")
    helper = created_code(extension().creation(arguments["p"]), extension_address, creation.sender, chain_id, {})
    code = created_code(creation.data, address, creation.sender, chain_id, {extension_address: helper})
    return GenuineCode(code, helper)


def require_genuine(
    address: str, code: bytes, extension_address: str, extension_code: bytes, creation: SentTransaction, chain_id: int
) -> None:
    """Compare what stands at both addresses with what the creation gives.

    Raises:
        ChainError: it is something else.
    """
    expected = genuine_code(address, extension_address, creation, chain_id)
    if code != expected.contract:
        raise ChainError("contract", address, "the code of this version's SkyRelay contract: another one is there")
    if extension_code != expected.extension:
        raise ChainError("contract extension", extension_address, "the code of this version's extension")


def creates_claims(creation: SentTransaction, address: str, relay: str, relay_creation: SentTransaction) -> bool:
    """Whether a transaction creates, at an address, this version's contract of claims for a SkyRelay."""
    given = optimistic_selection().creation_arguments(creation.data)
    rules = contract().creation_arguments(relay_creation.data)
    created = evm.contract_address(int(creation.sender, 16), creation.nonce)
    return (
        given is not None
        and rules is not None
        and creation.to is None
        and created == int(address, 16)
        and (given["p"], str(given["relay"]).lower()) == (rules["p"], relay)
    )


def created_code(creation: bytes, address: str, sender: str, chain_id: int, codes: Mapping[str, bytes]) -> bytes:
    """The code that a creation input leaves at an address, among contracts that stand already.

    Raises:
        ChainError: the constructor fails.
    """
    state = evm.WorldState()
    for place, code in codes.items():
        state.set_code(int(place, 16), code)
    block = evm.BlockContext(1, 1, _GAS, chain_id, lambda _: 0)
    outcome = evm.create_at(state, block, sender=int(sender, 16), address=int(address, 16), data=creation, gas=_GAS)
    if not outcome.status:
        raise ChainError("contract", address, f"one whose constructor succeeds ({outcome.halt or 'it reverts'})")
    return outcome.output
