"""When a vehicle may leave the UAV that serves it: time to trigger, counted in selections."""

from __future__ import annotations

from collections.abc import Iterable


class Trigger:
    """Of one vehicle: for how many selections in a row each UAV has been better than the one that serves it.

    As event A3 of 3GPP TS 38.331 has it: an entering condition (better by more than the hysteresis) that has to hold
    for the time to trigger, for one and the same neighbour.
    """

    def __init__(self) -> None:
        self._incumbent: str | None = None
        self._times: dict[str, int] = {}

    def note(self, incumbent: str, better: Iterable[str]) -> int:
        """One more selection.

        Args:
            incumbent: who serves the vehicle.
            better: the UAVs that are better by more than the hysteresis.
        Returns: for how many selections before this one the longest of these has been better, -1 where there is none.
        """
        before = self._times if incumbent == self._incumbent else {}
        self._incumbent = incumbent
        self._times = {uav: before.get(uav, -1) + 1 for uav in better}
        return max(self._times.values(), default=-1)
