"""Why was I not served? One vehicle's selection in one period, retold from a run's tables."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from skyrelay.core.errors import SelectionError, UsageError
from skyrelay.selection.allocation import allocate

Outcome = Literal["accepted", "refused", "displaced"]
Rows = Sequence[Mapping[str, Any]]
"""Of a table of docs/reference/run-folder.md."""


@dataclass(frozen=True)
class Candidate:
    """A UAV that the vehicle weighed.

    Attributes:
        uav: id.
        qou: [0-100].
        rank: by QoU, 1 the best.
        asked_in: round in which the vehicle proposed to it, or None.
    """

    uav: str
    qou: float
    rank: int
    asked_in: int | None


@dataclass(frozen=True)
class Rival:
    """A vehicle before this one in a UAV's list that the UAV served.

    Attributes:
        vehicle: id.
        score: QoV/sqrt(RB) as the contract has it.
        demand: [kbit/s].
    """

    vehicle: str
    score: int
    demand: int


@dataclass(frozen=True)
class Ask:
    """One proposal and what became of it.

    Attributes:
        round: counted as the run folder does.
        uav: id.
        qou: of the UAV for the vehicle.
        score: QoV/sqrt(RB) as the contract has it.
        rank, of: place in the UAV's sorted list when this was decided, 1 the first, and the list's length.
        bandwidth: of the UAV [kbit/s].
        taken_by: what was before the vehicle in the list and took bandwidth.
        left: what these left [kbit/s].
        outcome: accepted, refused, or accepted and displaced in a later round.
        decided_in: the round of the refusal or displacement, or of the proposal.
    """

    round: int
    uav: str
    qou: float
    score: int
    rank: int
    of: int
    bandwidth: int
    taken_by: tuple[Rival, ...]
    left: int
    outcome: Outcome
    decided_in: int


@dataclass(frozen=True)
class Received:
    """What a vehicle got over a period.

    Attributes:
        steps: at which it was there.
        in_range: of them, those inside its UAV's range and in its sight.
        crowded: of these, those at which its link held less than it asks for.
        carried, delivered: on average over the steps [kbit/s].
    """

    steps: int
    in_range: int
    crowded: int
    carried: float
    delivered: float


@dataclass(frozen=True)
class Explanation:
    """A vehicle's selection in a period.

    Attributes:
        vehicle: id.
        period: which.
        zone: of the vehicle.
        demand: [kbit/s].
        served_by: id of the UAV, or None.
        uavs_in_zone: how many there were to weigh.
        nearest: id of the nearest of them, or None.
        nearest_distance: its distance [m], or None.
        candidates: by falling QoU.
        asks: in the order they were made.
        received: over the period; None where it was gone before the first step.
    """

    vehicle: str
    period: int
    zone: int
    demand: int
    served_by: str | None
    uavs_in_zone: int
    nearest: str | None
    nearest_distance: float | None
    candidates: tuple[Candidate, ...]
    asks: tuple[Ask, ...]
    received: Received | None


def explain(
    *,
    proposals: Rows,
    candidates: Rows,
    fleet: Rows,
    members: Rows,
    steps: Rows,
    vehicle: str,
    period_steps: int,
    period: int | None = None,
) -> Explanation:
    """Retell one vehicle's selection.

    Args:
        proposals, candidates, fleet, members: the run's tables of these names, of all periods.
        steps: the vehicle's rows of the table of vehicles.
        vehicle: id.
        period_steps: how many steps a period has.
        period: left out: the last one in which the vehicle was there and not served, or else the last it was there.
    Raises:
        UsageError: the vehicle was never there, or not in that period.
        SelectionError: the tables contradict each other.
    """
    chosen = _period(members, proposals, vehicle, period)
    mine = next(row for row in members if row["vehicle"] == vehicle and row["period"] == chosen)
    uavs = {row["uav"]: row for row in fleet if row["period"] == chosen}
    asked = [row for row in proposals if row["period"] == chosen]
    for row in asked:
        if row["uav"] not in uavs:
            raise SelectionError("proposals: uav", row["uav"], f"a UAV of the fleet in period {chosen}")
    asks = _asks(asked, vehicle, uavs)
    rounds = {ask.uav: ask.round for ask in asks}
    weighed = [row for row in candidates if row["period"] == chosen and row["vehicle"] == vehicle]
    weighed.sort(key=lambda row: -row["qou"])  # stable: the first of equals stays first
    there = [row for row in uavs.values() if row["zone"] == mine["zone"]]
    nearest = min(there, key=lambda row: _distance(mine, row), default=None)
    return Explanation(
        vehicle=vehicle,
        period=chosen,
        zone=mine["zone"],
        demand=mine["demand_kbps"],
        served_by=next((row["uav"] for row in asked if row["vehicle"] == vehicle and row["accepted"]), None),
        uavs_in_zone=len(there),
        nearest=nearest["uav"] if nearest else None,
        nearest_distance=_distance(mine, nearest) if nearest else None,
        candidates=tuple(
            Candidate(row["uav"], row["qou"], rank, rounds.get(row["uav"])) for rank, row in enumerate(weighed, start=1)
        ),
        asks=asks,
        received=_received([row for row in steps if (row["step"] - 1) // period_steps == chosen]),
    )


def _received(steps: Rows) -> Received | None:
    """What a vehicle got over these steps."""
    if not steps:
        return None
    covered = [row for row in steps if row["covered"]]
    return Received(
        steps=len(steps),
        in_range=len(covered),
        crowded=sum(row["carried_kbps"] < row["demand_kbps"] for row in covered),
        carried=float(np.mean([row["carried_kbps"] for row in steps])),
        delivered=float(np.mean([row["delivered_kbps"] for row in steps])),
    )


def _asks(asked: Rows, vehicle: str, fleet: Mapping[str, Mapping[str, Any]]) -> tuple[Ask, ...]:
    """The vehicle's proposals, each UAV's choices replayed round by round."""
    told = []
    for own in (row for row in asked if row["vehicle"] == vehicle):
        there = [row for row in asked if row["uav"] == own["uav"]]
        told.append(_replay(own, there, int(fleet[own["uav"]]["bandwidth_kbps"])))
    return tuple(sorted(told, key=lambda ask: ask.round))


def _replay(own: Mapping[str, Any], there: Rows, bandwidth: int) -> Ask:
    """What one UAV did with a proposal, among all proposals to it (Algorithm 2, held and new ones together)."""
    held: list[Mapping[str, Any]] = []
    for number in sorted({row["round"] for row in there}):
        contenders = sorted(
            [*held, *(row for row in there if row["round"] == number)], key=lambda row: (-row["score"], row["order"])
        )
        taken = allocate(
            uav=np.zeros(len(contenders), dtype=np.int64),
            score=np.array([row["score"] for row in contenders], dtype=np.int64),
            demand=np.array([row["demand_kbps"] for row in contenders], dtype=np.int64),
            capacity=np.array([bandwidth], dtype=np.int64),
        )
        held = [row for row, accepted in zip(contenders, taken, strict=True) if accepted]
        if own in contenders:
            place = contenders.index(own)
            before = [row for row in contenders[:place] if row in held]
            ask = Ask(
                round=own["round"],
                uav=own["uav"],
                qou=own["qou"],
                score=own["score"],
                rank=place + 1,
                of=len(contenders),
                bandwidth=bandwidth,
                taken_by=tuple(Rival(row["vehicle"], row["score"], row["demand_kbps"]) for row in before),
                left=bandwidth - sum(row["demand_kbps"] for row in before),
                outcome="accepted" if own in held else "refused" if number == own["round"] else "displaced",
                decided_in=number,
            )
            if own not in held:
                break
    return ask


def _distance(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    return float(np.hypot(one["x"] - other["x"], one["y"] - other["y"]))


def _period(members: Rows, proposals: Rows, vehicle: str, period: int | None) -> int:
    there = sorted({row["period"] for row in members if row["vehicle"] == vehicle})
    if not there:
        close = difflib.get_close_matches(vehicle, {row["vehicle"] for row in members}, n=3)
        hint = f" (did you mean {', '.join(sorted(close))}?)" if close else ""
        raise UsageError("--vehicle", vehicle, f"the id of a vehicle of this run{hint}")
    if period is not None:
        if period not in there:
            known = ", ".join(map(str, there))
            raise UsageError("--period", period, f"a period in which {vehicle} was there: {known}")
        return period
    served = {row["period"] for row in proposals if row["vehicle"] == vehicle and row["accepted"]}
    return int(max([number for number in there if number not in served] or there))
