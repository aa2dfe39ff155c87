"""The tables of a run against what its chain and its own rules give."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from skyrelay.audit.history import History, Period
from skyrelay.chain.proof.audit import AuditReport
from skyrelay.chain.proof.replay import Difference
from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.core.zones import ZoneGrid
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
    compared: Compared, told: History, rows: Mapping[str, list[dict[str, Any]]], settings: Settings
) -> None:
    """The tables fleet, members, proposals and candidates."""
    fleet, members, proposals, candidates = [], [], [], []
    for number, period in enumerate(told.periods):
        fleet += [{"period": number, "uav": name} | row for name, row in period.fleet.items()]
        for name, row in period.members.items():
            demand = {"demand_kbps": told.demands[name]} if name in told.demands else {}
            members.append({"period": number, "vehicle": name} | row | demand)
        quality = _qualities(period, settings)
        candidates += [
            {"period": number, "vehicle": vehicle, "uav": uav, "qou": value}
            for (vehicle, uav), value in quality.items()
        ]
        proposals += [row | {"qou": quality.get((row["vehicle"], row["uav"]), -1.0)} for row in period.proposals]
    compared.rows("fleet", rows["fleet"], fleet, ("period", "uav"))
    compared.rows("members", rows["members"], members, ("period", "vehicle"))
    compared.rows("proposals", rows["proposals"], proposals, ("order",))
    compared.rows("candidates", rows["candidates"], candidates, ("period", "vehicle", "uav"))


def one_demand_each(compared: Compared, members: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """What each vehicle asks for [kbit/s], the same in every period."""
    demands: dict[str, int] = {}
    for row in members:
        first = demands.setdefault(row["vehicle"], row["demand_kbps"])
        place = f"period {row['period']}, vehicle {row['vehicle']}: demand_kbps"
        compared.same("members.parquet", place, row["demand_kbps"], first)
    return demands


def _qualities(period: Period, settings: Settings) -> dict[tuple[str, str], float]:
    """QoU (Eq. 1) of every candidate of every vehicle, from the chain's records, zone by zone."""
    result: dict[tuple[str, str], float] = {}
    for zone in sorted({row["zone"] for row in period.fleet.values()}):
        uavs = {name: row for name, row in period.fleet.items() if row["zone"] == zone}
        vehicles = {name: row for name, row in period.members.items() if row["zone"] == zone}
        if not vehicles:
            continue

        def column(rows: Mapping[str, Mapping[str, Any]], name: str) -> npt.NDArray[np.float64]:
            return np.array([row[name] for row in rows.values()], dtype=np.float64)

        here = VehicleTable(
            ids=tuple(vehicles),
            x=column(vehicles, "x"),
            y=column(vehicles, "y"),
            zone=np.full(len(vehicles), zone, dtype=np.int64),
            demand=np.ones(len(vehicles)),  # Eq. 1 does not ask for it
            payment=column(vehicles, "payment"),
            reputation=column(vehicles, "reputation"),
        )
        team = UavTable(
            ids=tuple(uavs),
            x=column(uavs, "x"),
            y=column(uavs, "y"),
            zone=np.full(len(uavs), zone, dtype=np.int64),
            bandwidth=column(uavs, "bandwidth_kbps"),
            battery=column(uavs, "battery"),
            reputation=column(uavs, "reputation"),
        )
        score = qou(here, team, settings)
        for row, place in np.argwhere(np.isfinite(score)).tolist():
            result[here.ids[row], team.ids[place]] = float(score[row, place])
    return result


def check_flight(
    compared: Compared, told: History, vehicles: Table, uavs: Table, period_steps: int, grid: ZoneGrid
) -> None:
    """Who serves whom at each step, who has landed, and where everyone was when a selection opened."""
    served = [period.served for period in told.periods]
    compared.count("rows of vehicles.parquet", len(vehicles["step"]))
    period_of = np.maximum(vehicles["step"] - 1, 0) // period_steps
    rows = zip(vehicles["step"].tolist(), vehicles["vehicle"], vehicles["uav"], period_of.tolist(), strict=True)
    for step, vehicle, uav, period in rows:
        if uav != (expected := served[period].get(vehicle, "")):
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
    taken = [set(period.served.values()) for period in told.periods]
    period_of = np.maximum(uavs["step"] - 1, 0) // period_steps
    for step, uav, zone, selected, period in zip(
        uavs["step"].tolist(),
        uavs["uav"],
        uavs["zone"].tolist(),
        uavs["selected"].tolist(),
        period_of.tolist(),
        strict=True,
    ):
        expected_zone = told.zone_at(uav, step)
        if zone != expected_zone:
            compared.differs("uavs.parquet", f"step {step}, UAV {uav}: zone", zone, expected_zone)
        if selected != (expected_zone > 0 and uav in taken[period]):
            compared.differs("uavs.parquet", f"step {step}, UAV {uav}: selected", selected, not selected)
    for table, kind, column, records in (
        (vehicles, "vehicle", "vehicles.parquet", [period.members for period in told.periods]),
        (uavs, "uav", "uavs.parquet", [period.fleet for period in told.periods]),
    ):
        for number, known in enumerate(records):
            at = table["step"] == number * period_steps
            found = dict(zip(table[kind][at], zip(table["x"][at], table["y"][at], strict=True), strict=True))
            if kind == "vehicle" and set(found) != set(known):
                odd = min(set(found) ^ set(known))
                compared.differs(
                    column, f"step {number * period_steps}", f"vehicle {odd}", "those of the chain's records"
                )
            for name, record in known.items():
                x, y = found.get(name, (np.nan, np.nan))
                if not (abs(x - record["x"]) <= METRES and abs(y - record["y"]) <= METRES):
                    place = f"step {number * period_steps}, {kind} {name}: position"
                    compared.differs(column, place, (float(x), float(y)), (record["x"], record["y"]))
