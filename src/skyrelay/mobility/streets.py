"""Streets for the page: lines from a SUMO network or a GeoJSON file, in the plane of a run's vehicles."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from io import BufferedIOBase
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np

from skyrelay.core.entities import FloatArray
from skyrelay.core.errors import ScenarioError
from skyrelay.core.untrusted import MAX_JSON, parse_json
from skyrelay.mobility.formats.elements import elements
from skyrelay.mobility.formats.samples import open_bytes
from skyrelay.mobility.plane import WGS84, between, utm

KEY = "map.streets"
MAX_NETWORK = 512 * 2**20
"""Longest SUMO network that is read, unpacked [bytes]."""
MAX_PARTS = 100_000
"""Elements within one edge or junction."""
MAX_LINES = 2_000_000
"""Of a file; those outside of the area are left out afterwards."""
MAX_POINTS = 400_000
"""Of the streets in the area: with more of them the page's header would be too long."""
_UTM = re.compile(r"\+proj=utm\s+\+zone=(\d{1,2})(\s+\+south)?(\s|$)")

Box = tuple[float, float, float, float]
Lines = list[FloatArray]
"""Each [P, 2]: the corners of a street, P of at least 2."""


def read_streets(path: Path, box: Box, plane: int | None = None) -> Lines:
    """The streets in an area.

    A SUMO network is in the metres of its floating-car data, or is brought into ``plane`` by its own ``<location>``.
    GeoJSON is in degrees where the vehicles were and no coordinate is beyond their bounds; otherwise in the area's
    metres.

    Args:
        path: a ``.net.xml`` or ``.geojson`` file, perhaps with ``.gz`` after it.
        box: the area's smallest x and y, largest x and y [m].
        plane: the EPSG code of the area's metres; None where it is not known.
    Raises:
        ScenarioError: the file cannot be read, is too large or deep, has no line, or none in the area.
    """
    endings = "".join(path.suffixes).lower().removesuffix(".gz")
    if not endings.endswith((".net.xml", ".geojson", ".json")):
        raise ScenarioError(KEY, str(path), "a file that ends in .net.xml or .geojson (or .gz after)")
    try:
        if not path.is_file():
            raise ScenarioError(KEY, str(path), "a file that exists")
        with open_bytes(path) as stream:
            lines = (_network if endings.endswith(".net.xml") else _geojson)(stream, path, plane)
    except (OSError, ParseError, EOFError, ValueError, OverflowError, MemoryError) as error:
        reason = " ".join(str(error).split())[:120]
        raise ScenarioError(f"{KEY}: {path}", None, f"streets that can be read ({reason})") from error
    if not lines:
        raise ScenarioError(f"{KEY}: {path}", "no line", "at least one street")
    return _in_area(lines, path, box)


def _in_area(lines: Lines, path: Path, box: Box) -> Lines:
    """Those that reach into the area or pass near it, to the centimetre."""
    lengths = np.array([len(line) for line in lines])
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    points = np.concatenate(lines)
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
    margin = 0.1 * max(box[2] - box[0], box[3] - box[1])
    reach = (high >= np.array(box[:2]) - margin).all(axis=1) & (low <= np.array(box[2:]) + margin).all(axis=1)
    # In degrees or another projection all of a city is a speck, or elsewhere.
    if not (reach & ((high - low).max(axis=1) >= 1.0)).any():
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        raise ScenarioError(
            f"{KEY}: {path}",
            f"at x {x0:.6g} to {x1:.6g}, y {y0:.6g} to {y1:.6g}",
            f"streets in the run's area, x {box[0]:.6g} to {box[2]:.6g} m and y {box[1]:.6g} to {box[3]:.6g} m",
        )
    if (count := int(lengths[reach].sum())) > MAX_POINTS:
        raise ScenarioError(f"{KEY}: {path}", f"{count:,} corners in the area", f"at most {MAX_POINTS:,}")
    return [np.round(lines[row], 2) for row in np.flatnonzero(reach)]


# SUMO


class _Bounded:
    """A stream that gives no more than so many bytes: what is packed may be a thousand times longer."""

    def __init__(self, stream: BufferedIOBase, most: int) -> None:
        self._stream, self._left, self._most = stream, most, most

    def read(self, size: int = -1) -> bytes:
        chunk = self._stream.read(size if 0 <= size <= self._left else self._left + 1)
        self._left -= len(chunk)
        if self._left < 0:
            raise ValueError(f"more than {self._most:,} bytes")
        return chunk


