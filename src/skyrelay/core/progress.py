"""How long work tells where it is; who shows it is not its business."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Progress(Protocol):
    """Stages, one after the other, each of a known number of steps."""

    def stage(self, name: str, total: int) -> None:
        """A stage begins; the one before is done."""

    def advance(self, steps: int = 1) -> None:
        """Some steps of the present stage are done."""


class Silent:
    """Shows nothing."""

    def stage(self, name: str, total: int) -> None:
        """Nothing."""

    def advance(self, steps: int = 1) -> None:
        """Nothing."""
