"""Selection period after period: vehicles arrive, move and leave, UAVs drain, and only what changed is done again.

The result is that of selecting anew. With one round (the paper) a vehicle searches its candidates again only when it
is new or has moved, or its best UAV has changed; to every other vehicle only the changed UAVs are offered; and a UAV
goes through its proposals again only when they or the UAV have changed. With more rounds a chain of displacements can
cross a whole zone, so whole zones are done again, but only those in which something has changed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.allocation import allocate
from skyrelay.selection.deferred_acceptance import deferred_acceptance
from skyrelay.selection.methods import check_hysteresis, round_limit
from skyrelay.selection.proposal import Preferences
from skyrelay.selection.quality import BoolArray, are_candidates, density, pair_qou, pair_qov

Table = TypeVar("Table", VehicleTable, UavTable)

_PLACE = ("x", "y", "zone")
_VEHICLE = (*_PLACE, "demand", "payment", "reputation")
_UAV = (*_PLACE, "bandwidth", "battery", "reputation")


@dataclass(frozen=True)
class Churn:
    """What a new selection means to the users.

    Attributes:
        arrived, left: vehicles that were not there before, or are no longer.
        kept: served by the UAV that served them before.
        changed: served by another UAV than before: each is a hand-over.
        gained: served now, not before (arrivals included).
        lost: there and not served now, but before.
    """

    arrived: int
    left: int
    kept: int
    changed: int
    gained: int
    lost: int


@dataclass(frozen=True)
class Period:
    """One period of online selection.

    Attributes:
        assignment: [V] index of the UAV, or -1.
        churn: against the period before.
        searched: vehicles that went through all their candidates again.
        allocated: UAVs that went through their proposals again.
    """

    assignment: IntArray
    churn: Churn
    searched: int
    allocated: int


@dataclass(frozen=True)
class _State:
    """What a period leaves to the next; the arrays are by its vehicles, with indices of its UAVs."""

    vehicles: VehicleTable
    uavs: UavTable
    incumbent: IntArray
    best: IntArray
    best_qou: FloatArray
    asked: IntArray
    assignment: IntArray


class OnlineSelection:
    """Two-sided selection that is kept up to date.

    Args:
        settings: weights, maxima, candidate rule; left out: the defaults.
        rounds: 1 is the paper; ``"full"``: deferred acceptance; left out: as ``settings`` say.
        hysteresis: a vehicle leaves the UAV that serves it only for one whose QoU is more than so many points higher;
            0: it goes to the best, as in the paper; left out: as ``settings`` say.
    Raises:
        UsageError: a number of rounds or a hysteresis that there is not.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        rounds: int | Literal["full"] | None = None,
        hysteresis: float | None = None,
    ) -> None:
        self._settings = settings or Settings()
        self._rounds = round_limit(self._settings.rounds if rounds is None else rounds)
        self._hysteresis = check_hysteresis(self._settings.hysteresis if hysteresis is None else hysteresis)
        self._state: _State | None = None

    def update(self, vehicles: VehicleTable, uavs: UavTable) -> Period:
        """Select for the present vehicles and UAVs.

        Returns: the assignment that ``select(vehicles, uavs, incumbent=..., hysteresis=...)`` gives, the incumbents
            being the UAVs of the last period.
        """
        before = self._state or _nothing()
        step = _Step(before, vehicles, uavs, self._settings, self._hysteresis)
        state, searched, allocated = step.one_round() if self._rounds == 1 else step.by_zones(self._rounds)
        self._state = state
        return Period(state.assignment, step.churn(state.assignment), searched, allocated)


