"""What all agents have in common: an address, a place in their table, and calls that are under way."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from skyrelay.protocol.messages import ChainCall, Command, LeftOut, Message, Mined, Offer, Phase, Refused


class Agent(ABC):
    """A member of the system: takes messages, answers with commands, does nothing by itself.

    Attributes:
        HEARS: the contract's events that it wants whomever they name; of the others it gets those that name it.
        name, address: its own.
    """

    HEARS: ClassVar[frozenset[str]]

    def __init__(self, name: str, address: str) -> None:
        self.name, self.address = name, address
        self._under_way: set[type] = set()

    @property
    def tuned_in(self) -> int:
        """The zone whose UAVs' beacons it listens to; 0 for none."""
        return 0

    def undone(self, phase: Phase) -> bool:  # noqa: ARG002  (for those who coordinate)
        """Whether the contract still lacks what this agent, or one that does the same, has to do in a phase."""
        return False

    @abstractmethod
    def receive(self, message: Message) -> Sequence[Command]:
        """Take a message; what the agent wants done about it, in order.

        Raises:
            ProtocolError: the process sequence does not allow it.
        """

    def _call(self, command: ChainCall | Offer) -> Sequence[Command]:
        """A call, unless one of its kind is under way: a slow chain shall not be asked twice."""
        if type(command) in self._under_way:
            return ()
        self._under_way.add(type(command))
        return (command,)

    def _answered(self, message: Mined | Refused | LeftOut) -> None:
        self._under_way.discard(type(message.call))
