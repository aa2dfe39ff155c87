"""The run as the replay page carries it: typed arrays, deflated, in base64.

Layout after inflation: a little-endian uint32 (bytes of the header), the header as JSON, then the arrays, each at a
multiple of four bytes; ``header.arrays`` names each one's type, offset (from the end of the header's padding) and
length. Positions are 16-bit steps across ``header.box`` (3 cm on a city of 2 km), stored as differences (modulo 2**16)
because those of a moving vehicle deflate well.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from skyrelay.core.errors import RunFolderError
from skyrelay.core.resolved import charging_points
from skyrelay.core.untrusted import parse_json
from skyrelay.report.alerts import alerts
from skyrelay.runfolder.feed import PAD, arguments_of
from skyrelay.runfolder.reader import MAX_TEXT, Run

COLOURS = 8
"""Of the page's palette; the figures and the page's style sheet hold as many."""

_METRICS = (
    "vehicles",
    "covered",
    "coverage",
    "connectivity",
    "connectivity_neighbor",
    "carried_mbps",
    "delivered_mbps",
    "energy_percent",
    "static_coverage",
    "static_connectivity",
    "static_carried_mbps",
    "in_range_share",
    "static_in_range_share",
)
_TYPES = {"u1": "Uint8Array", "u2": "Uint16Array", "i4": "Int32Array", "f4": "Float32Array"}


def encode(run: Run) -> str:
    """The payload of the page, in base64. The same run gives the same text."""
    header, arrays = _contents(run)
    blob, described = bytearray(), {}
    for name, array in arrays.items():
        little = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<"), copy=False)
        described[name] = [_TYPES[array.dtype.str[1:]], len(blob), array.size]
        blob += little.tobytes()
        blob += bytes(-len(blob) % 4)
    text = json.dumps(header | {"arrays": described}, allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % 4)
    return base64.b64encode(zlib.compress(len(text).to_bytes(4, "little") + text + bytes(blob), 9)).decode("ascii")


def _contents(run: Run) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    summary, grid = run.summary, run.grid
    fleet = sorted(set(run.uavs["uav"]))
    vehicle_ids = sorted(set(run.vehicles["vehicle"]) | set(run.proposals["vehicle"]))
    low_x, high_x = _extent(grid.x0, grid.side * grid.columns, run.vehicles["x"], run.uavs["x"], run.uavs["static_x"])
    low_y, high_y = _extent(grid.y0, grid.side * grid.rows, run.vehicles["y"], run.uavs["y"], run.uavs["static_y"])
    arrays: dict[str, npt.NDArray[Any]] = {}

    # Vehicles: one track after the other, each in the order of its steps.
    vehicle = _codes(run.vehicles["vehicle"], vehicle_ids)
    order = np.lexsort((run.vehicles["step"], vehicle))
    arrays["vehicle"] = vehicle[order]
    arrays["vehicle_step"] = run.vehicles["step"][order].astype(np.int32)
    arrays["vehicle_x"] = _quantised(run.vehicles["x"][order], low_x, high_x)
    arrays["vehicle_y"] = _quantised(run.vehicles["y"][order], low_y, high_y)
    for name in ("uav", "static_uav"):
        arrays[f"vehicle_{name}"] = _codes(run.vehicles[name], fleet)[order]
    for name in ("covered", "static_covered"):
        arrays[f"vehicle_{name}"] = run.vehicles[name][order].astype(np.uint8)
    for name in ("demand", "carried", "delivered", "static_carried", "static_delivered"):
        arrays[f"vehicle_{name}"] = np.rint(run.vehicles[f"{name}_kbps"][order]).astype(np.int32)

    # UAVs: [uavs, steps + 1]; state bit 0 where it is in the air, bit 1 where it is selected.
    shape = (len(fleet), summary.steps + 1)
    uav, step = _codes(run.uavs["uav"], fleet), run.uavs["step"]
    for name, low, high in (
        ("x", low_x, high_x),
        ("y", low_y, high_y),
        ("static_x", low_x, high_x),
        ("static_y", low_y, high_y),
    ):
        positions = np.full(shape, low)
        positions[uav, step] = run.uavs[name]
        arrays[f"uav_{name}"] = _quantised(positions.ravel(), low, high)
    for kind in ("", "static_"):
        zone, selected = run.uavs[f"{kind}zone"], run.uavs[f"{kind}selected"]
        state = np.where(zone > 0, 1 + 2 * selected.astype(np.uint8), 0)  # zone 0: it has landed
        arrays[f"uav_{kind}zone"] = _dense(shape, uav, step, zone, np.int32)
        arrays[f"uav_{kind}state"] = _dense(shape, uav, step, state, np.uint8)
    arrays["uav_battery"] = _dense(shape, uav, step, run.uavs["battery"], np.float32)

    # Metrics: [zones that ever had a team, steps + 1], the whole area (0) first.
    zones = np.union1d([0], run.metrics["zone"])
    place = np.searchsorted(zones, run.metrics["zone"])
    for name in _METRICS:
        values = np.full((len(zones), summary.steps + 1), np.nan, np.float32)
        values[place, run.metrics["step"]] = _in_range(run, name) if name.endswith("_share") else run.metrics[name]
        arrays[f"metric_{name}"] = values.ravel()

    proposals = run.proposals
    arrays["proposal_period"] = proposals["period"].astype(np.int32)
    arrays["proposal_vehicle"] = _codes(proposals["vehicle"], vehicle_ids)
    arrays["proposal_uav"] = _codes(proposals["uav"], fleet)
    arrays["proposal_qou"] = proposals["qou"].astype(np.float32)
    arrays["proposal_demand"] = proposals["demand_kbps"].astype(np.int32)
    arrays["proposal_accepted"] = proposals["accepted"].astype(np.uint8)

    # Events in the order of the chain, which is that of their steps as well.
    events = run.events
    order = np.lexsort((events["log"], events["tx"], events["block"]))
    names = sorted(set(events["name"]))
    names_of = dict(zip(run.accounts["address"], run.accounts["name"], strict=True))
    arrays["event_block"] = events["block"][order].astype(np.int32)
    arrays["event_step"] = np.maximum.accumulate(events["step"][order].astype(np.int32))
    arrays["event_name"] = _codes(events["name"], names)[order]

    # Streets: one line after the other, from the box's corner.
    arrays["street_length"] = np.unique(run.streets["street"], return_counts=True)[1].astype(np.int32)
    arrays["street_x"] = (run.streets["x"] - low_x).astype(np.float32)
    arrays["street_y"] = (run.streets["y"] - low_y).astype(np.float32)

    header = {
        "steps": summary.steps,
        "stepSeconds": summary.step_seconds,
        "periodSteps": summary.period_steps,
        "range": summary.range_m,
        "grid": summary.grid.model_dump(),
        "buildings": [
            {"corners": [value for corner in building.polygon for value in corner], "height": building.height}
            for building in run.scenario.obstacles.buildings
        ],
        "charging": _charging(run),
        "places": bool(charging_points(run.scenario, run.grid)),
        "alerts": [[step, *alert] for step, alert in alerts(run)],
        "box": [low_x, low_y, high_x, high_y],
        "vehicles": vehicle_ids,
        "uavs": fleet,
        "metricZones": zones.tolist(),
        "colours": _colours(
            *(
                np.hstack([arrays[f"uav_{name}"].reshape(shape), arrays[f"uav_static_{name}"].reshape(shape)])
                for name in ("zone", "state")
            )
        ),
        "eventNames": names,
        "eventArgs": [event_arguments(run, int(row), names_of) for row in order],
    }
    return header, arrays


def _in_range(run: Run, name: str) -> npt.NDArray[np.float64]:
    """Of all connected vehicles, the share that is in range of its UAV, by row of the metrics; NaN of none."""
    covered = run.metrics["static_covered" if name.startswith("static") else "covered"]
    shares: npt.NDArray[np.float64] = np.full(len(covered), np.nan)
    np.divide(covered, run.metrics["connected"], out=shares, where=run.metrics["connected"] > 0)
    return shares


def _charging(run: Run) -> dict[str, Any] | None:
    """Where charging points are, and their radius [m]; None where there are none."""
    energy, grid = run.scenario.energy, run.grid
    if places := charging_points(run.scenario, grid):
        return {"points": [[place.x, place.y] for place in places], "radius": PAD}
    if energy.charge_per_minute == 0:
        return None
    offset = np.array(energy.charging_point) * grid.side
    return {
        "points": [(np.array(grid.corner(zone)) + offset).tolist() for zone in grid.ids],
        "radius": energy.charging_radius,
    }


def _extent(origin: float, length: float, *columns: npt.NDArray[np.float64]) -> tuple[float, float]:
    """The grid's and every position's bounds along one axis [m]."""
    values = np.concatenate([[origin, origin + length], *columns])
    return float(values.min()), float(values.max())


def _quantised(values: npt.NDArray[np.float64], low: float, high: float) -> npt.NDArray[np.uint16]:
    """Differences, modulo 2**16, of ``values`` as 16-bit steps from ``low`` to ``high``."""
    steps = np.rint((values - low) / (high - low) * 65535).astype(np.uint16)
    differences: npt.NDArray[np.uint16] = np.diff(steps, prepend=np.uint16(0))
    return differences


def _codes(column: npt.NDArray[Any], names: Sequence[str]) -> npt.NDArray[np.int32]:
    """Each text's place among ``names``; -1 for the empty text."""
    place = {"": -1} | {name: index for index, name in enumerate(names)}
    return np.array([place[name] for name in column], dtype=np.int32)


