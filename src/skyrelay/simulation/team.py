"""A fleet over its vehicles: who serves whom, and how well it goes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

import numpy as np

from skyrelay.airspace.law import Law
from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.scenario import Selection
from skyrelay.core.zones import ZoneGrid
from skyrelay.mobility import Tracks
from skyrelay.selection import select
from skyrelay.selection.candidates import candidate_pairs
from skyrelay.selection.handover import Trigger
from skyrelay.selection.methods import ANY_GAIN
from skyrelay.selection.reselection import reselect
from skyrelay.simulation.flight import NOBODY, Flight, Measure, Service
from skyrelay.simulation.world import Fleet, Members

METHOD_SECONDS = 60.0
"""After which the method `optimal` takes the best that it has found in a period [s]."""


def vehicles_at(tracks: Tracks, members: Members, grid: ZoneGrid, step: int) -> tuple[IntArray, VehicleTable]:
    """The vehicles that are there at a step: their rows in the tracks, and their table."""
    rows = np.flatnonzero(np.isfinite(tracks.x[step]))
    x, y = tracks.x[step, rows], tracks.y[step, rows]
    return rows, VehicleTable(
        ids=tuple(tracks.ids[row] for row in rows),
        x=x,
        y=y,
        zone=grid.zone_of(x, y),
        demand=members.demand[rows].astype(np.float64),
        payment=members.payment[rows].astype(np.float64),
        reputation=members.reputation[rows],
    )


def uavs_of(fleet: Fleet) -> tuple[IntArray, UavTable]:
    """The UAVs in the air: their rows in the fleet, and their table."""
    airborne = np.flatnonzero(fleet.zone > 0)
    return airborne, UavTable(
        ids=tuple(fleet.ids[row] for row in airborne),
        x=fleet.x[airborne],
        y=fleet.y[airborne],
        zone=fleet.zone[airborne],
        bandwidth=fleet.bandwidth[airborne].astype(np.float64),
        battery=fleet.battery[airborne],
        reputation=fleet.reputation[airborne],
    )


class Team:
    """A fleet, the selection it flies (or hovers) over, and whom it has served.

    Attributes:
        served: by period, the rows of the vehicles that had a UAV in it.
    """

    def __init__(self, law: Law, settings: Selection, fleet: Fleet, demand: IntArray) -> None:
        self.fleet = fleet
        self._grid, self._settings = law.grid, settings
        self.flight = Flight(law, fleet, demand)
        self.served: list[set[int]] = []
        self._zones: IntArray = fleet.zone
        self._triggers: dict[int, Trigger] = defaultdict(Trigger)  # by row of a vehicle
        self._zone_of_owner = np.zeros(len(demand), dtype=np.int64)

    def assign(self, owner: IntArray) -> None:
        """Begin a period."""
        self._zones = self.fleet.zone.copy()
        self.served.append(set())
        self._serve(owner)

    def correct(self, owner: IntArray) -> None:
        """Who serves whom by now: who allocates late changes it in mid-period."""
        if not np.array_equal(owner, self.flight.owner):
            self._serve(owner)

    def _serve(self, owner: IntArray) -> None:
        self.flight.assign(owner)
        self._zone_of_owner = np.where(owner != NOBODY, self._zones[owner], 0)
        self.served[-1] |= set(np.flatnonzero(owner != NOBODY).tolist())

    def selection(self, tracks: Tracks, members: Members, step: int, seed: int) -> IntArray:
        """[V] the row of each vehicle's UAV by the run's method, at this fleet's own positions, without a chain."""

        def by(rows: IntArray, vehicles: VehicleTable, uavs: UavTable, incumbent: IntArray) -> IntArray:
            return select(
                vehicles,
                uavs,
                settings=self._settings,
                incumbent=incumbent,
                hysteresis=self._hysteresis(rows, vehicles, uavs, incumbent),
                seed=seed,
                time_limit=METHOD_SECONDS,
                within=True,
            ).assignment

        return self._owner_by(by, tracks, members, step)

    def reselection(self, tracks: Tracks, members: Members, step: int) -> IntArray:
        """[V] the row of each vehicle's UAV, once those without one have asked the UAVs that have room."""

        def by(_: IntArray, vehicles: VehicleTable, uavs: UavTable, incumbent: IntArray) -> IntArray:
            return reselect(vehicles, uavs, incumbent, self._settings)

        return self._owner_by(by, tracks, members, step)

    def _owner_by(
        self,
        by: Callable[[IntArray, VehicleTable, UavTable, IntArray], IntArray],
        tracks: Tracks,
        members: Members,
        step: int,
    ) -> IntArray:
        """[V] the row of each vehicle's UAV by what decides over the tables of those who are there.

        Args:
            by: of the vehicles' rows [R] and both tables, and the index of the UAV that each has [R], or -1, it gives
                the index of the UAV that each shall have [R], or -1.
        """
        rows, vehicles = vehicles_at(tracks, members, self._grid, step)
        airborne, uavs = uavs_of(self.fleet)
        index = np.full(len(self.fleet.ids) + 1, NOBODY)  # the last one stands for nobody
        index[airborne] = np.arange(len(airborne))
        chosen = by(rows, vehicles, uavs, index[self.flight.owner[rows]])
        owner = np.full(len(tracks.ids), NOBODY)
        owner[rows[chosen >= 0]] = airborne[chosen[chosen >= 0]]
        return owner

    def _hysteresis(self, rows: IntArray, vehicles: VehicleTable, uavs: UavTable, incumbent: IntArray) -> FloatArray:
        """[V] points of QoU by which another UAV must be better: any, as long as none has been so for long enough."""
        rule = self._settings
        points = np.full(len(vehicles), rule.hysteresis)
        if rule.method != "two-sided" or rule.time_to_trigger == 0:
            return points
        pairs = candidate_pairs(vehicles, uavs, rule)
        for row in np.flatnonzero(incumbent != NOBODY).tolist():
            mine = slice(pairs.start[row], pairs.start[row + 1])
            own = pairs.qou[mine][pairs.uav[mine] == incumbent[row]]
            if len(own):  # else it is no candidate any more
                better = pairs.uav[mine][pairs.qou[mine] > own[0] + rule.hysteresis]
                names = [uavs.ids[uav] for uav in better]
                if self._triggers[int(rows[row])].note(uavs.ids[incumbent[row]], names) < rule.time_to_trigger:
                    points[row] = ANY_GAIN
        return points

    def measure(self, x: FloatArray, y: FloatArray) -> tuple[Service, list[Measure]]:
        """What vehicles get at one step, and how well it goes in every zone with a team, then in the whole area."""
        got = self.flight.serve(x, y)
        return got, self.flight.measure(x, got, self._zone_of_owner)
