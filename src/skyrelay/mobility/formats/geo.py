"""Tracks of receivers: GPX and GeoJSON, in degrees."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from skyrelay.core.errors import TraceError
from skyrelay.core.untrusted import read_json
from skyrelay.mobility.formats.elements import elements
from skyrelay.mobility.formats.samples import MAX_SAMPLES, Samples, open_bytes

Row = tuple[str | float, str, float, float]


def read_gpx(path: Path) -> Samples:
    """Read GPX: a track is a vehicle, by its name or its number in the file."""
    rows: list[Row] = []
    track, name, point, time = 0, "", None, ""
    with open_bytes(path) as stream:
        for event, element in elements(stream):
            tag = element.tag.rpartition("}")[2]
            if event == "start":
                if tag == "trk":
                    track, name = track + 1, ""
                elif tag == "trkpt":
                    point, time = (element.get("lon"), element.get("lat")), ""
                continue
            if tag == "name" and point is None:
                name = (element.text or "").strip()
            elif tag == "time" and point is not None:
                time = (element.text or "").strip()
            elif tag == "trkpt" and point is not None:
                place = f"{path}: track {name or track}: point {len(rows) + 1}"
                rows.append((_present(time, place, "a time"), name or str(track), *_degrees(*point, place=place)))
                point = None
                if len(rows) > MAX_SAMPLES:
                    raise TraceError(path, f"more than {MAX_SAMPLES} points", "fewer")
            elif tag == "trk":
                element.clear()
    return _samples(rows, path, "tracks (<trk>) of points with a time")


def read_geojson(path: Path) -> Samples:
    """Read GeoJSON: a LineString is a vehicle with its times beside it; a Point is one sample with id and time."""
    try:
        tree = read_json(path)
    except ValueError as error:
        raise TraceError(path, None, f"a GeoJSON file ({error})") from error
    rows: list[Row] = []
    features = tree.get("features") if isinstance(tree, dict) else None
    if not isinstance(features, list):
        raise TraceError(path, None, "a GeoJSON FeatureCollection")
    for number, feature in enumerate(features):
        rows.extend(_feature(feature, number, path))
        if len(rows) > MAX_SAMPLES:
            raise TraceError(path, f"more than {MAX_SAMPLES} points", "fewer")
    return _samples(rows, path, "LineStrings with coordTimes, or Points with id and time")


def _feature(feature: Any, number: int, path: Path) -> Iterator[Row]:
    place = f"{path}: features[{number}]"
    try:
        geometry, properties = feature["geometry"], feature.get("properties") or {}
        kind, coordinates = geometry["type"], geometry["coordinates"]
    except (KeyError, TypeError, AttributeError):
        raise TraceError(place, None, "a feature with a geometry") from None
    who = feature.get("id", properties.get("id", properties.get("name")))
    if kind == "LineString":
        nested = properties.get("coordinateProperties")
        times = properties.get("coordTimes", properties.get("times"))
        if times is None and isinstance(nested, dict):
            times = nested.get("times")
        if not isinstance(times, list) or not isinstance(coordinates, list) or len(times) != len(coordinates):
            raise TraceError(place, None, "properties.coordTimes, a time for each coordinate")
        for time, pair in zip(times, coordinates, strict=True):
            yield _row(time, str(number) if who is None else str(who), pair, place)
    elif kind == "Point":
        time = properties.get("time", properties.get("timestamp"))
        if who is None:
            raise TraceError(place, None, "an id of the vehicle")
        yield _row(time, str(who), coordinates, place)
    else:
        raise TraceError(f"{place}: geometry", kind, "a LineString or a Point")


def _row(time: Any, who: str, pair: Any, place: str) -> Row:
    if isinstance(time, bool) or not isinstance(time, str | int | float):
        raise TraceError(place, time, "a time, ISO 8601 or a number")
    if not isinstance(pair, list) or len(pair) < 2:
        raise TraceError(place, None, "coordinates [longitude, latitude]")
    return (time, who, *_degrees(pair[0], pair[1], place=place))


def _degrees(longitude: Any, latitude: Any, place: str) -> tuple[float, float]:
    try:
        return float(longitude), float(latitude)
    except (TypeError, ValueError):
        raise TraceError(place, f"{longitude}, {latitude}", "a longitude and a latitude [degrees]") from None


def _present(value: str, place: str, what: str) -> str:
    if not value:
        raise TraceError(place, None, what)
    return value


def _samples(rows: list[Row], path: Path, expected: str) -> Samples:
    if not rows:
        raise TraceError(path, "no point", expected)
    time, who, x, y = zip(*rows, strict=True)
    times = pa.array([str(value) for value in time], pa.string())
    return Samples(pa.table({"time": times, "id": pa.array(who, pa.string()), "x": x, "y": y}), geographic=True)