class _Step:
    """From one period to the next."""

    def __init__(
        self, before: _State, vehicles: VehicleTable, uavs: UavTable, settings: Settings, hysteresis: float
    ) -> None:
        self._before, self._vehicles, self._uavs = before, vehicles, uavs
        self._settings, self._hysteresis = settings, hysteresis
        self._row = _previous_rows(before.vehicles, vehicles)
        self._column = _previous_rows(before.uavs, uavs)
        # Ties are decided by the order of the lists: where that has changed, nothing old is of use.
        in_order = _ascending(self._row) and _ascending(self._column)
        self._known_vehicle = (self._row >= 0) & in_order
        self._same_uav = (self._column >= 0) & in_order
        self._same_uav &= _unchanged(before.uavs, uavs, self._column, _UAV)
        self._in_place = self._known_vehicle & _unchanged(before.vehicles, vehicles, self._row, _PLACE)
        self._same_vehicle = self._known_vehicle & _unchanged(before.vehicles, vehicles, self._row, _VEHICLE)
        self._now = np.full(len(before.uavs) + 1, -1, dtype=np.int64)  # old index to new; the last slot is for -1
        self._now[self._column[self._column >= 0]] = np.flatnonzero(self._column >= 0)
        self._incumbent = self._carried(before.assignment)

    def _carried(self, old: IntArray) -> IntArray:
        """[V] what an array of the last period says of the present vehicles, as indices of the present UAVs."""
        there = self._row >= 0
        result = np.full(len(self._vehicles), -1, dtype=np.int64)
        result[there] = self._now[old[self._row[there]]]
        return result

    def one_round(self) -> tuple[_State, int, int]:
        """Algorithms 1 and 2, each where its input has changed."""
        vehicles, uavs, settings = self._vehicles, self._uavs, self._settings
        best, best_qou = self._carried(self._before.best), np.full(len(vehicles), -np.inf)
        there = self._row >= 0
        best_qou[there] = self._before.best_qou[self._row[there]]
        # Good still: in place, and its best UAV (if it had one) is as it was.
        good = self._in_place & (np.append(self._same_uav, True)[best])
        good &= (best >= 0) | np.isneginf(best_qou)

        searching = np.flatnonzero(~good)
        best[searching], best_qou[searching] = Preferences(vehicles, uavs, settings).first(searching)
        staying, changed = np.flatnonzero(good), np.flatnonzero(~self._same_uav)
        offered, offered_qou = Preferences(vehicles, _take(uavs, changed), settings).first(staying)
        offered = np.append(changed, -1)[offered]
        better = (offered_qou > best_qou[staying]) | (
            (offered_qou == best_qou[staying]) & (offered >= 0) & (offered < best[staying])
        )
        best[staying[better]], best_qou[staying[better]] = offered[better], offered_qou[better]

        asked = self._with_hysteresis(best, best_qou)
        assignment, allocated = self._allocate(asked)
        state = _State(vehicles, uavs, self._incumbent, best, best_qou, asked, assignment)
        return state, len(searching), allocated

    def _with_hysteresis(self, best: IntArray, best_qou: FloatArray) -> IntArray:
        """[V] the UAV that is asked: the best, or the incumbent where that is not enough better."""
        asked = best.copy()
        if self._hysteresis > 0.0:
            rows = np.flatnonzero(self._incumbent >= 0)
            there = self._incumbent[rows]
            kept = are_candidates(self._vehicles, self._uavs, rows, there, self._settings)
            qou = pair_qou(self._vehicles, self._uavs, rows, there, self._settings)
            kept &= (qou > 0.0) & (qou + self._hysteresis >= best_qou[rows])
            asked[rows[kept]] = there[kept]
        return asked

    def _allocate(self, asked: IntArray) -> tuple[IntArray, int]:
        """[V] the UAV of each vehicle, and how many UAVs had to choose again."""
        vehicles, uavs = self._vehicles, self._uavs
        asked_before, uav_before = self._carried(self._before.asked), self._before.asked
        same_proposal = self._same_vehicle & (asked == asked_before)
        fresh = ~self._same_uav
        fresh[asked[~same_proposal & (asked >= 0)]] = True
        fresh[asked_before[~same_proposal & (asked_before >= 0)]] = True
        gone = np.ones(len(self._before.vehicles), dtype=bool)
        gone[self._row[self._row >= 0]] = False
        missed = self._now[uav_before[gone]]
        fresh[missed[missed >= 0]] = True

        assignment = self._carried(self._before.assignment)
        chosen = np.flatnonzero((asked >= 0) & np.append(fresh, False)[asked])
        score = density(pair_qov(vehicles, uavs, chosen, asked[chosen], self._settings), vehicles.demand[chosen])
        accepted = allocate(asked[chosen], score, vehicles.demand[chosen], uavs.bandwidth)
        assignment[asked < 0] = -1
        assignment[chosen] = np.where(accepted, asked[chosen], -1)
        return assignment, len(np.unique(asked[chosen]))

    def by_zones(self, rounds: int | None) -> tuple[_State, int, int]:
        """All rounds again in the zones where a vehicle, a UAV or an incumbent has changed."""
        vehicles, uavs, before = self._vehicles, self._uavs, self._before
        moved = ~self._same_vehicle
        if self._hysteresis > 0.0:
            moved |= self._incumbent != self._carried(before.incumbent)
        zones = [vehicles.zone[moved], uavs.zone[~self._same_uav]]
        # Where something has left, or was before it changed, is touched as well.
        zones.append(_left_zones(before.vehicles, self._row, self._same_vehicle))
        zones.append(_left_zones(before.uavs, self._column, self._same_uav))
        touched = np.unique(np.concatenate(zones))
        rows = np.flatnonzero(np.isin(vehicles.zone, touched))
        columns = np.flatnonzero(np.isin(uavs.zone, touched))
        local = np.full(len(uavs) + 1, -1, dtype=np.int64)
        local[columns] = np.arange(len(columns))
        found, _ = deferred_acceptance(
            _take(vehicles, rows),
            _take(uavs, columns),
            self._settings,
            rounds,
            local[self._incumbent[rows]],
            self._hysteresis,
        )
        assignment = self._carried(before.assignment)
        assignment[rows] = np.append(columns, -1)[found]
        nothing, no_qou = np.full(len(vehicles), -1, dtype=np.int64), np.full(len(vehicles), -np.inf)
        state = _State(vehicles, uavs, self._incumbent, nothing, no_qou, nothing, assignment)
        return state, len(rows), len(columns)

    def churn(self, assignment: IntArray) -> Churn:
        """Against the period before."""
        there = self._row >= 0
        had = np.full(len(self._vehicles), -1, dtype=np.int64)
        had[there] = self._before.assignment[self._row[there]]
        served, was_served = assignment >= 0, had >= 0
        same = served & was_served & (self._incumbent == assignment)
        return Churn(
            arrived=int((~there).sum()),
            left=len(self._before.vehicles) - int(there.sum()),
            kept=int(same.sum()),
            changed=int((served & was_served & ~same).sum()),
            gained=int((served & ~was_served).sum()),
            lost=int((~served & was_served).sum()),
        )


