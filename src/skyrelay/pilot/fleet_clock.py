"""The time that a fleet is in, by its members' own clocks, of which fewer than half may say whatever they like."""

from __future__ import annotations

import math

SLOW = 3.0
"""An onlooker waits for so many times as long as the fleet has taken from one moment to the next."""


class FleetClock:
    """The lower median of what the UAVs in the air have told: more than half of them have reached it.

    Where that half does not come within the onlooker's patience after the first that is ahead, whoever has not been
    heard meanwhile is silent and does not count, until it is heard again. Half of the fleet or less moves the clock
    only as far as the onlooker's own knowledge goes.

    Attributes:
        time: by the fleet [s]; -inf before any. It goes back where those who moved it turn out to be few.
    """

    def __init__(self) -> None:
        self.time = -math.inf
        self._told: dict[str, float] = {}  # the last time of each UAV in the air; -inf before any
        self._silent: set[str] = set()
        self._ahead: float | None = None  # when the first was heard that is ahead of the clock
        self._since: set[str] = set()  # who has been heard since
        self._moved, self._pace = math.nan, 0.0

    def join(self, uav: str) -> None:
        """By the chain, it is in the air."""
        self._told.setdefault(uav, -math.inf)

    def leave(self, uav: str) -> None:
        """By the chain, it has landed."""
        self._told.pop(uav, None)
        self._silent.discard(uav)

    def hear(self, uav: str, time: float, heard: float, patience: float, most: float) -> None:
        """A UAV that is in the air tells the time; another's does not count.

        Args:
            time: by its own clock [s].
            heard: by the onlooker's clock [s].
            patience: so long the onlooker waits for more than half of the fleet [s].
            most: no later than this it can be, as far as the onlooker knows by itself [s].
        """
        if uav not in self._told:
            return
        self._told[uav] = time
        self._silent.discard(uav)
        self._work_out(heard, most)
        if time > self.time and self._ahead is None:
            self._ahead = heard
            self._since.clear()
        self._since.add(uav)
        if self._ahead is not None and heard - self._ahead > max(patience, SLOW * self._pace):
            self._silent = self._told.keys() - self._since
            self._work_out(heard, most)

    def _work_out(self, heard: float, most: float) -> None:
        told = sorted((time for uav, time in self._told.items() if uav not in self._silent), reverse=True)
        time = told[len(told) // 2]
        if 2 * len(told) <= len(self._told):
            time = min(time, most)
        if time > self.time:
            self._pace = 0.0 if math.isnan(self._moved) else heard - self._moved
            self._moved, self._ahead = heard, None
        self.time = time