def _network(stream: BufferedIOBase, path: Path, plane: int | None) -> Lines:
    """The middle lane of every edge that is not inside a junction, or the edge's own shape."""
    lines: Lines = []
    location: Element | None = None
    depth = parts = 0
    for event, element in elements(_Bounded(stream, MAX_NETWORK)):
        depth += 1 if event == "start" else -1
        parts += event == "start"
        if parts > MAX_PARTS:
            raise ValueError(f"more than {MAX_PARTS:,} elements within one")
        if event == "start" and depth == 1:
            root = element
            if root.tag != "net":
                raise ValueError(f"a root element <net>, not <{root.tag[:40]}>")
        if event != "end" or depth != 1:
            continue
        if element.tag == "location":
            location = element
        elif element.tag == "edge" and element.get("function", "normal") == "normal":
            line = _edge(element, path)
            if line is not None:
                lines.append(line)
                if len(lines) > MAX_LINES:
                    raise ValueError(f"more than {MAX_LINES:,} edges")
        root.clear()  # keeps memory flat over a large city
        parts = 0
    return lines if plane is None or not lines else _placed(lines, location, path, plane)


def _edge(edge: Element, path: Path) -> FloatArray | None:
    lanes = [shape for lane in edge.iter("lane") if (shape := lane.get("shape"))]
    text = lanes[len(lanes) // 2] if lanes else edge.get("shape")
    if not text:
        return None
    try:
        corners = [[float(part) for part in corner.split(",")[:2]] for corner in text.split()]
        return _line(corners)
    except ValueError:
        who = f"{KEY}: {path}: edge {edge.get('id', '?')[:80]}: shape"
        raise ScenarioError(who, text[:60], "finite coordinates x,y of two corners or more [m]") from None


def _placed(lines: Lines, location: Element | None, path: Path, plane: int) -> Lines:
    """A network's metres in another plane, by its offset and projection."""
    parameters = "" if location is None else location.get("projParameter", "")
    found = _UTM.search(parameters)
    place = f"{KEY}: {path}: location"
    if location is None or found is None or not 1 <= int(found[1]) <= 60:
        expected = "+proj=utm and its zone, as the vehicles' degrees were projected"
        raise ScenarioError(f"{place}: projParameter", parameters[:80] or None, expected)
    try:
        (offset,) = [[float(part) for part in location.get("netOffset", "").split(",")]]
        east, north = offset
    except ValueError:
        raise ScenarioError(f"{place}: netOffset", location.get("netOffset"), "x,y [m]") from None
    source = utm(int(found[1]), south=bool(found[2]))
    return _between(source, plane, [line - (east, north) for line in lines])


# GeoJSON


def _geojson(stream: BufferedIOBase, path: Path, plane: int | None) -> Lines:
    """Every LineString and MultiLineString; what is no line is left out."""
    tree = parse_json(stream.read(MAX_JSON + 1))
    features = tree.get("features") if isinstance(tree, dict) else None
    if not isinstance(features, list):
        raise ScenarioError(f"{KEY}: {path}", None, "a GeoJSON FeatureCollection")
    lines: Lines = []
    for number, feature in enumerate(features):
        try:
            lines.extend(map(_line, _parts(feature)))
        except (TypeError, ValueError, KeyError, OverflowError):
            place = f"{KEY}: {path}: features[{number}]"
            raise ScenarioError(place, None, "a geometry with finite coordinates of two corners or more") from None
    geographic = all((np.abs(line) <= (180.0, 90.0)).all() for line in lines)
    return _between(WGS84, plane, lines) if plane is not None and geographic and lines else lines


def _parts(feature: Any) -> Iterable[Any]:
    geometry = feature["geometry"]
    if geometry is None:
        return []
    kind = geometry["type"]
    if kind == "LineString":
        return [geometry["coordinates"]]
    return geometry["coordinates"] if kind == "MultiLineString" else []


# Both


def _line(corners: Any) -> FloatArray:
    """[P, 2]; a third coordinate, the height, is left out.

    Raises:
        ValueError, TypeError: it is none.
    """
    if not isinstance(corners, list) or len(corners) < 2:
        raise ValueError("two corners or more")
    flat = list(_pairs(corners))
    line = np.array(flat, dtype=np.float64)
    if not np.isfinite(line).all() or np.abs(line).max() > 1e8:
        raise ValueError("finite coordinates")
    return line


def _pairs(corners: list[Any]) -> Iterator[tuple[float, float]]:
    for corner in corners:
        x, y = corner[:2]
        if not {type(x), type(y)} <= {int, float}:  # true is no number
            raise TypeError("numbers")
        yield float(x), float(y)


def _between(source: int, target: int, lines: Lines) -> Lines:
    """Lines of one EPSG code in another; those that it has no place for are left out."""
    points = np.concatenate(lines)
    placed = np.column_stack(between(source, target, points[:, 0], points[:, 1]))
    ends = np.cumsum([len(line) for line in lines])[:-1]
    return [line for line in np.split(placed, ends) if np.isfinite(line).all()]
