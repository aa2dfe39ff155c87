"""Where members are: the world answers for the receivers of those who are in it; others have one of their own."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from skyrelay.pilot.bus import Bus
from skyrelay.pilot.flown import FlownUav
from skyrelay.pilot.position import PositionSource
from skyrelay.pilot.wire import FixesMessage, FixMessage, WhereMessage, decode
from skyrelay.protocol.messages import Fix, Phase, Tick

ANSWER = 10.0
"""A world that does not say for so long where members are leaves them without news [s]."""


def sky_key(contract: str) -> str:
    """Where a world is asked where its members are."""
    return f"skyrelay/{contract}/world/where"


class Sky:
    """The world's side: answers whoever asks, in a thread, with what was last told.

    Args:
        contract: its address, which names the run on the bus.
        names: of the run's hosts.

    Attributes:
        begin: when the run begins, for hosts that go by the clock [s since 1970].
        asked: names of the run's hosts that have.
    """

    def __init__(self, bus: Bus, contract: str, names: Sequence[str]) -> None:
        self.begin: float | None = None
        self.asked: set[str] = set()
        self._bus, self._names = bus, frozenset(names)
        self._fixes: dict[str, Fix] = {}
        bus.attend(sky_key(contract), self._answer)

    def tell(self, fixes: Mapping[str, Fix]) -> None:
        """New positions, by address."""
        self._fixes = dict(fixes)  # whoever is being answered keeps the old ones

    def _answer(self, question: bytes) -> bytes:
        wanted, fixes = decode(WhereMessage, question), self._fixes
        if wanted.name in self._names:  # others may ask, and are not remembered
            self.asked.add(wanted.name)
        known = {member: FixMessage.of(fixes[member]) for member in wanted.members if member in fixes}
        return FixesMessage(fixes=known, time=time.time(), begin=self.begin, peers=self._bus.linked).encode()


class Receivers:
    """Those of a host's members.

    Args:
        name: of the host.
        members: addresses of those whom the world tells where they are.
        own: receivers of members that have one.
        flown: UAVs with an airframe, which knows where it is.

    Attributes:
        peers: those on the bus that the world is linked to, as it last said.
    """

    def __init__(
        self,
        bus: Bus,
        contract: str,
        name: str,
        members: Sequence[str],
        own: Mapping[str, PositionSource] = MappingProxyType({}),
        flown: Mapping[str, FlownUav] = MappingProxyType({}),
    ) -> None:
        self.flown = flown
        self.peers: list[str] = []
        self._own: Mapping[str, PositionSource] = {**own, **flown}
        self._bus, self._key = bus, sky_key(contract)
        self._name, self._members = name, [member for member in members if member not in self._own]
        self._told: tuple[int, bool] | None = None

    def fixes(self, tick: Tick) -> dict[str, Fix]:
        """What is new, by address; nothing of those whom the world does not answer for.

        The world is asked once a step, and once when members land: by the clock on the wall the step may just begin.
        """
        moment = (tick.step, tick.phase is Phase.LAND)
        own = {address: source.fix() for address, source in self._own.items()}
        if moment == self._told or not self._members:
            return own
        answer = self._ask(self._members)
        if answer is None:
            return own
        self._told = moment
        return answer.read() | own

    def time(self) -> float | None:
        """By their clock, a moment ago [s since 1970]; None where none of them says."""
        answer = self._ask([])
        return None if answer is None else answer.time

    def begin(self) -> float | None:
        """When the run begins, or began [s since 1970]; None until that is known."""
        answer = self._ask([])
        return None if answer is None else answer.begin

    def _ask(self, members: list[str]) -> FixesMessage | None:
        content = self._bus.ask(self._key, WhereMessage(name=self._name, members=members).encode(), ANSWER).answer()
        if content is None:
            return None
        answer = decode(FixesMessage, content)
        self.peers = answer.peers
        return answer