def _nothing() -> _State:
    number, index = np.empty(0), np.empty(0, dtype=np.int64)
    return _State(
        VehicleTable((), number, number, index, number, number, number),
        UavTable((), number, number, index, number, number, number),
        index,
        index,
        number,
        index,
        index,
    )


def _previous_rows(before: Table, now: Table) -> IntArray:
    """[rows now] where each stood before, or -1."""
    if before.ids == now.ids:
        return np.arange(len(now), dtype=np.int64)
    row = {name: number for number, name in enumerate(before.ids)}
    return np.array([row.get(name, -1) for name in now.ids], dtype=np.int64)


def _ascending(row: IntArray) -> bool:
    return bool((np.diff(row[row >= 0]) > 0).all())


def _unchanged(before: Table, now: Table, row: IntArray, columns: tuple[str, ...]) -> BoolArray:
    """[rows now] true where a row was there before with the same values."""
    same = row >= 0
    for name in columns:
        same[same] = getattr(before, name)[row[same]] == getattr(now, name)[same]
    return same


def _left_zones(before: Table, row: IntArray, same: BoolArray) -> IntArray:
    """Zones in which a row of before is no longer what it was."""
    touched = np.ones(len(before), dtype=bool)
    touched[row[same]] = False
    return before.zone[touched]


def _take(table: Table, rows: IntArray) -> Table:
    columns = {name: getattr(table, name)[rows] for name in (_VEHICLE if isinstance(table, VehicleTable) else _UAV)}
    return type(table)(ids=tuple(table.ids[row] for row in rows.tolist()), **columns)
