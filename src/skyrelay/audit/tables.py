"""The tables of a run against what its chain and its own rules give."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from skyrelay.chain.proof.audit import AuditReport
from skyrelay.chain.proof.replay import Difference
from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.core.zones import ZoneGrid
from skyrelay.protocol.history import History, Period
from skyrelay.selection.quality import qou

Table = Mapping[str, npt.NDArray[Any]]
QOU = 1e-6
"""QoU is worked out again in floating point: its last digits may differ between machines."""
METRES = 0.06
"""A table of positions in single precision against the chain's decimetres."""
_SHOWN = 50


class Compared:
    """Counts what was compared and notes what differs, of each kind at most so many one by one."""

    def __init__(self, report: AuditReport) -> None:
        self._report = report
        self._noted: dict[str, int] = {}

    def count(self, what: str, number: int = 1) -> None:
        """So many of a thing were compared."""
        self._report.checked[what] += number

    def differs(self, file: str, place: str, found: object, expected: object) -> None:
        """Note a difference."""
        self._noted[file] = self._noted.get(file, 0) + 1
        if self._noted[file] <= _SHOWN:
            self._report.differences.append(Difference(f"{file}: {place}", str(found), str(expected)))
        elif self._noted[file] == _SHOWN + 1:
            self._report.differences.append(Difference(file, "more that differs", "no more"))

    def same(self, file: str, place: str, found: object, expected: object) -> None:
        """Note it where two values differ."""
        if found != expected:
            self.differs(file, place, found, expected)

    def rows(
        self, name: str, found: Iterable[Mapping[str, Any]], expected: Iterable[Mapping[str, Any]], key: Sequence[str]
    ) -> None:
        """Rows of a table, found by some of their columns; those of ``expected`` may have fewer columns."""
        file = f"{name}.parquet"
        wanted = {tuple(row[part] for part in key): row for row in expected}
        self.count(f"rows of {file}", len(wanted))
        for row in found:
            place = tuple(row[part] for part in key)
            other = wanted.pop(place, None)
            told = ", ".join(f"{part} {value}" for part, value in zip(key, place, strict=True))
            if other is None:
                self.differs(file, told, "a row", "none, by the chain, or only one")
                continue
            for column, value in other.items():
                close = isinstance(value, float) and abs(row[column] - value) <= QOU
                if not close and row[column] != value:
                    self.differs(file, f"{told}: {column}", row[column], value)
        for place in wanted:
            told = ", ".join(f"{part} {value}" for part, value in zip(key, place, strict=True))
            self.differs(file, told, "no row", "one, by the chain")


def check_accounts(
    compared: Compared, told: History, accounts: Sequence[Mapping[str, Any]], derive: Callable[[str], str] | None
) -> None:
    """Whose address is whose: every member and party of the chain, and nobody twice."""
    file = "accounts.parquet"
    kinds: dict[str, set[str]] = {"vehicle": set(), "uav": set(), "party": set()}
    for row in accounts:
        compared.count(f"rows of {file}")
        if row["kind"] not in kinds or any(row["address"] in known for known in kinds.values()):
            compared.differs(file, row["name"], f"{row['kind']} {row['address']}", "one vehicle, UAV or party")
            continue
        kinds[row["kind"]].add(row["address"])
        if derive is not None:
            compared.same(file, f"{row['name']}: address", row["address"], derive(row["name"]))
    for kind, addresses in {**told.registered, "party": told.roles}.items():
        for address in addresses:
            if address not in kinds[kind]:
                compared.differs(file, address, "no such account", f"a {kind}, by the chain")
    for address in kinds["uav"] - set(told.registered["uav"]):
        compared.differs(file, address, "a UAV", "none, by the chain")
    for address in kinds["party"] - told.roles:
        compared.differs(file, address, "a party", "none, by the chain")


