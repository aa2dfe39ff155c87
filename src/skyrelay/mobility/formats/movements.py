"""Movement files of network simulators: ns-2 (`setdest`) and BonnMotion (way points)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import pyarrow as pa

from skyrelay.core.errors import TraceError
from skyrelay.mobility.formats.samples import MAX_SAMPLES, Samples, open_bytes

EVERY = 1.0
"""Movements are straight lines; they are sampled so often [s], and at each way point."""
MAX_LINE = 16 * 2**20

_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_SET = re.compile(rf"\$node_\((\d+)\)\s+set\s+([XYZ])_\s+{_NUMBER}\s*$")
_MOVE = re.compile(rf"\$ns_\s+at\s+{_NUMBER}\s+\"\$node_\((\d+)\)\s+setdest\s+{_NUMBER}\s+{_NUMBER}\s+{_NUMBER}\"\s*$")
_PLACE = re.compile(rf"\$ns_\s+at\s+{_NUMBER}\s+\"\$node_\((\d+)\)\s+set\s+([XYZ])_\s+{_NUMBER}\"\s*$")

Waypoint = tuple[float, float, float]


def read_ns2(path: Path) -> Samples:
    """Read an ns-2 movement file: where each node starts, and where it heads at which speed from when on.

    A node that is told to move before it has arrived turns where it is by then.
    """
    start: dict[str, dict[str, float]] = {}
    orders: dict[str, list[tuple[float, float, float, float]]] = {}
    jumps: dict[str, list[tuple[float, str, float]]] = {}
    for number, line in _lines(path):
        if not line or line.startswith("#"):
            continue
        if found := _SET.match(line):
            start.setdefault(found[1], {})[found[2]] = float(found[3])
        elif found := _MOVE.match(line):
            orders.setdefault(found[2], []).append((float(found[1]), float(found[3]), float(found[4]), float(found[5])))
        elif found := _PLACE.match(line):
            jumps.setdefault(found[2], []).append((float(found[1]), found[3], float(found[4])))
        elif "node_" in line and ("setdest" in line or " set " in line):
            raise TraceError(f"{path}: line {number}", line[:80], "an ns-2 movement ($ns_ at T ... setdest X Y SPEED)")
    if not start and not orders:
        raise TraceError(path, None, "ns-2 movements: $node_(N) set X_ ..., $ns_ at T ... setdest X Y SPEED")
    if jumps:
        node = next(iter(jumps))
        raise TraceError(f"{path}: node {node}", "set X_ at a later time", "movements by setdest alone")
    ways: dict[str, list[Waypoint]] = {}
    for node, place in start.items():
        if not {"X", "Y"} <= set(place):
            raise TraceError(f"{path}: node {node}", ", ".join(sorted(place)), "set X_ and set Y_")
        ways[node] = _follow((place["X"], place["Y"]), sorted(orders.pop(node, [])))
    if orders:
        raise TraceError(f"{path}: node {next(iter(orders))}", None, "set X_ and set Y_ before it moves")
    end = max(way[-1][0] for way in ways.values())
    for way in ways.values():
        if way[-1][0] < end:  # it stands where it has arrived
            way.append((end, *way[-1][1:]))
    return _sampled(ways, path)


def _follow(place: tuple[float, float], orders: Iterable[tuple[float, float, float, float]]) -> list[Waypoint]:
    """Way points of a node that follows its orders: time, x, y, speed each."""
    x, y = place
    way: list[Waypoint] = [(0.0, x, y)]
    leg: tuple[float, float, float, float, float, float] | None = None  # begin, x, y, arrival, to x, to y
    for time, to_x, to_y, speed in orders:
        if leg is not None:
            x, y = _along(leg, time)
            if leg[3] < time:
                way.append((leg[3], leg[4], leg[5]))
        way.append((time, x, y))
        distance = math.hypot(to_x - x, to_y - y)
        leg = (time, x, y, time + distance / speed, to_x, to_y) if speed > 0 and distance > 0 else None
    if leg is not None:
        way.append(leg[3:])
    return way


def _along(leg: tuple[float, float, float, float, float, float], time: float) -> tuple[float, float]:
    begin, x, y, arrival, to_x, to_y = leg
    share = min(max((time - begin) / (arrival - begin), 0.0), 1.0)
    return x + share * (to_x - x), y + share * (to_y - y)


def read_bonnmotion(path: Path) -> Samples:
    """Read a BonnMotion `.movements` file: a node a line, way points of time, x and y."""
    ways: dict[str, list[Waypoint]] = {}
    for number, line in _lines(path):
        if not line or line.startswith("#"):
            continue
        try:
            values = [float(word) for word in line.split()]
        except ValueError:
            raise TraceError(f"{path}: line {number}", line[:80], "numbers: time x y, for each way point") from None
        if len(values) % 3 or not all(map(math.isfinite, values)):
            raise TraceError(f"{path}: line {number}", f"{len(values)} numbers", "finite triples: time x y")
        way = list(zip(values[::3], values[1::3], values[2::3], strict=True))
        if any(later[0] < earlier[0] for earlier, later in pairwise(way)):
            raise TraceError(f"{path}: line {number}", None, "way points in the order of time")
        ways[str(len(ways))] = way
    if not ways:
        raise TraceError(path, "no node", "a line of way points for each node")
    return _sampled(ways, path)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    with open_bytes(path) as stream:
        for number, line in enumerate(iter(lambda: stream.readline(MAX_LINE), b""), 1):
            yield number, line.decode("utf-8-sig" if number == 1 else "utf-8").strip()


def _sampled(ways: dict[str, list[Waypoint]], path: Path) -> Samples:
    """Samples on the lines between way points, at the way points and `EVERY` second between."""
    times: list[float] = []
    ids: list[str] = []
    xs: list[float] = []
    ys: list[float] = []
    total = sum(max(way[-1][0] - way[0][0], 0.0) / EVERY + len(way) for way in ways.values())
    if not total <= MAX_SAMPLES:
        raise TraceError(path, f"{total:g} seconds of movement", f"at most {MAX_SAMPLES}")
    for node, way in ways.items():
        last = -math.inf
        for (begin, x, y), (end, to_x, to_y) in zip(way, [*way[1:], way[-1]], strict=True):
            count = max(math.ceil((end - begin) / EVERY), 1)
            for step in range(count):
                share = step / count
                time = begin + share * (end - begin)
                if time > last:
                    times.append(time)
                    ids.append(node)
                    xs.append(x + share * (to_x - x))
                    ys.append(y + share * (to_y - y))
                    last = time
    return Samples(pa.table({"time": times, "id": pa.array(ids, pa.string()), "x": xs, "y": ys}))
