"""Who goes to be charged and who comes back, between two periods, so that a fleet holds out for hours.

Every UAV works out the same plan from the same events of the contract, and moves itself alone (updateUAVZone): a UAV
that leaves does so before proposals open, so that its vehicles choose others, and no link is cut.

A UAV leaves as late as those behind it allow. All UAVs of a charging point share its places; with the order of who can
stay in the air how long, the next ones leave now if otherwise one of the others would find no place in time.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from skyrelay.airspace.charging import FULL
from skyrelay.airspace.law import LATE, Law
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.protocol.dispatch import FLIGHT_COST, Books


def stations(books: Books, law: Law) -> dict[str, int]:
    """The zone that each UAV goes to that is not to stay where it is; 0 to be charged.

    First who leaves and who comes back, then, where the scenario has it, who goes to a neighbouring zone.
    """
    if not (law.places and law.rotates):
        return books.moves(law.grid, law.stride)
    told = books.asked(law.grid, before=True)
    uavs = sorted(uav for uav in books.uav_zone if uav in books.uav_battery)
    if told is None or not uavs:
        return {}
    before = {uav: books.uav_zone[uav] for uav in uavs}
    after = rotate(
        *told,
        np.array(list(before.values()), dtype=np.int64),
        np.array([books.uav_bandwidth[uav] for uav in uavs], dtype=np.float64),
        np.array([books.uav_battery[uav] for uav in uavs], dtype=np.float64),
        np.array([books.uav_place[uav] for uav in uavs], dtype=np.float64).reshape(-1, 2),
        law,
    )
    zones = dict(zip(uavs, after.tolist(), strict=True))
    if law.dispatch:
        zones |= books.moves(law.grid, law.stride, zones)
    return {uav: zone for uav, zone in zones.items() if zone != before[uav]}


def rotate(
    asked: FloatArray,
    mean: float,
    zone: IntArray,
    bandwidth: FloatArray,
    battery: FloatArray,
    place: FloatArray,
    law: Law,
) -> IntArray:
    """Who leaves, and where those who are charged go.

    A place that falls free now is taken a period later, unless a battery cannot wait: who takes over is there before
    the other leaves.

    Args:
        asked: [Z] in each zone, in the order of its ids [kbit/s].
        mean: demand of a vehicle [kbit/s].
        zone: [U] id of each UAV's; 0 for one that is away.
        bandwidth: [U] of each UAV [kbit/s].
        battery: [U] [%].
        place: [U, 2] of each UAV [m].
        law: of the area.
    Returns: [U] id of the zone that each UAV shall fly in; 0 for one that is to be charged.
    """
    point, way = law.way_home(place)
    gain = law.places.gain[point]
    left = _lasts(zone, battery, way, law)
    back = (zone == 0) & (battery + gain * law.period_steps / 2.0 >= FULL)
    after = zone.copy()
    soon: list[int] = []
    for number in range(len(law.places.names)):
        here = np.flatnonzero(point == number)
        queue = sorted(here[zone[here] > 0].tolist(), key=lambda uav: (left[uav], battery[uav], uav))
        away = here[zone[here] == 0]
        slots, pace = _slots(len(here), float(way[here].mean()) if len(here) else 0.0, number, law)
        busy = np.where(back[away], 1, _periods(way[away], battery[away], gain[away], law))
        hold = _periods(way[queue], battery[queue], gain[queue], law)
        grow = float(law.worst / law.places.gain[number])
        count = leaving(left[queue].tolist(), hold.tolist(), grow, busy.tolist(), slots, pace)
        gone = _choose(queue, left, zone, after, count)
        after[gone] = 0
        stay = [row for row, uav in enumerate(queue) if uav not in gone]
        taken = [*busy[~back[away]].tolist(), *(int(hold[queue.index(uav)]) for uav in gone)]
        following = leaving((left[queue] - 1)[stay].tolist(), hold[stay].tolist(), grow, taken, slots, pace)
        soon += [queue[row] for place, row in enumerate(stay) if place < following or left[queue[row]] < 2]
    _send_back(np.flatnonzero(back), soon, after, asked, mean, bandwidth, place, law)
    return after


def leaving(
    left: Sequence[int], hold: Sequence[int], grow: float, busy: Sequence[int], slots: int, pace: int = 1
) -> int:
    """How many of a queue leave now: the fewest with which all others still find a place before they have to go.

    Args:
        left: for how many periods each can stay, the most urgent first.
        hold: for how many each takes a place if it leaves now.
        grow: by how many a period of waiting makes that longer.
        busy: for how many periods those that are away still take theirs.
        slots: how many may be away at a time.
        pace: how many leave in a period at most.
    Returns: where there are too few places for all, as many as are free, and not more than the pace.
    """
    free = max(slots - len(busy), 0)
    most = min(free, pace, len(left))
    return next((count for count in range(most) if _all_find_one(count, left, hold, grow, busy, slots, pace)), most)


def _all_find_one(
    count: int, left: Sequence[int], hold: Sequence[int], grow: float, busy: Sequence[int], slots: int, pace: int
) -> bool:
    """Whether those behind the first ``count``, who leave now, all find a place in time, one after the other."""
    free = max(slots - len(busy), 0)
    frees = [*busy, *hold[:count], *([0] * (free - count))]
    heapq.heapify(frees)
    started: Counter[int] = Counter()
    for last, periods in zip(left[count:], hold[count:], strict=True):
        if not frees:
            return False
        at = max(1, heapq.heappop(frees), max(started, default=1))
        at += started[at] >= pace
        if at > last:
            return False
        started[at] += 1
        heapq.heappush(frees, math.ceil(at + periods + grow * at))
    return True


def _lasts(zone: IntArray, battery: FloatArray, way: FloatArray, law: Law) -> IntArray:
    """[U] for how many periods each battery lasts, with the way to the charging point from wherever it may be then."""
    corners = np.array([law.grid.corner(one) for one in law.grid.ids])
    ends = corners[:, None] + law.grid.side * np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    farthest = law.way_home(ends.reshape(-1, 2))[1].reshape(len(corners), 4).max(axis=1)
    far = np.maximum(way, np.minimum(way + law.period_steps, farthest[np.maximum(zone, 1) - 1]))
    spare = battery - law.energy.reserve - (far + 1 + LATE) * law.cost.move
    periods: IntArray = np.floor(np.maximum(spare, 0.0) / (law.period_steps * law.worst)).astype(np.int64)
    return periods


def _periods(way: FloatArray, battery: FloatArray, gain: FloatArray, law: Law) -> IntArray:
    """[U] how many periods pass until each is charged, its way there included; at least one."""
    steps = way + (FULL - battery + way * law.cost.move) / gain
    periods: IntArray = np.maximum(np.ceil(steps / law.period_steps - 0.5), 1.0).astype(np.int64)
    return periods


def _slots(uavs: int, way: float, number: int, law: Law) -> tuple[int, int]:
    """How many of a charging point's UAVs may be away at a time, and leave in a period: as when all take turns.

    Args:
        uavs: that share it.
        way: to it, on average [steps].
        number: of the point.
    """
    flown = max(FULL - law.energy.reserve - 2.0 * way * law.cost.move, 0.0)
    away = 2.0 * way + flown / law.places.gain[number]
    turn = float(away + flown / law.worst)
    slots = math.ceil(uavs * float(away) / turn)
    return min(int(law.places.places[number]), slots), math.ceil(uavs * law.period_steps / turn)


def _choose(queue: Sequence[int], left: IntArray, zone: IntArray, after: IntArray, count: int) -> list[int]:
    """Who of a queue leaves: all that have to; then the most urgent, but not a zone's last one."""
    gone = [uav for uav in queue if left[uav] < 1]
    there = np.bincount(after)
    np.subtract.at(there, zone[gone], 1)
    for uav in queue[len(gone) :]:
        if len(gone) < count and there[zone[uav]] > 1:
            gone.append(uav)
            there[zone[uav]] -= 1
    return gone


def _send_back(
    back: IntArray,
    soon: Sequence[int],
    after: IntArray,
    asked: FloatArray,
    mean: float,
    bandwidth: FloatArray,
    place: FloatArray,
    law: Law,
) -> None:
    """Each that is charged goes where it adds most to what zones can hold once the next ones have left.

    Args:
        back: rows of those that are charged, which ``after`` is changed for.
        soon: rows of those that leave next.
    """
    stays = after > 0
    stays[list(soon)] = False
    supply = np.bincount(after[stays] - 1, bandwidth[stays], len(asked)).astype(np.float64)
    corners = np.array([law.grid.corner(one) for one in law.grid.ids])
    for uav in sorted(back.tolist(), key=lambda row: (-bandwidth[row], row)):
        inside = np.clip(place[uav], corners, corners + law.grid.side)
        cost = FLIGHT_COST * mean * np.hypot(*(inside - place[uav]).T) / law.stride
        adds = np.minimum(asked, supply + bandwidth[uav]) - np.minimum(asked, supply) - cost
        if adds.max() <= 0.0:
            adds = asked / (supply + mean) - cost / mean  # where most is asked of what there is
        to = int(adds.argmax())
        supply[to] += bandwidth[uav]
        after[uav] = to + 1
