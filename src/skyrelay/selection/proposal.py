"""Algorithm 1: each vehicle proposes to the UAV of its zone that it thinks best of.

The fast path never holds all pairs. Vehicles are taken in blocks of neighbours; a block looks only at the UAVs within
reach of its bounding box, and among those only at the ones that could be the best of any of its vehicles. Its result
equals the plain loop (`reference.propose`) to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.errors import SelectionError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.quality import BoolArray, closeness, distance, pair_qou, qou, standing

_BLOCK_PAIRS = 65_536  # the working arrays of a block then stay in a core's cache
_BLOCK_VEHICLES = 256  # aimed at when an area is cut into cells


def propose(
    vehicles: VehicleTable, uavs: UavTable, settings: Settings, excluded: npt.ArrayLike | None = None
) -> IntArray:
    """The UAV that each vehicle proposes to (Algorithm 1).

    Args:
        excluded: [V, U] true where a vehicle shall not propose, say because that UAV refused it before.
    Returns: [V] index of the UAV of highest QoU among the candidates, the first of equals; -1 where none has a QoU
        above 0.
    Raises:
        SelectionError: ``excluded`` is not of shape [V, U].
    Source: Algorithm 1.
    """
    if excluded is None:
        return Preferences(vehicles, uavs, settings).first(np.arange(len(vehicles), dtype=np.int64))[0]
    mask = np.asarray(excluded, dtype=bool)
    if mask.shape != (len(vehicles), len(uavs)):
        raise SelectionError("excluded.shape", mask.shape, f"the shape {(len(vehicles), len(uavs))}")
    if not len(vehicles) or not len(uavs):
        return np.full(len(vehicles), -1, dtype=np.int64)
    score = np.where(mask, -np.inf, qou(vehicles, uavs, settings))
    best = score.argmax(axis=1)
    return np.where(score[np.arange(len(vehicles)), best] > 0.0, best, -1).astype(np.int64)


class Preferences:
    """Every vehicle's list of candidates: in descending QoU, the first of equals first, none of QoU 0.

    The heads are found without making the lists; the lists are made, in 4 bytes a candidate pair, when something
    behind a head is asked for.
    """

    def __init__(self, vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> None:
        self._vehicles, self._uavs, self._settings = vehicles, uavs, settings
        self._standing = standing(uavs, settings)
        self._zones = _by_zone(uavs.zone)
        self._lists: _Lists | None = None

    def at(self, rows: IntArray, place: IntArray) -> tuple[IntArray, FloatArray]:
        """What stands at a place of the lists.

        Args:
            rows: [R] indices of vehicles, all distinct.
            place: [R] counted from 0.
        Returns: [R] UAV, -1 behind the list's end, and [R] its QoU, -inf there.
        """
        if self._lists is None and not place.any():
            return self.first(rows)
        if self._lists is None:
            self._lists = self._make_lists()
        uav = self._lists.at(rows, place)
        score = np.full(len(rows), -np.inf)
        found = uav >= 0
        score[found] = pair_qou(self._vehicles, self._uavs, rows[found], uav[found], self._settings)
        return uav, score

    def first(self, rows: IntArray) -> tuple[IntArray, FloatArray]:
        """The heads of the lists of ``rows`` [R] (Algorithm 1): [R] UAV or -1, and [R] its QoU or -inf."""
        best = np.full(len(rows), -1, dtype=np.int64)
        best_score = np.full(len(rows), -np.inf)
        for part, columns, score in self._scored(rows, prune=True):
            choice = score.argmax(axis=1)
            value = score[np.arange(len(part)), choice]
            found = value > 0.0
            best[part] = np.where(found, columns[choice], -1)
            best_score[part] = np.where(found, value, -np.inf)
        return best, best_score

    def _make_lists(self) -> _Lists:
        start = np.zeros(len(self._vehicles), dtype=np.int64)
        length = np.zeros(len(self._vehicles), dtype=np.int64)
        pieces, end = [np.empty(0, dtype=np.int32)], 0
        for part, columns, score in self._scored(np.arange(len(self._vehicles), dtype=np.int64), prune=False):
            count = (score > 0.0).sum(axis=1)
            order = np.argsort(np.negative(score, out=score), axis=1, kind="stable")[:, : count.max(initial=0)]
            pieces.append(columns[order[np.arange(order.shape[1]) < count[:, None]]].astype(np.int32))
            start[part] = end + np.cumsum(count) - count
            length[part] = count
            end += int(count.sum())
        return _Lists(np.concatenate(pieces), start, length)

    def near(
        self, rows: IntArray, admit: Callable[[IntArray, IntArray], BoolArray]
    ) -> Iterator[tuple[IntArray, IntArray, FloatArray, BoolArray]]:
        """How close vehicles and UAVs are, block by block; the arrays hold until the next block.

        Args:
            rows: [R] indices of vehicles, all distinct.
            admit: of some vehicles and UAVs, which of the vehicles matter.
        Yields: positions in ``rows`` [H], UAVs [W] (ascending), and [H, W] `quality.closeness` and who is no candidate.
        """
        scratch = _Scratch()
        for where, columns in self._blocks(rows, prune=False):
            for part in _low(where[admit(rows[where], columns)], columns):
                yield part, columns, *self._closeness(rows[part], columns, scratch)

    def _scored(self, rows: IntArray, prune: bool) -> Iterator[tuple[IntArray, IntArray, FloatArray]]:
        """Positions in ``rows``, UAVs (ascending), and the QoU of the ones for the others, -inf for no candidate."""
        scratch = _Scratch()
        for where, columns in self._blocks(rows, prune):
            for part in _low(where, columns):
                yield part, columns, self._score(rows[part], columns, scratch)

    def _score(self, rows: IntArray, columns: IntArray, scratch: _Scratch) -> FloatArray:
        """`quality.qou` of a block in place, in the same order of steps."""
        score, mask = self._closeness(rows, columns, scratch)
        np.multiply(self._settings.qou_weights[3], score, out=score)
        np.add(self._standing[columns], score, out=score)
        np.multiply(100.0, score, out=score)
        if self._settings.candidates == "range":
            np.copyto(score, -np.inf, where=mask)
        return score

    def _closeness(self, rows: IntArray, columns: IntArray, scratch: _Scratch) -> tuple[FloatArray, BoolArray]:
        """`quality.closeness` of a block in place, in the same order of steps, and who is out of range.

        Writing into arrays that stay in the cache makes this five times as fast as the plain expression.
        """
        near, work, mask = scratch.shaped(len(rows), len(columns))
        np.subtract(self._vehicles.x[rows, None], self._uavs.x[columns], out=near)
        np.subtract(self._vehicles.y[rows, None], self._uavs.y[columns], out=work)
        np.multiply(near, near, out=near)
        np.multiply(work, work, out=work)
        np.add(near, work, out=near)
        np.sqrt(near, out=near)
        if self._settings.candidates == "range":
            np.greater(near, self._settings.max_distance, out=mask)
        else:
            mask.fill(False)
        np.divide(near, self._settings.max_distance, out=near)
        np.minimum(near, 1.0, out=near)
        np.subtract(1.0, near, out=near)
        return near, mask

    def _blocks(self, rows: IntArray, prune: bool) -> Iterator[tuple[IntArray, IntArray]]:
        """Positions in ``rows`` and, ascending, the UAVs that these vehicles have to look at."""
        for zone, members in _by_zone(self._vehicles.zone[rows]).items():
            columns = self._zones.get(zone)
            if columns is None:
                continue
            if len(members) * len(columns) <= _BLOCK_PAIRS:
                yield members, columns
                continue
            eastward = columns[np.argsort(self._uavs.x[columns])]
            for cell in self._cells(rows, members):
                near = self._within_reach(rows[cell], eastward, prune)
                if len(near):
                    yield cell, near

    def _cells(self, rows: IntArray, members: IntArray) -> Iterator[IntArray]:
        """``members`` cut into squares of a side between an eighth of the range and the range."""
        x, y = self._vehicles.x[rows[members]], self._vehicles.y[rows[members]]
        reach = self._settings.max_distance
        area = max(np.ptp(x), 1.0) * max(np.ptp(y), 1.0)
        side = float(np.clip(np.sqrt(area * _BLOCK_VEHICLES / len(members)), reach / 8, reach))
        column, row = (x - x.min()) // side, (y - y.min()) // side
        order = np.lexsort((column, row))
        edges = np.flatnonzero((np.diff(column[order]) != 0) | (np.diff(row[order]) != 0)) + 1
        yield from np.split(members[order], edges)

    def _within_reach(self, rows: IntArray, eastward: IntArray, prune: bool) -> IntArray:
        """Of a zone's UAVs from west to east, ascending, the ones that can be a candidate of any of ``rows``.

        With ``prune`` only the ones that can be the best candidate of any.
        """
        settings, weight = self._settings, self._settings.qou_weights[3]
        x, y = self._vehicles.x[rows], self._vehicles.y[rows]
        west, east, south, north = x.min(), x.max(), y.min(), y.max()
        columns = eastward
        if settings.candidates == "range":
            # One metre more than the range: the last word is the distance itself.
            reach = settings.max_distance + 1.0
            band = np.searchsorted(self._uavs.x[eastward], (west - reach, east + reach))
            columns = eastward[band[0] : band[1]]
        ux, uy = self._uavs.x[columns], self._uavs.y[columns]
        # The same rounded steps as the score's own, so nearest <= distance <= furthest holds to the last bit.
        nearest = distance(_beyond(west, ux, east), _beyond(south, uy, north))
        if settings.candidates == "range":
            inside = nearest <= settings.max_distance
            columns, ux, uy, nearest = columns[inside], ux[inside], uy[inside], nearest[inside]
        if not prune or not len(columns):
            return np.sort(columns)
        furthest = distance(np.maximum(east - ux, ux - west), np.maximum(north - uy, uy - south))
        at_best = 100.0 * (self._standing[columns] + weight * closeness(nearest, settings))
        at_worst = 100.0 * (self._standing[columns] + weight * closeness(furthest, settings))
        if settings.candidates == "range":
            at_worst = at_worst[furthest <= settings.max_distance]
        return np.sort(columns[at_best >= at_worst.max()] if len(at_worst) else columns)


@dataclass(frozen=True)
class _Lists:
    """Lists of UAVs, one behind the other.

    Attributes:
        uav: [P].
        start, length: [V] of each vehicle's list.
    """

    uav: npt.NDArray[np.int32]
    start: IntArray
    length: IntArray

    def at(self, rows: IntArray, place: IntArray) -> IntArray:
        """[R] UAV at each place of the lists of ``rows``, -1 behind the end."""
        there = place < self.length[rows]
        result = np.full(len(rows), -1, dtype=np.int64)
        result[there] = self.uav[self.start[rows[there]] + place[there]]
        return result


@dataclass
class _Scratch:
    """Working arrays that one block leaves to the next."""

    size: int = 0

    def shaped(self, height: int, width: int) -> tuple[FloatArray, FloatArray, BoolArray]:
        if height * width > self.size:
            self.size = max(height * width, _BLOCK_PAIRS if self.size else 0)
            self._score, self._work = np.empty(self.size), np.empty(self.size)
            self._mask = np.empty(self.size, dtype=bool)
        count = height * width
        return (
            self._score[:count].reshape(height, width),
            self._work[:count].reshape(height, width),
            self._mask[:count].reshape(height, width),
        )


def _low(where: IntArray, columns: IntArray) -> Iterator[IntArray]:
    """``where`` in parts that make blocks of a bounded size with ``columns``."""
    height = max(1, _BLOCK_PAIRS // max(1, len(columns)))
    for begin in range(0, len(where), height):
        yield where[begin : begin + height]


def _beyond(low: float, value: FloatArray, high: float) -> FloatArray:
    return np.maximum(np.maximum(low - value, value - high), 0.0)


def _by_zone(zone: IntArray) -> dict[int, IntArray]:
    """Ascending positions of each zone's members."""
    order = np.argsort(zone, kind="stable")
    edges = np.flatnonzero(np.diff(zone[order])) + 1
    return {int(zone[group[0]]): group for group in np.split(order, edges) if len(group)}
