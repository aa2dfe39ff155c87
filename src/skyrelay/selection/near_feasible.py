"""Stable matching under weighted capacities, each exceeded by less than the demand of one vehicle.

Under bandwidth quotas a stable matching need not exist (docs/explanation/stability.md). It does once a UAV may take the
one vehicle that crosses its quota. A UAV then chooses, among all that ever asked it, by falling score:

    v stays as long as those before it ask for less than the UAV has.

Who is refused has vehicles before it that fill the UAV, and keeps them: what is chosen later, among more, only comes
earlier in the order. So deferred acceptance ends with every UAV holding its choice among all that asked it, in
whatever order they did.

- Excess: those before the last one held ask for less than the quota, so the load is below the quota and the demand of
  that one together; and that demand by itself fits the quota (a pair of which it does not is none).
- Stability, with each quota raised to its UAV's load: let v rather have u than what it got. Then v asked u and was
  refused; those whom u holds come before v and fill it, and the raised quota leaves nothing beside them.
- Best for vehicles, among the matchings in which UAVs hold what they choose and would not choose who likes them
  better: a pair of one of these is never refused (the first to be refused would need another one to be before it).

Source: Dean, Goemans and Immorlica, "The unsplittable stable marriage problem" (2006); for the excess also Kawase and
Iwasaki, "Near-feasible stable matchings with budget constraints" (2017); Gale and Shapley (1962).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.errors import SelectionError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.proposal import Preferences
from skyrelay.selection.quality import BoolArray, density, offer, standing

Index = npt.NDArray[np.int32]

_FEWER = 0.7  # a pass over all pairs is worth it while it leaves fewer than this share of them
_LISTED = 8  # pairs of a vehicle listed at a time
_SAMPLES = (0.05, 0.25)  # shares of the vehicles whose matching bounds that of all from below
_WORTH_SAMPLING = 50_000  # vehicles


@dataclass(frozen=True)
class Matching:
    """Who serves whom.

    Attributes:
        assignment: [V] UAV or -1.
        excess: [U] what each UAV promised above its capacity, in the unit of the demands; below the greatest demand.
        rounds: in which vehicles proposed.
    """

    assignment: IntArray
    excess: FloatArray
    rounds: int


def near_feasible_matching(
    vehicle: npt.ArrayLike,
    uav: npt.ArrayLike,
    liking: npt.ArrayLike,
    score: npt.ArrayLike,
    demand: npt.ArrayLike,
    capacity: npt.ArrayLike,
) -> Matching:
    """Match vehicles and UAVs stably, each UAV's capacity exceeded by less than the demand of one vehicle.

    Takes bare arrays: the two sides may be anything that asks for so much, and anything that has so much.

    Args:
        vehicle, uav: [P] the pairs that are possible, in any order, none of them twice.
        liking: [P] how much the vehicle likes the UAV; of equals the lower UAV comes first.
        score: [P] how much the UAV likes the vehicle; of equals the lower vehicle comes first.
        demand: [V] above 0.
        capacity: [U] at least 0, in the same unit. A pair whose demand is above the capacity is left out.
    Returns: the matching that is best for every vehicle, see above; sums of demands that are no whole numbers are
        rounded.
    Raises:
        SelectionError: an array that does not fit the others, or a value out of range, named by its place.
    """
    sizes, room = _numbers("demand", demand, 0.0, above=True), _numbers("capacity", capacity, 0.0)
    pairs = _Pairs(
        _indices("vehicle", vehicle, len(sizes)),
        _indices("uav", uav, len(room)),
        _numbers("liking", liking),
        _numbers("score", score),
    )
    for name in ("uav", "liking", "score"):
        if len(getattr(pairs, name)) != len(pairs):
            raise SelectionError(f"len({name})", len(getattr(pairs, name)), f"that of vehicle, {len(pairs)}")
    market = _Market(sizes, room)
    ordered = pairs.in_order(len(room))
    market.match(np.arange(len(sizes)), lambda rows, _: (ordered, np.full(len(rows), -np.inf)))
    return market.matching()


def near_feasible(vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> Matching:
    """Match vehicles and their candidates, vehicles by QoU and UAVs by QoV/sqrt(RB); see `near_feasible_matching`.

    Most pairs are never listed. A matching of some vehicles says whom a UAV surely refuses when all ask: among more it
    is never less choosy. And a vehicle's list goes on only when it has come to its end.

    Returns: the matching, its excess in kbit/s.
    """
    market = _Market(vehicles.demand, uavs.bandwidth)
    candidates = _Candidates(vehicles, uavs, settings, market)
    if len(vehicles) >= _WORTH_SAMPLING:
        mixed = np.random.default_rng(0).permutation(len(vehicles))  # any samples will do
        for share in _SAMPLES:
            market.match(np.sort(mixed[: int(share * len(mixed))]), candidates.listed)
    market.match(np.arange(len(vehicles), dtype=np.int64), candidates.listed)
    return market.matching()


@dataclass(frozen=True)
class _Pairs:
    """Pairs, [P] each: those of a vehicle one after the other, by UAV unless said otherwise."""

    vehicle: Index
    uav: Index
    liking: FloatArray
    score: FloatArray

    @classmethod
    def joined(cls, pieces: list[_Pairs]) -> _Pairs:
        """One behind the other."""
        return cls(
            np.concatenate([piece.vehicle for piece in pieces]),
            np.concatenate([piece.uav for piece in pieces]),
            np.concatenate([piece.liking for piece in pieces]),
            np.concatenate([piece.score for piece in pieces]),
        )

    @classmethod
    def none(cls) -> _Pairs:
        return cls(np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int32), np.empty(0), np.empty(0))

    def __len__(self) -> int:
        return len(self.vehicle)

    def __getitem__(self, which: Any) -> _Pairs:
        return _Pairs(self.vehicle[which], self.uav[which], self.liking[which], self.score[which])

    def in_order(self, uavs: int) -> _Pairs:
        """By vehicle and UAV.

        Raises:
            SelectionError: a pair is there twice.
        """
        key = self.vehicle.astype(np.int64) * uavs + self.uav
        if (np.diff(key) > 0).all():
            return self
        order = np.argsort(key)
        ordered, twice = self[order], np.flatnonzero(np.diff(key[order]) == 0)
        if len(twice):
            pair = (int(ordered.vehicle[twice[0]]), int(ordered.uav[twice[0]]))
            raise SelectionError("vehicle, uav", pair, "each pair once")
        return ordered

    def firsts(self) -> IntArray:
        """Where the pairs of each vehicle begin."""
        return np.flatnonzero(np.diff(self.vehicle, prepend=-1))

    def favourites(self) -> IntArray:
        """Where the pair of each vehicle is that it likes best, the first of equals."""
        first = self.firsts()
        if not len(first):
            return first
        best = np.maximum.reduceat(self.liking, first)
        found = np.flatnonzero(self.liking == np.repeat(best, np.diff(first, append=len(self))))
        unequalled: IntArray = found[np.diff(self.vehicle[found], prepend=-1) != 0]
        return unequalled


class _Queue:
    """Where each vehicle stands in its list of UAVs.

    Attributes:
        pairs: lists, one behind the other, by falling liking each.
        place, end: [V] of the next to ask in ``pairs``, and behind the last one of its list.
        home: [V] where the pair is that a UAV holds, or -1.
    """

    def __init__(self, vehicles: int) -> None:
        self.pairs = _Pairs.none()
        self.place, self.end = np.zeros(vehicles, dtype=np.int64), np.zeros(vehicles, dtype=np.int64)
        self.home = np.full(vehicles, -1, dtype=np.int64)

    def append(self, pairs: _Pairs) -> None:
        """Lists of vehicles that have come to the end of theirs."""
        # Stable: of equals the lower UAV first.
        ordered, before = pairs[np.lexsort((-pairs.liking, pairs.vehicle))], len(self.pairs)
        self.pairs = _Pairs.joined([self.pairs, ordered]) if before else ordered
        first = ordered.firsts()
        whose = ordered.vehicle[first]
        self.place[whose] = before + first
        self.end[whose] = before + np.append(first[1:], len(ordered))[: len(first)]


Listing = Callable[[IntArray, FloatArray], tuple[_Pairs, FloatArray]]
"""Of vehicles [R]: pairs that each likes less than so much [R], the best of them; and the least liking that it has
listed, -inf where there is no more [R]."""


class _Market:
    """Whom UAVs hold, and whom they surely refuse."""

    def __init__(self, demand: FloatArray, capacity: FloatArray) -> None:
        self.demand, self.capacity = demand, capacity
        self.least = np.full(len(capacity), -np.inf)
        """[U] score below which a UAV refuses."""
        self._last = np.full(len(capacity), len(demand), dtype=np.int64)  # at that score: vehicle above which
        self._assignment = np.full(len(demand), -1, dtype=np.int64)
        self._rounds = 0

    def matching(self) -> Matching:
        """The last one."""
        served = np.flatnonzero(self._assignment >= 0)
        load = np.bincount(self._assignment[served], self.demand[served], len(self.capacity))
        return Matching(self._assignment, np.maximum(load - self.capacity, 0.0), self._rounds)

    def match(self, vehicles: IntArray, listing: Listing) -> None:
        """Deferred acceptance among these vehicles, as if there were no others."""
        queue, below = _Queue(len(self.demand)), np.full(len(self.demand), np.inf)
        asking, self._rounds = vehicles, 0
        while len(asking):
            pairs, below[asking] = listing(asking, below[asking])
            queue.append(self._winnowed(pairs))
            self._ask(queue, asking)
            asking = vehicles[(queue.home[vehicles] < 0) & (below[vehicles] > -np.inf)]
        held = np.flatnonzero(queue.home >= 0)
        self._assignment.fill(-1)
        self._assignment[held] = queue.pairs.uav[queue.home[held]]

    def _winnowed(self, pairs: _Pairs) -> _Pairs:
        """Without what is surely refused once everybody has asked the UAV that it likes best.

        Whom a UAV holds depends only on who has asked it, so that to ask it again later changes nothing.
        """
        pairs = pairs[self._are_open(pairs)]
        while len(pairs):
            before, asks = len(pairs), pairs.favourites()
            self._choose(pairs[asks])
            pairs = pairs[self._are_open(pairs)]
            if len(pairs) >= _FEWER * before:
                break
        return pairs

    def _ask(self, queue: _Queue, asking: IntArray) -> None:
        """Let vehicles ask one UAV after the other until all are held or have come to the end of their lists."""
        while True:
            asking = self._pass_over(queue, asking)
            if not len(asking):
                return
            self._rounds += 1
            asked = np.zeros(len(self.capacity), dtype=bool)
            asked[queue.pairs.uav[queue.place[asking]]] = True
            holding = np.flatnonzero(queue.home >= 0)
            holding = holding[asked[queue.pairs.uav[queue.home[holding]]]]
            contenders = np.concatenate([holding, asking])
            wanted = np.concatenate([queue.home[holding], queue.place[asking]])
            held = self._choose(queue.pairs[wanted])
            queue.place[asking] += 1
            queue.home[contenders] = np.where(held, wanted, -1)
            asking = contenders[~held]

    def _pass_over(self, queue: _Queue, asking: IntArray) -> IntArray:
        """Move on behind who surely refuses; those of ``asking`` who have somebody left to ask."""
        moving = asking
        while len(moving):
            moving = moving[queue.place[moving] < queue.end[moving]]
            moving = moving[~self._are_open(queue.pairs[queue.place[moving]])]
            queue.place[moving] += 1
        left: IntArray = asking[queue.place[asking] < queue.end[asking]]
        return left

    def _are_open(self, pairs: _Pairs) -> BoolArray:
        """[P] which pairs fit the capacity and are not surely refused."""
        least = self.least[pairs.uav]
        result: BoolArray = pairs.score > least
        equal = np.flatnonzero(pairs.score == least)
        result[equal] = pairs.vehicle[equal] <= self._last[pairs.uav[equal]]
        result &= self.demand[pairs.vehicle] <= self.capacity[pairs.uav]
        return result

    def _choose(self, asked: _Pairs) -> BoolArray:
        """[P] whom UAVs hold, of all who ask them now (held or new); notes what they refuse from now on."""
        order = np.lexsort((asked.vehicle, -asked.score, asked.uav))
        uav, size = asked.uav[order], self.demand[asked.vehicle[order]]
        running = np.cumsum(size)
        begins = np.flatnonzero(np.diff(uav, prepend=-1))
        base = np.repeat(running[begins] - size[begins], np.diff(begins, append=len(uav)))
        stays = running - size - base < self.capacity[uav]
        # The one that fills a UAV is the last that stays: whoever comes later in its order is refused for good.
        fills = order[stays & (running - base >= self.capacity[uav])]
        self.least[asked.uav[fills]] = asked.score[fills]
        self._last[asked.uav[fills]] = asked.vehicle[fills]
        held = np.empty(len(asked), dtype=bool)
        held[order] = stays
        return held


class _Candidates:
    """Lists candidate pairs, as long as the market has not closed them."""

    def __init__(self, vehicles: VehicleTable, uavs: UavTable, settings: Settings, market: _Market) -> None:
        self._vehicles, self._uavs, self._settings, self._market = vehicles, uavs, settings, market
        self._preferences = Preferences(vehicles, uavs, settings)
        self._standing, self._offer = standing(uavs, settings), offer(vehicles, settings)
        self._most = density(100.0 * (self._offer + settings.qov_weights[3]), vehicles.demand)
        """[V] score of a vehicle at a UAV where it is."""

    def listed(self, rows: IntArray, below: FloatArray) -> tuple[_Pairs, FloatArray]:
        """See `Listing`."""
        found, floor = [_Pairs.none()], np.full(len(rows), -np.inf)
        demand, least = self._vehicles.demand, self._market.least
        for part, columns, near, outside in self._preferences.near(rows, self._may_be_held):
            members = rows[part]
            # QoV/sqrt(RB) and QoU as in `quality`, in the same order of steps.
            score = density(
                100.0 * (self._offer[members, None] + self._settings.qov_weights[3] * near), demand[members, None]
            )
            open_ = (score >= least[columns]) & ~outside
            live = np.flatnonzero(open_.any(axis=1))
            part, members, score, open_ = part[live], members[live], score[live], open_[live]
            liking = 100.0 * (self._standing[columns] + self._settings.qou_weights[3] * near[live])
            open_ &= demand[members, None] <= self._uavs.bandwidth[columns]
            open_ &= (liking > 0.0) & (liking < below[part, None])
            many = np.flatnonzero(open_.sum(axis=1) > _LISTED)
            if len(many):
                of_many = np.where(open_[many], liking[many], -np.inf)
                floor[part[many]] = np.partition(of_many, -_LISTED, axis=1)[:, -_LISTED]
                open_[many] &= liking[many] >= floor[part[many], None]
            high, wide = np.nonzero(open_)
            found.append(
                _Pairs(
                    members[high].astype(np.int32),
                    columns[wide].astype(np.int32),
                    liking[high, wide],
                    score[high, wide],
                )
            )
        return _Pairs.joined(found), floor

    def _may_be_held(self, members: IntArray, columns: IntArray) -> BoolArray:
        """Of vehicles, which one or the other of these UAVs might not refuse."""
        return np.asarray(self._most[members] >= self._market.least[columns].min(initial=np.inf))


def _indices(name: str, values: npt.ArrayLike, count: int) -> Index:
    array = np.asarray(values)
    if array.ndim != 1 or (len(array) and not np.issubdtype(array.dtype, np.integer)):
        raise SelectionError(name, f"{array.dtype} of shape {array.shape}", "whole numbers, one for each pair")
    wrong = (array < 0) | (array >= count)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise SelectionError(f"{name}[{row}]", int(array[row]), f"an index from 0, below {count}")
    return array.astype(np.int32)


def _numbers(name: str, values: npt.ArrayLike, least: float = -np.inf, *, above: bool = False) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise SelectionError(f"{name}.shape", array.shape, "a list of numbers")
    wrong = ~np.isfinite(array) | (array < least) | (above & (array == least))
    if wrong.any():
        row = int(np.argmax(wrong))
        wanted = "a finite number" if np.isinf(least) else f"a finite number {'above' if above else 'of at least'} 0"
        raise SelectionError(f"{name}[{row}]", float(array[row]), wanted)
    return array
