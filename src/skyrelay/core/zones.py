"""From a position to its zone: a grid of equal squares (the paper's predefined GPS-to-zone conversion)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skyrelay.core.entities import FloatArray, IntArray


@dataclass(frozen=True)
class ZoneGrid:
    """Squares of ``side`` metres, row by row from the south-west corner; ids start at 1.

    Id 0 is no zone: the contract uses it for a UAV that has left.
    """

    x0: float
    y0: float
    side: float
    columns: int
    rows: int

    @classmethod
    def over(cls, x0: float, y0: float, x1: float, y1: float, columns: int, rows: int) -> ZoneGrid:
        """The smallest grid of ``columns`` x ``rows`` squares, centred on the box [m], that covers it."""
        side = max((x1 - x0) / columns, (y1 - y0) / rows, 1.0)
        return cls(
            x0=(x0 + x1 - side * columns) / 2, y0=(y0 + y1 - side * rows) / 2, side=side, columns=columns, rows=rows
        )

    @property
    def ids(self) -> range:
        """All zone ids."""
        return range(1, self.columns * self.rows + 1)

    def zone_of(self, x: FloatArray, y: FloatArray) -> IntArray:
        """Zone ids of positions [m]; what lies outside the grid belongs to the nearest zone."""
        column = np.clip(((x - self.x0) // self.side).astype(np.int64), 0, self.columns - 1)
        row = np.clip(((y - self.y0) // self.side).astype(np.int64), 0, self.rows - 1)
        zone: IntArray = row * self.columns + column + 1
        return zone

    def corner(self, zone: int) -> tuple[float, float]:
        """South-west corner [m] of a zone."""
        row, column = divmod(zone - 1, self.columns)
        return self.x0 + column * self.side, self.y0 + row * self.side
