"""The metrics and the summary of a run against its tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skyrelay.airspace import flight as rules
from skyrelay.airspace.law import Law
from skyrelay.audit.tables import Compared, Table
from skyrelay.chain.client import QOV_UNIT
from skyrelay.protocol.history import History
from skyrelay.runfolder.figures import over_charging, over_the_run
from skyrelay.runfolder.schema import Summary

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
ROUNDING = 1e-4
"""Of figures that are worked out again from tables in single precision."""
EDGE = 0.05
"""So near to the edge of a range [m] single precision cannot tell the sides apart."""


@dataclass(frozen=True)
class _Fleet:
    """One fleet over the run: [steps + 1, U] each."""

    x: Floats
    y: Floats
    zone: Ints
    selected: Bools


def check_metrics(
    compared: Compared,
    metrics: Table,
    vehicles: Table,
    uavs: Table,
    law: Law,
    told: History,
    demands: Mapping[str, int],
    clock: tuple[int, float],
) -> None:
    """What each vehicle gets, and every row of the metrics, worked out from who was where and served by whom.

    Args:
        demands: of the vehicles that were there when a selection began, by name [kbit/s].
        clock: steps of a period, seconds of a step.
    """
    period_steps, step_seconds = clock
    file = "metrics.parquet"
    steps = int(uavs["step"].max(initial=0))
    numbers = {name: number for number, name in enumerate(dict.fromkeys(uavs["uav"]))}
    place = (uavs["step"], np.array([numbers[name] for name in uavs["uav"]], dtype=np.int64))

    def over_time(name: str, kind: type) -> npt.NDArray[Any]:
        values: npt.NDArray[Any] = np.zeros((steps + 1, len(numbers)), dtype=kind)
        values[place] = uavs[name]
        return values

    mbps = _check_demands(compared, vehicles, demands) / 1000
    bandwidths = {name: row["bandwidth_kbps"] for period in told.periods for name, row in period.fleet.items()}
    available = np.array([bandwidths.get(name, 0) for name in numbers], dtype=np.float64)
    battery = over_time("battery", float)
    fleets: dict[str, _Fleet] = {}
    teams: dict[str, Ints] = {}
    for kind in ("", "static_"):
        fleet = fleets[kind] = _Fleet(
            over_time(f"{kind}x", float),
            over_time(f"{kind}y", float),
            over_time(f"{kind}zone", int),
            over_time(f"{kind}selected", bool),
        )
        owner = np.array([numbers.get(name, -1) for name in vehicles[f"{kind}uav"]], dtype=np.int64)
        teams[kind] = np.where(owner >= 0, _stations(fleet.zone)[vehicles["step"], owner], 0)
        _check_covered(compared, vehicles, kind, owner, fleet, law)
        _check_carried(compared, vehicles, kind, owner, fleet, law, available)

    compared.count(f"rows of {file}", len(metrics["step"]))
    whole = metrics["step"][metrics["zone"] == 0].tolist()
    if whole != list(range(steps + 1)):
        compared.differs(file, "zone 0", "other steps", f"a row for each of the steps 0 to {steps}, in order")
    taken = []
    for step in range(steps + 1):
        number = max(step - 1, 0) // period_steps
        teams_then = set(told.periods[number].served_at(step).values())
        taken.append(Counter(told.station(uav, number * period_steps) for uav in teams_then))
    order = np.argsort(vehicles["step"], kind="stable")
    bounds = np.searchsorted(vehicles["step"][order], np.arange(steps + 2))
    linked = _teams_linked(compared, metrics, taken)
    for row, (step, zone) in enumerate(zip(metrics["step"].tolist(), metrics["zone"].tolist(), strict=True)):
        here = order[bounds[step] : bounds[step + 1]]
        inside = here[vehicles["zone"][here] == zone] if zone else here
        expected = {
            "time": step * step_seconds,
            "connected": float(len(inside)),
            "demand_mbps": float(mbps[inside].sum()),
        }
        for kind, team in teams.items():
            mine = here[team[here] == zone] if zone else here[team[here] > 0]
            reached = mine[vehicles[f"{kind}covered"][mine]]
            expected[f"{kind}vehicles"], expected[f"{kind}covered"] = len(mine), len(reached)
            expected[f"{kind}served_mbps"] = float(mbps[reached].sum())
            for rate in ("carried", "delivered"):
                expected[f"{kind}{rate}_mbps"] = float(vehicles[f"{kind}{rate}_kbps"][mine].sum()) / 1000
            if kind == "" or len(mine):  # a hovering fleet without a team in a zone has no coverage there
                expected[f"{kind}coverage"] = len(reached) / len(mine) if len(mine) else 1.0
        air = (fleets[""].zone[step] == zone) if zone else (fleets[""].zone[step] > 0)
        if air.any():
            expected["energy_percent"] = float(battery[step][air].mean())
        if zone:
            _check_links(compared, metrics, row, fleets[""], law.reach)
        else:
            pairs = linked.get(step, [(1.0, 1.0)])
            expected["connectivity"], expected["connectivity_neighbor"] = np.mean(pairs, axis=0).tolist()
        for column, value in expected.items():
            if not abs(metrics[column][row] - value) <= ROUNDING:
                compared.differs(file, f"step {step}, zone {zone}: {column}", metrics[column][row], value)


def _teams_linked(
    compared: Compared, metrics: Table, taken: Sequence[Counter[int]]
) -> dict[int, list[tuple[float, float]]]:
    """By step, both measures of each team of two or more UAVs, as its zone's row has them."""
    linked: dict[int, list[tuple[float, float]]] = {}
    shown: dict[int, list[int]] = {}
    both = zip(metrics["connectivity"].tolist(), metrics["connectivity_neighbor"].tolist(), strict=True)
    for step, zone, pair in zip(metrics["step"].tolist(), metrics["zone"].tolist(), both, strict=True):
        shown.setdefault(step, []).append(zone)
        if zone and taken[min(step, len(taken) - 1)][zone] > 1:
            linked.setdefault(step, []).append(pair)
    for step, zones in shown.items():
        wanted = sorted({0, *taken[min(step, len(taken) - 1)]})
        if sorted(zones) != wanted:
            compared.differs("metrics.parquet", f"step {step}", f"zones {sorted(zones)}", wanted)
    return linked


