"""A policy's two cards, the file's and the contract's, which must say the same before anyone flies it."""

from __future__ import annotations

from skyrelay.airspace.flight import ACTIONS
from skyrelay.chain.client import Model, ModelCard
from skyrelay.core.errors import ModelError
from skyrelay.policy.card import Card
from skyrelay.protocol.rule import RuleCard
from skyrelay.store.cid import Cid

UNTESTED = -(2**31) / 1000
"""Score of a policy without an evaluation: below every other."""


def chain_card(card: Card | RuleCard) -> ModelCard:
    """What the contract holds of a policy's card; the score is the return of its first evaluation."""
    return ModelCard(
        min_uavs=card.uavs[0],
        max_uavs=card.uavs[1],
        min_vehicles=card.vehicles[0],
        max_vehicles=card.vehicles[1],
        observation_side=card.n,
        channels=len(card.maps),
        actions=ACTIONS,
        score=round(card.evaluation[0].episode_return.mean, 3) if card.evaluation else UNTESTED,
    )


def address_of(model: Model) -> Cid:
    """Where the bytes of a model that is in use are.

    Raises:
        ModelError: the model is retired.
        StoreError: what the contract has is no CID.
    """
    if model.retired:
        raise ModelError(f"model {model.model_id}", "retired", "one that is in use")
    return Cid.from_bytes(model.cid, f"model {model.model_id}")


def require_same_card(model: Model, card: Card | RuleCard) -> None:
    """Check that a file's card says what the contract's does.

    Raises:
        ModelError: one of them was made for another policy, or promises more.
    """
    own = chain_card(card)
    for name in ModelCard.__dataclass_fields__:
        found, expected = getattr(own, name), getattr(model.card, name)
        if found != expected:
            raise ModelError(
                f"model {model.model_id}: {name} of the file's card", found, f"{expected}, as on the chain"
            )