def check_periods(
    compared: Compared, told: History, rows: Mapping[str, list[dict[str, Any]]], settings: Settings, in_order: bool
) -> None:
    """The tables fleet, members, proposals and candidates.

    Args:
        in_order: all agents were in one process: nobody was late, and nobody unheard. Else a vehicle may have weighed
            any record that a UAV had while the selection went on, and its host may not have told what it weighed.
    """
    fleet, members, proposals, candidates = [], [], [], []
    for number, period in enumerate(told.periods):
        fleet += [{"period": number, "uav": name} | row for name, row in period.fleet.items()]
        for name, row in period.members.items():
            demand = {"demand_kbps": told.demands[name]} if name in told.demands else {}
            members.append({"period": number, "vehicle": name} | row | demand)
        quality = _qualities(period, settings, in_order)
        found = _by_pair(rows["candidates"], number)
        told_by = {vehicle for vehicle, _ in found}
        for (vehicle, uav), values in quality.items():
            if not in_order and ((vehicle, uav) not in found) and (None in values or vehicle not in told_by):
                continue
            value = _nearest(found.get((vehicle, uav), -1.0), values)
            candidates.append({"period": number, "vehicle": vehicle, "uav": uav, "qou": value})
        qous = {row["order"]: row["qou"] for row in rows["proposals"] if row["period"] == number}
        for row in period.proposals:
            pair = quality.get((row["vehicle"], row["uav"]), {-1.0})
            if row["order"] in period.renewed:
                asked_by, asked = period.renewed[row["order"]]
                then = _pairs({row["vehicle"]: asked_by}, {(row["uav"], 0): asked}, row["zone"], settings)
                pair = then.get((row["vehicle"], row["uav"]), {-1.0})
            values = pair | (set() if in_order else {0.0})
            proposals.append(row | {"qou": _nearest(qous.get(row["order"], -1.0), values)})
    compared.rows("fleet", rows["fleet"], fleet, ("period", "uav"))
    compared.rows("members", rows["members"], members, ("period", "vehicle"))
    compared.rows("proposals", rows["proposals"], proposals, ("order",))
    weighed = rows["candidates"]
    if not in_order:  # who has told the chain nothing in the period has weighed by a record that nobody can tell
        weighed = [row for row in weighed if row["vehicle"] in told.periods[row["period"]].members]
    compared.rows("candidates", weighed, candidates, ("period", "vehicle", "uav"))


