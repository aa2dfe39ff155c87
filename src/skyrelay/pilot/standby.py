"""A coordinator that stands by: it watches the chain, and acts where the first has not within a stated time."""

from __future__ import annotations

import time
from collections.abc import Callable

from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import Tick

POLL = 0.1
"""Between two looks at the contract's events [s]."""
LEADING = 0.25
"""Share of its patience that one which has taken over still leaves the first, should that be back."""


class Standby:
    """Lets the first coordinator act.

    Whoever acts, the contract decides every proposal once: a second call finds nothing left, or is refused.

    Args:
        host: of the agents that stand by.
        seconds: that the first has for what a phase asks for.
        say: is called with a line when these agents act in place of the first, and when the first is back.
    """

    def __init__(self, host: Host, seconds: float, say: Callable[[str], None]) -> None:
        self._host, self._seconds, self._say = host, seconds, say
        self._leads = False

    def wait(self, tick: Tick) -> None:
        """Until the first has done what a tick asks for, or its time is over."""
        host = self._host
        host.catch_up()
        seconds = self._seconds * (LEADING if self._leads else 1.0)
        until = time.monotonic() + seconds
        waited = False
        while host.undone(tick.phase) and time.monotonic() < until:
            waited = True
            time.sleep(POLL)
            host.catch_up()
        if host.undone(tick.phase):
            if not self._leads:
                self._say(f"takes over at step {tick.step}, {tick.phase.name}: nobody acted within {seconds:g} s")
            self._leads = True
        elif waited and self._leads:
            self._say(f"stands by again from step {tick.step}, {tick.phase.name}")
            self._leads = False
