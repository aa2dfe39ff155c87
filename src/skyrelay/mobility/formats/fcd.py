"""SUMO's floating-car data as XML, plain or packed."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import pyarrow as pa

from skyrelay.core.errors import TraceError
from skyrelay.mobility.formats.elements import elements
from skyrelay.mobility.formats.samples import MAX_SAMPLES, Samples, open_bytes

_NEEDED = ("id", "x", "y")


def read_fcd(path: Path) -> Samples:
    """Read `<fcd-export>`; pedestrians and containers are elements of their own and are left out."""
    columns: dict[str, list[str]] = {"time": [], "id": [], "x": [], "y": [], "speed": []}
    time = ""
    with open_bytes(path) as stream:
        for event, element in elements(stream):
            if element.tag == "timestep":
                if event == "start":
                    time = _attribute(element, "time", f"{path}: timestep after {time or 'the beginning'}")
                else:
                    element.clear()  # keeps memory flat over a long trace
            elif element.tag == "vehicle" and event == "start":
                columns["time"].append(time)
                who = f"{path}: timestep {time}: vehicle {element.get('id', '?')[:80]}"
                for name in _NEEDED:
                    columns[name].append(_attribute(element, name, who))
                columns["speed"].append(element.get("speed", ""))
                if len(columns["time"]) > MAX_SAMPLES:
                    raise TraceError(path, f"more than {MAX_SAMPLES} samples", "fewer")
    if not any(columns["speed"]):
        del columns["speed"]
    return Samples(pa.table({name: pa.array(column, pa.string()) for name, column in columns.items()}))


def _attribute(element: Element, name: str, place: str) -> str:
    value = element.get(name)
    if value is None:
        has = ", ".join(element.keys())[:120] or "no attributes"
        raise TraceError(place, has, f"an attribute {name!r} (SUMO: leave it in --fcd-output.attributes)")
    return value
