"""What a run leaves behind, row by row; the columns are `skyrelay.runfolder.schema.SCHEMAS`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skyrelay.chain.abi import Event
from skyrelay.core.entities import FloatArray
from skyrelay.core.zones import ZoneGrid
from skyrelay.mobility import Tracks
from skyrelay.runfolder.figures import over_charging, over_the_run
from skyrelay.runfolder.writer import TableWriter
from skyrelay.simulation.flight import NOBODY, Measure
from skyrelay.simulation.team import Team
from skyrelay.simulation.world import Members

Named = tuple[str, Mapping[str, Any]]
"""A member's name, and its record."""


class Record:
    """The record of one run.

    Args:
        tracks, grid, members: of the run.
        step_seconds: [s].
        flying, hovering: the fleet that follows its vehicles, and the one that it is compared with.
    """

    def __init__(
        self, tracks: Tracks, grid: ZoneGrid, members: Members, step_seconds: float, flying: Team, hovering: Team
    ) -> None:
        self._tracks, self._grid, self._members, self._step_seconds = tracks, grid, members, step_seconds
        self._flying, self._hovering = flying, hovering
        self._demand = dict(zip(tracks.ids, members.demand.tolist(), strict=True))
        self._tables = TableWriter()

    def period(self, period: int, fleet: Sequence[Named], members: Sequence[Named]) -> None:
        """The records on the chain that the period's selection works with, each with its member's name."""
        for table, kind, records in (("fleet", "uav", fleet), ("members", "vehicle", members)):
            if records:
                columns = {column: [record[column] for _, record in records] for column in records[0][1]}
                columns[kind] = [name for name, _ in records]
                if kind == "vehicle":
                    columns["demand_kbps"] = [self._demand[name] for name in columns[kind]]
                self._tables.add(table, period=period, **columns)

    def candidates(self, period: int, vehicle: str, weighed: Mapping[str, float]) -> None:
        """The QoU of each UAV (by name) that a vehicle weighed in a period's first round."""
        self._tables.add("candidates", period=period, vehicle=vehicle, uav=list(weighed), qou=list(weighed.values()))

    def proposals(self, proposals: Sequence[Mapping[str, Any]]) -> None:
        """Every proposal of a period, and whether its UAV held on to it to the end."""
        if proposals:
            self._tables.add("proposals", **{column: [row[column] for row in proposals] for column in proposals[0]})

    def step(self, step: int) -> FloatArray:
        """Everyone's place at a step, and how well every zone is served.

        Returns: [V] what each vehicle's link to its UAV holds of its demand [kbit/s].
        """
        x, y = self._tracks.x[step], self._tracks.y[step]
        flying, hovering = self._flying, self._hovering
        got, in_zones = flying.measure(x, y)
        static_got, static_in_zones = hovering.measure(x, y)
        measured = {m.zone: m for m in in_zones}
        static = {m.zone: m for m in static_in_zones}
        zones = sorted(measured)
        nothing = Measure(0, 0, 0, math.nan, math.nan, math.nan, 0.0, 0.0, 0.0, math.nan)
        rows = np.flatnonzero(np.isfinite(x))
        at = self._grid.zone_of(x[rows], y[rows])
        demand = self._members.demand[rows]
        self._tables.add(
            "metrics",
            step=step,
            time=step * self._step_seconds,
            zone=zones,
            connected=[int((at == zone).sum()) if zone else len(rows) for zone in zones],
            vehicles=[measured[zone].vehicles for zone in zones],
            covered=[measured[zone].covered for zone in zones],
            coverage=[measured[zone].coverage for zone in zones],
            connectivity=[measured[zone].connectivity for zone in zones],
            connectivity_neighbor=[measured[zone].connectivity_neighbor for zone in zones],
            demand_mbps=[float(demand[at == zone].sum() if zone else demand.sum()) / 1000.0 for zone in zones],
            served_mbps=[measured[zone].served_mbps for zone in zones],
            carried_mbps=[measured[zone].carried_mbps for zone in zones],
            delivered_mbps=[measured[zone].delivered_mbps for zone in zones],
            energy_percent=[measured[zone].battery for zone in zones],
            static_vehicles=[static.get(zone, nothing).vehicles for zone in zones],
            static_covered=[static.get(zone, nothing).covered for zone in zones],
            static_coverage=[static.get(zone, nothing).coverage for zone in zones],
            static_connectivity=[static.get(zone, nothing).connectivity for zone in zones],
            static_served_mbps=[static.get(zone, nothing).served_mbps for zone in zones],
            static_carried_mbps=[static.get(zone, nothing).carried_mbps for zone in zones],
            static_delivered_mbps=[static.get(zone, nothing).delivered_mbps for zone in zones],
        )
        owner, static_owner = flying.flight.owner[rows], hovering.flight.owner[rows]
        self._tables.add(
            "vehicles",
            step=step,
            vehicle=[self._tracks.ids[row] for row in rows],
            x=x[rows],
            y=y[rows],
            zone=at,
            uav=[flying.fleet.ids[row] if row != NOBODY else "" for row in owner],
            demand_kbps=demand,
            covered=got.covered[rows],
            carried_kbps=got.carried[rows],
            delivered_kbps=got.delivered[rows],
            static_uav=[hovering.fleet.ids[row] if row != NOBODY else "" for row in static_owner],
            static_covered=static_got.covered[rows],
            static_carried_kbps=static_got.carried[rows],
            static_delivered_kbps=static_got.delivered[rows],
        )
        self._tables.add(
            "uavs",
            step=step,
            uav=flying.fleet.ids,
            x=flying.fleet.x,
            y=flying.fleet.y,
            zone=flying.fleet.zone,
            selected=flying.flight.selected,
            battery=flying.fleet.battery,
            action=flying.flight.actions,
            static_x=hovering.fleet.x,
            static_y=hovering.fleet.y,
            static_zone=hovering.fleet.zone,
            static_selected=hovering.flight.selected,
        )
        self._charging(step)
        return got.carried

    def _charging(self, step: int) -> None:
        """Who is away to be charged at a step."""
        rows, points, states = self._flying.flight.charging
        if len(rows):
            fleet, names = self._flying.fleet, self._flying.flight.point_names
            self._tables.add(
                "charging",
                step=step,
                uav=[fleet.ids[row] for row in rows],
                point=[names[point] for point in points],
                state=states,
                battery=fleet.battery[rows],
            )

    def payments(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """What vehicles paid for a period."""
        for row in rows:
            self._tables.add("payments", **row)

    def figures(self) -> dict[str, float | None]:
        """Those of the run so far that its tables give."""
        return over_the_run(self._tables.columns("metrics"), self._tables.columns("vehicles"))

    def charging_figures(self) -> dict[str, float | None]:
        """Likewise, where there are charging places."""
        return over_charging(self._tables.columns("charging"), self._tables.columns("uavs"), self._step_seconds)

    def streets(self, lines: Sequence[FloatArray]) -> None:
        """The streets beneath, each [P, 2] [m]."""
        if lines:
            corners = np.concatenate(lines)
            numbers = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
            self._tables.add("streets", street=numbers, x=corners[:, 0], y=corners[:, 1])

    def write(
        self, folder: Path, events: Sequence[tuple[int, Event]], accounts: Mapping[str, Mapping[str, str]]
    ) -> None:
        """Add what is known at the end, and write the tables.

        Args:
            events: of the contract, each with its step.
            accounts: by kind, the address of each name.
        """
        self._tables.add(
            "events",
            block=[event.block for _, event in events],
            tx=[event.transaction for _, event in events],
            log=[event.index for _, event in events],
            step=[step for step, _ in events],
            name=[event.name for _, event in events],
            args=[json.dumps(event.args) for _, event in events],
        )
        for kind, addresses in accounts.items():
            self._tables.add("accounts", name=list(addresses), address=list(addresses.values()), kind=kind)
        self._tables.write(folder)
