"""A UAV's agent with a real airframe under it: where it is comes from the autopilot, and its moves go there."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType

from skyrelay.airspace.law import Law
from skyrelay.core.errors import AutopilotError
from skyrelay.pilot.autopilot import Autopilot
from skyrelay.pilot.failsafe import Guardian
from skyrelay.protocol.messages import Fix

AWAY = {"bus": 15.0, "chain": 60.0, "policy": 15.0}
"""How long each may be away before the UAV comes home [s]."""


class FlownUav:
    """Takes off when it is entered, and comes home when it is left, or when what it depends on is away for too long.

    Args:
        law, zone: where it flies.
        altitude: [m].
        say: is called with a line when it comes home by itself, or cannot do what the policy wants.
    """

    def __init__(self, autopilot: Autopilot, law: Law, zone: int, altitude: float, say: Callable[[str], None]) -> None:
        self._autopilot, self._law, self._zone, self._altitude, self._say = autopilot, law, zone, altitude, say
        self._guardian = Guardian(AWAY, self._give_up)

    def fix(self) -> Fix:
        """Where the autopilot says it is."""
        return self._autopilot.fix()

    def beat(self, what: str) -> None:
        """The bus, the chain or the policy is there."""
        self._guardian.beat(what)

    def fly(self, action: int) -> None:
        """The policy's move; one that the autopilot does not take is told, and counts as none."""
        try:
            self._autopilot.fly(action, self._law)
        except AutopilotError as error:
            self._say(str(error))
        else:
            self._guardian.beat("policy")

    def __enter__(self) -> FlownUav:
        self._autopilot.fence(self._law, self._zone)
        self._autopilot.take_off(self._altitude, self._law.speed)
        self._guardian = Guardian(AWAY, self._give_up).__enter__()  # the climb does not count
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._guardian.__exit__(kind, error, trace)
        self._autopilot.come_home()

    def _give_up(self, lost: list[str]) -> None:
        self._say(f"{' and '.join(lost)} away for too long: coming home")
        self._autopilot.come_home()