def _dense(
    shape: tuple[int, int], uav: npt.NDArray[np.int32], step: npt.NDArray[Any], values: npt.NDArray[Any], kind: type
) -> npt.NDArray[Any]:
    dense: npt.NDArray[Any] = np.zeros(shape, kind)
    dense[uav, step] = values
    return dense.ravel()


def _colours(zone: npt.NDArray[np.int32], state: npt.NDArray[np.uint8]) -> list[int]:
    """By UAV, a colour that no team-mate has, as long as there are colours; the least used one first."""
    used = [0] * COLOURS
    colours: list[int] = []
    selected = state >= 2
    for uav in range(len(zone)):
        mates = {
            colours[other]
            for other in range(uav)
            if (selected[uav] & selected[other] & (zone[uav] == zone[other])).any()
        }
        free = [colour for colour in range(COLOURS) if colour not in mates] or list(range(COLOURS))
        colour = min(free, key=lambda index: (used[index], index))
        used[colour] += 1
        colours.append(colour)
    return colours


def event_arguments(run: Run, row: int, names: Mapping[str, str]) -> list[str]:
    """An event's arguments as text: name, value, name, value...; an account is called by its name."""
    place = f"{run.path / 'events.parquet'}: args[{row}]"
    text = run.events["args"][row]
    try:
        arguments = parse_json(text, size=MAX_TEXT)
    except ValueError as error:
        raise RunFolderError(place, text, f"JSON ({error})") from error
    if not isinstance(arguments, dict):
        raise RunFolderError(place, text, "a JSON object")
    return arguments_of(arguments, names)