def _stations(zone: Ints) -> Ints:
    """[steps + 1, U] the zone that each UAV has, or had when it landed."""
    last = np.where(zone > 0, np.arange(len(zone))[:, None], 0)
    stations: Ints = np.take_along_axis(zone, np.maximum.accumulate(last, axis=0), axis=0)
    return stations


def _check_covered(compared: Compared, vehicles: Table, kind: str, owner: Ints, fleet: _Fleet, law: Law) -> None:
    """Covered is who is in range of the own UAV, in the air, and in its sight."""
    step = vehicles["step"]
    x, y = fleet.x[step, owner], fleet.y[step, owner]
    apart = np.hypot(vehicles["x"] - x, vehicles["y"] - y)
    inside = (owner >= 0) & (fleet.zone[step, owner] > 0) & (apart <= law.reach)
    unsure = np.abs(apart - law.reach) <= EDGE
    if law.walls is not None:
        rows = np.flatnonzero(inside)
        ground, above = np.column_stack([vehicles["x"], vehicles["y"]]), np.column_stack([x, y])
        seen = [
            rules.in_sight(ground[rows] + offset, above[rows], law.walls)
            for offset in ((0.0, 0.0), (EDGE, EDGE), (-EDGE, EDGE), (EDGE, -EDGE), (-EDGE, -EDGE))
        ]
        inside[rows] = seen[0]
        unsure[rows] |= np.any(seen, axis=0) & ~np.all(seen, axis=0)
    for row in np.flatnonzero((inside != vehicles[f"{kind}covered"]) & ~unsure).tolist():
        place = f"step {step[row]}, vehicle {vehicles['vehicle'][row]}: {kind}covered"
        compared.differs("vehicles.parquet", place, not inside[row], bool(inside[row]))


def _check_demands(compared: Compared, vehicles: Table, demands: Mapping[str, int]) -> Floats:
    """What each row's vehicle asks for [kbit/s]: what it is known to ask for, or else what its first row has."""
    known = dict(demands)
    asked = vehicles["demand_kbps"].tolist()
    wanted = [known.setdefault(name, demand) for name, demand in zip(vehicles["vehicle"], asked, strict=True)]
    for row in np.flatnonzero(vehicles["demand_kbps"] != wanted).tolist():
        place = f"step {vehicles['step'][row]}, vehicle {vehicles['vehicle'][row]}: demand_kbps"
        compared.differs("vehicles.parquet", place, asked[row], wanted[row])
    return np.array(wanted, dtype=np.float64)


def _check_carried(
    compared: Compared, vehicles: Table, kind: str, owner: Ints, fleet: _Fleet, law: Law, available: Floats
) -> None:
    """Carried is what the law gives where everyone is; delivered, in all, what the links bring on to gateways.

    Which vehicles' traffic gets through is the solver's choice, and not the same with every version of it.
    """
    file, carried, delivered = "vehicles.parquet", f"{kind}carried_kbps", f"{kind}delivered_kbps"
    demand = vehicles["demand_kbps"].astype(np.float64)
    ground = np.column_stack([vehicles["x"], vehicles["y"]])
    order = np.argsort(vehicles["step"], kind="stable")
    bounds = np.searchsorted(vehicles["step"][order], np.arange(len(fleet.x) + 1))
    for step in range(len(fleet.x)):
        here = order[bounds[step] : bounds[step + 1]]
        by, uavs, aloft = owner[here], np.column_stack([fleet.x[step], fleet.y[step]]), fleet.zone[step] > 0
        covered = vehicles[f"{kind}covered"][here] & (by >= 0)
        expected = law.network.carried(demand[here], by, covered, ground[here], uavs, aloft, available)
        found, through = vehicles[carried][here], vehicles[delivered][here]
        for row in np.flatnonzero(~(np.abs(found - expected) <= ROUNDING)).tolist():
            place = f"step {step}, vehicle {vehicles['vehicle'][here[row]]}: {carried}"
            compared.differs(file, place, found[row], expected[row])
        reached = law.network.delivered(expected, by, uavs, aloft)
        slack = ROUNDING if not law.network.gateways else 1.0 + len(uavs)  # the flow is of whole kbit/s
        if not abs(through.sum() - reached.sum()) <= slack or (through > found + ROUNDING).any():
            compared.differs(file, f"step {step}: {delivered}", through.sum(), reached.sum())


