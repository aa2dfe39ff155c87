"""What brings a UAV home by itself: that something it depends on was not there for too long."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType


class Lifeline:
    """When what a UAV depends on (the bus, the chain, its policy) was last there. No clock of its own.

    Args:
        limits: how long each may be away [s].
        now: [s]; what was never there counts from here.
    """

    def __init__(self, limits: Mapping[str, float], now: float) -> None:
        self._limits = dict(limits)
        self._last = dict.fromkeys(limits, now)

    def beat(self, what: str, now: float) -> None:
        """It is there."""
        self._last[what] = now

    def lost(self, now: float) -> list[str]:
        """What has been away for longer than it may."""
        return [what for what, limit in self._limits.items() if now - self._last[what] > limit]


class Guardian:
    """Watches a lifeline in a thread of its own, so that an agent that hangs is brought home like any other.

    Args:
        limits: as `Lifeline`'s.
        come_home: is called once, with what is lost.
        interval: between two looks [s].
    """

    def __init__(
        self, limits: Mapping[str, float], come_home: Callable[[list[str]], None], interval: float = 0.1
    ) -> None:
        self._lifeline = Lifeline(limits, time.monotonic())
        self._come_home, self._interval = come_home, interval
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def beat(self, what: str) -> None:
        """It is there; may be called from any thread."""
        self._lifeline.beat(what, time.monotonic())

    def __enter__(self) -> Guardian:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._ended.wait(self._interval):
            if lost := self._lifeline.lost(time.monotonic()):
                self._come_home(lost)
                return