def one_demand_each(compared: Compared, members: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """What each vehicle asks for [kbit/s], the same in every period."""
    demands: dict[str, int] = {}
    for row in members:
        first = demands.setdefault(row["vehicle"], row["demand_kbps"])
        place = f"period {row['period']}, vehicle {row['vehicle']}: demand_kbps"
        compared.same("members.parquet", place, row["demand_kbps"], first)
    return demands


def _by_pair(candidates: Iterable[Mapping[str, Any]], period: int) -> dict[tuple[str, str], float]:
    """QoU of a period's candidates, by vehicle and UAV."""
    return {(row["vehicle"], row["uav"]): row["qou"] for row in candidates if row["period"] == period}


def _nearest(found: float, values: set[float | None]) -> float:
    """Of the values that may stand in a row, the one that does, as nearly as can be."""
    return min((value for value in values if value is not None), key=lambda value: abs(value - found))


def _qualities(period: Period, settings: Settings, in_order: bool) -> dict[tuple[str, str], set[float | None]]:
    """What QoU (Eq. 1) of each vehicle's candidates may be, from the chain's records, zone by zone.

    One value each where all was in order; else one for each record that the UAV had, None where it was no candidate.
    """
    result: dict[tuple[str, str], set[float | None]] = {}
    records: dict[tuple[str, int], dict[str, Any] | None] = {(name, 0): row for name, row in period.fleet.items()}
    if not in_order:
        records |= {(name, number): row for name, rows in period.versions.items() for number, row in enumerate(rows, 1)}
    for zone in sorted({row["zone"] for row in records.values() if row is not None}):
        uavs = {name: row for name, row in records.items() if row is not None and row["zone"] == zone}
        vehicles = {name: row for name, row in period.members.items() if row["zone"] == zone}
        result |= _pairs(vehicles, uavs, zone, settings)
    if not in_order:
        sizes = Counter(name for name, _ in records)
        for (_, uav), values in result.items():
            if len(values) < sizes[uav]:  # it was none by some record, or two gave the same
                values.add(None)
    return result


def _pairs(
    vehicles: Mapping[str, Mapping[str, Any]],
    uavs: Mapping[tuple[str, int], Mapping[str, Any]],
    zone: int,
    settings: Settings,
) -> dict[tuple[str, str], set[float | None]]:
    """QoU of each candidate in a zone: by the vehicle and the UAV, of which there may be several records."""
    result: dict[tuple[str, str], set[float | None]] = {}
    if not vehicles:
        return result

    def column(rows: Iterable[Mapping[str, Any]], name: str) -> npt.NDArray[np.float64]:
        return np.array([row[name] for row in rows], dtype=np.float64)

    here = VehicleTable(
        ids=tuple(vehicles),
        x=column(vehicles.values(), "x"),
        y=column(vehicles.values(), "y"),
        zone=np.full(len(vehicles), zone, dtype=np.int64),
        demand=np.ones(len(vehicles)),  # Eq. 1 does not ask for it
        payment=column(vehicles.values(), "payment"),
        reputation=column(vehicles.values(), "reputation"),
    )
    team = UavTable(
        ids=tuple(f"{name} {number}" for name, number in uavs),
        x=column(uavs.values(), "x"),
        y=column(uavs.values(), "y"),
        zone=np.full(len(uavs), zone, dtype=np.int64),
        bandwidth=column(uavs.values(), "bandwidth_kbps"),
        battery=column(uavs.values(), "battery"),
        reputation=column(uavs.values(), "reputation"),
    )
    score = qou(here, team, settings)
    names = [name for name, _ in uavs]
    for row, place in np.argwhere(np.isfinite(score)).tolist():
        result.setdefault((here.ids[row], names[place]), set()).add(float(score[row, place]))
    return result


def check_flight(
    compared: Compared, told: History, vehicles: Table, uavs: Table, period_steps: int, grid: ZoneGrid, in_order: bool
) -> None:
    """Who serves whom at each step, who has landed, and where everyone was when a selection opened.

    Args:
        in_order: as in `check_periods`; else a vehicle may be there and not have told the chain, and a UAV that lands
            between two periods may do so after the row of that step was written.
    """
    compared.count("rows of vehicles.parquet", len(vehicles["step"]))
    period_of = np.maximum(vehicles["step"] - 1, 0) // period_steps
    rows = zip(vehicles["step"].tolist(), vehicles["vehicle"], vehicles["uav"], period_of.tolist(), strict=True)
    for step, vehicle, uav, period in rows:
        if uav != (expected := told.periods[period].served_at(step).get(vehicle, "")):
            compared.differs(
                "vehicles.parquet", f"step {step}, vehicle {vehicle}: uav", uav or "nobody", expected or "nobody"
            )
    nearby = [
        grid.zone_of(vehicles["x"] + dx, vehicles["y"] + dy) for dx in (-METRES, METRES) for dy in (-METRES, METRES)
    ]
    fits = np.any([zone == vehicles["zone"] for zone in nearby], axis=0)
    for row in np.flatnonzero(~fits).tolist():
        place = f"step {vehicles['step'][row]}, vehicle {vehicles['vehicle'][row]}: zone"
        compared.differs("vehicles.parquet", place, vehicles["zone"][row], nearby[0][row])

    compared.count("rows of uavs.parquet", len(uavs["step"]))
    period_of = np.maximum(uavs["step"] - 1, 0) // period_steps
    taken = {
        (step, period): set(told.periods[period].served_at(step).values())
        for step, period in set(zip(uavs["step"].tolist(), period_of.tolist(), strict=True))
    }
    for step, uav, zone, selected, period in zip(
        uavs["step"].tolist(),
        uavs["uav"],
        uavs["zone"].tolist(),
        uavs["selected"].tolist(),
        period_of.tolist(),
        strict=True,
    ):
        expected_zone = told.zone_at(uav, step)
        late = not in_order and step % period_steps == 0 and zone == told.zone_at(uav, step - 1)
        if zone != expected_zone and not late:
            compared.differs("uavs.parquet", f"step {step}, UAV {uav}: zone", zone, expected_zone)
        if selected != (zone > 0 and uav in taken[step, period]):
            compared.differs("uavs.parquet", f"step {step}, UAV {uav}: selected", selected, not selected)
    for table, kind, column, records in (
        (vehicles, "vehicle", "vehicles.parquet", [period.members for period in told.periods]),
        (uavs, "uav", "uavs.parquet", [period.fleet for period in told.periods]),
    ):
        for number, every in enumerate(records):
            known = {name: row for name, row in every.items() if name in told.periods[number].told}
            at = table["step"] == number * period_steps
            found = dict(zip(table[kind][at], zip(table["x"][at], table["y"][at], strict=True), strict=True))
            odd_ones = set(found) ^ set(every) if in_order else set(known) - set(found)
            if kind == "vehicle" and odd_ones:
                odd = min(odd_ones)
                compared.differs(
                    column, f"step {number * period_steps}", f"vehicle {odd}", "those of the chain's records"
                )
            for name, record in known.items():
                x, y = found.get(name, (np.nan, np.nan))
                if not (abs(x - record["x"]) <= METRES and abs(y - record["y"]) <= METRES):
                    place = f"step {number * period_steps}, {kind} {name}: position"
                    compared.differs(column, place, (float(x), float(y)), (record["x"], record["y"]))
