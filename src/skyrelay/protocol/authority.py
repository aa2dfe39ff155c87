"""The consortium's authority: gives every new member the reputation that the consortium knows it by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from skyrelay.chain.abi import Event
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.messages import Command, Message, Phase, SetReputations, Tick

MEMBERS_PER_CALL = 100


class ReputationAuthority(Agent):
    """Sets the reputations of those who have registered.

    Args:
        address: an account with the authority's role.
        reputations: of the members that it knows [0-100], by address; others keep what the contract gave them.
    """

    HEARS: ClassVar[frozenset[str]] = frozenset({"VehicleRegistered", "UAVRegistered", "ReputationSet"})

    def __init__(self, address: str, reputations: Mapping[str, float]) -> None:
        super().__init__("reputation authority", address)
        self._reputations = reputations
        self._new: dict[str, None] = {}

    def undone(self, phase: Phase) -> bool:
        """See `Agent.undone`."""
        return phase in {Phase.RATE, Phase.RESELECT} and bool(self._new)

    def receive(self, message: Message) -> Sequence[Command]:
        """Take a message; see `Agent.receive`."""
        match message:
            case Tick(Phase.RATE | Phase.RESELECT):
                members = list(self._new)
                return [
                    SetReputations({member: self._reputations[member] for member in members[i : i + MEMBERS_PER_CALL]})
                    for i in range(0, len(members), MEMBERS_PER_CALL)
                ]
            case Event("ReputationSet", args):
                self._new.pop(args["member"], None)
            case Event("VehicleRegistered", args):
                self._note(args["vehicle"])
            case Event("UAVRegistered", args):
                self._note(args["uav"])
        return ()

    def _note(self, member: str) -> None:
        if member in self._reputations:
            self._new[member] = None