def _check_links(compared: Compared, metrics: Table, row: int, fleet: _Fleet, reach: float) -> None:
    """A zone's connectivity is one that its UAVs' positions allow."""
    step, zone = int(metrics["step"][row]), int(metrics["zone"][row])
    team = np.flatnonzero(fleet.selected[step] & (fleet.zone[step] == zone))
    at, active = np.column_stack([fleet.x[step][team], fleet.y[step][team]]), np.ones(len(team), dtype=bool)
    for column in ("connectivity", "connectivity_neighbor"):
        measure = getattr(rules, column)
        low, high = (
            float(measure(rules.links(at, reach + margin, active), active)) if len(team) else 0.0
            for margin in (-EDGE, EDGE)
        )
        if not low <= metrics[column][row] <= high:
            compared.differs("metrics.parquet", f"step {step}, zone {zone}: {column}", metrics[column][row], low)


def check_charging(compared: Compared, charging: Table, uavs: Table, law: Law) -> None:
    """A row for each UAV without a zone, with its battery of the table of UAVs; no point charges more than it can.

    Args:
        law: of an area with charging places.
    """
    file = "charging.parquet"
    compared.count(f"rows of {file}", len(charging["step"]))
    away = uavs["zone"] == 0
    columns = (uavs["step"][away].tolist(), uavs["uav"][away], uavs["battery"][away].tolist())
    known = {(step, uav): battery for step, uav, battery in zip(*columns, strict=True)}
    used: Counter[tuple[int, str]] = Counter()
    places = dict(zip(law.places.names, law.places.places.tolist(), strict=True))
    for step, uav, point, state, battery in zip(
        charging["step"].tolist(),
        charging["uav"],
        charging["point"],
        charging["state"],
        charging["battery"].tolist(),
        strict=True,
    ):
        at = f"step {step}, UAV {uav}"
        found = known.pop((step, uav), None)
        if found is None:
            compared.differs(file, at, state, "one row, of a UAV without a zone")
        elif not abs(found - battery) <= ROUNDING:
            compared.differs(file, f"{at}: battery", battery, found)
        if point not in places:
            compared.differs(file, f"{at}: point", point, f"one of {', '.join(places)}")
        used[step, point] += state == "charging"
    for (step, point), count in used.items():
        if count > places.get(point, count):
            compared.differs(file, f"step {step}, {point}", f"{count} charge", f"at most {places[point]}")
    for step, uav in known:
        compared.differs(file, f"step {step}, UAV {uav}", "no row", "where a UAV without a zone is charged")


def check_summary(
    compared: Compared,
    summary: Summary,
    told: History,
    tables: Mapping[str, Table],
    mined: Mapping[str, object],
    law: Law,
) -> None:
    """Every figure of the summary that follows from the chain, the tables or the scenario.

    Args:
        mined: counts and addresses that the chain gives, by key.
        law: of the area.
    """
    proposals = [row for period in told.periods for row in period.proposals if row["accepted"]]
    members = [set(period.members) for period in told.periods]
    rows = tables["proposals"]
    accepted = rows["qou"][rows["accepted"]]
    expected: dict[str, Any] = {
        "vehicles": len(set().union(*members)),
        "vehicles_per_period": round(float(np.mean([len(there) for there in members])), 2),
        "uavs": len(told.registered["uav"]),
        "uavs_retired": told.landed,
        "served": len({row["vehicle"] for row in proposals}),
        "served_per_period": round(len({(row["period"], row["vehicle"]) for row in proposals}) / len(members), 2),
        "mean_qou": float(np.mean(accepted)) if len(accepted) else None,
        "mean_qov": float(np.mean([row["qov"] * QOV_UNIT for row in proposals])) if proposals else None,
        **over_the_run(tables["metrics"], tables["vehicles"]),
        **mined,
    }
    if law.places:
        away = tables["charging"]
        fallen = (away["step"] == summary.steps) & (away["state"] == "under way") & (away["battery"] <= 0.0)
        expected["uavs_retired"] = int(fallen.sum())
        expected |= over_charging(tables["charging"], tables["uavs"], summary.step_seconds)
    for key, value in expected.items():
        compared.count("summary entries")
        found = getattr(summary, key)
        close = isinstance(value, float) and isinstance(found, float) and abs(found - value) <= ROUNDING
        if found != value and not close:
            compared.differs("summary.json", key, found, value)
