"""A run folder with plausible contents, made from any movement of vehicles (the real run is tested end to end)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from skyrelay.core.scenario import to_toml, validate
from skyrelay.core.zones import ZoneGrid
from skyrelay.runfolder.figures import over_the_run

METRICS = (
    "step time zone connected vehicles covered coverage connectivity connectivity_neighbor served_mbps energy_percent "
    "static_vehicles static_covered static_coverage static_connectivity static_served_mbps "
    "demand_mbps carried_mbps delivered_mbps static_carried_mbps static_delivered_mbps"
)
VEHICLES = (
    "step vehicle x y zone uav covered static_uav static_covered "
    "demand_kbps carried_kbps delivered_kbps static_carried_kbps static_delivered_kbps"
)

Tracks = dict[str, dict[int, tuple[float, float]]]
"""By vehicle: its position [m] at each step at which it is present."""


def street_tracks(vehicles: int, steps: int, seed: int = 1) -> Tracks:
    """Vehicles on the streets of a 2 km x 2 km grid; a third of them appears late or leaves early."""
    rng = np.random.default_rng(seed)
    tracks: Tracks = {}
    for index in range(vehicles):
        street, along, speed = rng.integers(0, 11) * 200.0, rng.uniform(0, 2000), rng.uniform(8, 28)
        level, sign = rng.random() < 0.5, rng.choice([-1, 1])
        first = int(rng.integers(0, steps // 2 + 1)) if index % 6 == 1 else 0
        last = int(rng.integers(steps // 2, steps + 1)) if index % 6 == 2 else steps
        tracks[f"vehicle_{index:03d}"] = {
            step: (at, street) if level else (street, at)
            for step in range(first, last + 1)
            for at in [float((along + sign * speed * step) % 2000.0)]
        }
    return tracks


def write_run_folder(
    path: Path, tracks: Tracks, *, uavs: int = 12, side: int = 2, period_steps: int = 10, seed: int = 1
) -> Path:
    """Play a simple run on ``tracks`` and record it.

    Vehicles take the nearest UAV of their zone that has room, UAVs follow the middle of their vehicles, and one of them
    lands half-way; the comparator hovers.
    """
    rng = np.random.default_rng(seed)
    steps = max(step for track in tracks.values() for step in track)
    points = np.array([point for track in tracks.values() for point in track.values()])
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    grid = ZoneGrid.over(x0, y0, x1, y1, side, side)
    reach = grid.side / 2
    fleet = [f"uav_{index:02d}" for index in range(uavs)]
    position = np.column_stack([rng.uniform(x0, x1, uavs), rng.uniform(y0, y1, uavs)])
    zone = grid.zone_of(position[:, 0], position[:, 1])
    hovering, hovering_zone = position.copy(), zone.copy()
    battery = rng.uniform(30, 100, uavs)
    demand = {name: int(rng.integers(1000, 4001)) for name in tracks}
    address = {name: f"0x{index:040x}" for index, name in enumerate([*tracks, *fleet])}
    owner: dict[str, int] = {}
    static_owner: dict[str, int] = {}
    vehicle_rows, uav_rows, metric_rows, proposal_rows, event_rows = [], [], [], [], []
    for index, name in enumerate(address):
        kind, role = ("VehicleRegistered", "vehicle") if name in tracks else ("UAVRegistered", "uav")
        event = json.dumps({role: address[name], "reputation": 50})
        event_rows.append((1 + index // 50, index % 50, index, 0, kind, event))
    block = event_rows[-1][0]

    for step in range(steps + 1):
        here = {name: track[step] for name, track in tracks.items() if step in track}
        at = np.array(list(here.values())).reshape(-1, 2)
        zones = dict(zip(here, grid.zone_of(at[:, 0], at[:, 1]).tolist(), strict=True))
        if step % period_steps == 0 and step < steps:
            block += 1
            period = step // period_steps
            proposals = _propose(here, zones, position, zone, demand)
            owner = {row[0]: row[1] for row in proposals if row[3]}
            static_owner = {row[0]: row[1] for row in _propose(here, zones, hovering, hovering_zone, demand) if row[3]}
            for order, (name, uav, qou, accepted) in enumerate(proposals):
                row = (period, 1, zones[name], name, fleet[uav], qou, 5_000_000, 9_000, demand[name], accepted, order)
                proposal_rows.append(row)
                about = {"vehicle": address[name], "uav": address[fleet[uav]], "zone": zones[name], "qov": 2**70}
                event_rows.append((block, order, order, step, "VehSelectionSubmitted", json.dumps(about)))
            block += 1
            for uav in sorted(set(owner.values())):
                chosen = [address[name] for name, served in owner.items() if served == uav]
                told = {"uav": address[fleet[uav]], "zone": int(zone[uav]), "selected": chosen}
                event_rows.append((block, uav, uav, step, "UAVAllocated", json.dumps(told)))
        if step == steps // 2:
            zone[0] = 0
        owner = {name: uav for name, uav in owner.items() if name in here}
        static_owner = {name: uav for name, uav in static_owner.items() if name in here}
        for uav in range(uavs):  # towards the middle of its vehicles, at most 60 m a step
            mine = [here[name] for name, served in owner.items() if served == uav]
            if mine and step:
                way = np.mean(mine, axis=0) - position[uav]
                position[uav] += way * min(1.0, 60.0 / max(float(np.hypot(*way)), 1e-9))
        selected, static_selected = (
            np.isin(np.arange(uavs), list(serving.values())) & (where > 0)
            for serving, where in ((owner, zone), (static_owner, hovering_zone))
        )
        battery = np.maximum(battery - 0.1 - 0.05 * selected, 0)
        covered = _covered(here, owner, position, zone, reach)
        static_covered = _covered(here, static_owner, hovering, hovering_zone, reach)
        for name, (x, y) in here.items():
            pair = [fleet[o[name]] if name in o else "" for o in (owner, static_owner)]
            shown = (covered.get(name, False), static_covered.get(name, False))
            rates = [float(demand[name] * inside) for inside in shown for _ in ("carried", "delivered")]
            place = (step, name, x, y, zones[name], pair[0], shown[0], pair[1], shown[1])
            vehicle_rows.append((*place, demand[name], *rates))
        for uav, name in enumerate(fleet):
            flown = (*position[uav], int(zone[uav]), bool(selected[uav]), battery[uav], 0)
            hovered = (*hovering[uav], int(hovering_zone[uav]), bool(static_selected[uav]))
            uav_rows.append((step, name, *flown, *hovered))
        teams = [one for one in grid.ids if (selected & (zone == one)).any()]
        linked = {one: _linked(position[selected & (zone == one)], reach) for one in teams}
        neighbor = {one: _neighbors(position[selected & (zone == one)], reach) for one in teams}
        static_linked = {one: _linked(hovering[static_selected & (hovering_zone == one)], reach) for one in teams}
        for one in [*teams, 0]:
            ours = [name for name, uav in owner.items() if one in (0, int(hovering_zone[uav]))]
            static_ours = [name for name, uav in static_owner.items() if one in (0, int(hovering_zone[uav]))]
            inside = sum(covered[name] for name in ours)
            static_inside = sum(static_covered[name] for name in static_ours)
            links = [
                values[one] if one else float(np.mean(list(values.values())))
                for values in (linked, neighbor, static_linked)
            ]
            served_mbps = sum(demand[name] for name in ours if covered[name]) / 1000
            static_mbps = sum(demand[name] for name in static_ours if static_covered[name]) / 1000
            asked = sum(demand[name] for name in here if one in (0, zones[name])) / 1000
            metric_rows.append((
                step, step * 2.0, one, sum(one in (0, zones[name]) for name in here), len(ours), inside,
                inside / len(ours) if ours else 1.0, links[0], links[1], served_mbps, float(battery.mean()),
                len(static_ours), static_inside, static_inside / len(static_ours) if static_ours else 1.0, links[2],
                static_mbps, asked, served_mbps, served_mbps, static_mbps, static_mbps,
            ))  # fmt: skip

    path.mkdir(parents=True, exist_ok=True)
    _write(path / "vehicles.parquet", vehicle_rows, VEHICLES)
    _write(
        path / "uavs.parquet", uav_rows,
        "step uav x y zone selected battery action static_x static_y static_zone static_selected",
    )  # fmt: skip
    _write(path / "accounts.parquet", [(*pair, "member") for pair in address.items()], "name address kind")
    _write(
        path / "metrics.parquet", metric_rows,
        METRICS,
    )  # fmt: skip
    _write(
        path / "proposals.parquet",
        proposal_rows,
        "period round zone vehicle uav qou qov score demand_kbps accepted order",
    )
    _write(path / "events.parquet", event_rows, "block tx log step name args")
    (path / "scenario.toml").write_text(
        to_toml(validate({"name": "bologna", "seed": seed, "fleet": {"uavs": uavs}})), encoding="utf-8"
    )
    summary = {
        "name": "bologna", "seed": seed, "vehicles": len(tracks),
        "vehicles_per_period": float(len(tracks)), "uavs": uavs, "zones": side * side,
        "periods": -(-steps // period_steps), "steps": steps,
        "served": len({row[3] for row in proposal_rows if row[9]}),
        "served_per_period": 20.0, "static_served_per_period": 20.0, "uavs_retired": 1, "chain_url": None,
        "mean_qou": float(np.mean([row[5] for row in proposal_rows])), "mean_qov": 58.4,
        **over_the_run(_columns(METRICS, metric_rows), _columns(VEHICLES, vehicle_rows)),
        "transactions": len(event_rows), "gas_used": len(event_rows) * 81_234, "blocks": block,
        "chain_seconds": 3.2, "wall_seconds": 17.8,
        "model_cids": ["bafkreigh2akiscaildcqabsyg3dfr6chu3fgpregiymsck7e7aqa4s52zy"],
        "chain_head": "0x" + "5f3c" * 16, "contract": "0x" + "a1B2" * 10,
        "grid": {"x0": grid.x0, "y0": grid.y0, "side": grid.side, "columns": side, "rows": side},
        "range_m": reach, "step_seconds": 2.0, "period_steps": period_steps,
        "attribution": "Bologna Acosta+Pasubio joined scenario, DLR and contributors, EPL-2.0",
    }  # fmt: skip
    (path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    return path


def _propose(here, zones, position, zone, demand):
    """Each vehicle proposes to its zone's nearest UAV, which takes what fits: [(name, uav, qou, accepted)]."""
    room = np.full(len(position), 16_000)
    proposals = []
    for name, point in here.items():
        distance = np.where(zone == zones[name], np.hypot(*(position - point).T), np.inf)
        uav = int(np.argmin(distance))
        if not np.isfinite(distance[uav]):
            continue
        accepted = bool(room[uav] >= demand[name])
        room[uav] -= demand[name] * accepted
        proposals.append((name, uav, float(100 - distance[uav] / 30), accepted))
    return proposals


def _covered(here, owner, position, zone, reach):
    return {
        name: bool(zone[uav] > 0 and np.hypot(*(position[uav] - here[name])) <= reach) for name, uav in owner.items()
    }


def _linked(points: npt.NDArray[np.float64], reach: float) -> float:
    """1 where the range graph is connected."""
    seen = {0} if len(points) else set()
    while True:
        near = {j for i in seen for j in range(len(points)) if np.hypot(*(points[i] - points[j])) <= reach}
        if near <= seen:
            return float(len(seen) == len(points))
        seen |= near


def _neighbors(points: npt.NDArray[np.float64], reach: float) -> float:
    """1 where every UAV has another one in range."""
    apart = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    return float(len(points) < 2 or bool((np.sum(apart <= reach, axis=1) > 1).all()))


def _columns(names: str, rows: list[tuple[Any, ...]]) -> dict[str, npt.NDArray[Any]]:
    return {name: np.array([row[i] for row in rows]) for i, name in enumerate(names.split())}


def _write(path: Path, rows: list[tuple[Any, ...]], columns: str) -> None:
    pq.write_table(
        pa.table({name: list(column) for name, column in zip(columns.split(), zip(*rows, strict=True), strict=True)}),
        path,
    )
