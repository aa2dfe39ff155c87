"""Why was I not served? One vehicle's selection in one period, retold from a run folder."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from skyrelay.core.errors import RunFolderError, ScenarioError, UsageError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.core.scenario import load_scenario
from skyrelay.selection.allocation import allocate

Outcome = Literal["accepted", "refused", "displaced"]

_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "proposals": ("period", "round", "vehicle", "uav", "qou", "score", "demand_kbps", "accepted", "order"),
    "candidates": ("period", "vehicle", "uav", "qou"),
    "fleet": ("period", "uav", "zone", "x", "y", "bandwidth_kbps"),
    "members": ("period", "vehicle", "zone", "x", "y", "demand_kbps"),
}


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
class Explanation:
    """A vehicle's selection in a period.

    Attributes:
        vehicle: id.
        period: which.
        zone: of the vehicle.
        demand: [kbit/s].
        served_by: id of the UAV, or None.
        reason: one sentence.
        candidates: by falling QoU.
        asks: in the order they were made.
    """

    vehicle: str
    period: int
    zone: int
    demand: int
    served_by: str | None
    reason: str
    candidates: tuple[Candidate, ...]
    asks: tuple[Ask, ...]


def explain(run_dir: Path, vehicle: str, period: int | None = None) -> Explanation:
    """Retell one vehicle's selection.

    Args:
        run_dir: a folder that ``skyrelay run`` has left.
        vehicle: id.
        period: left out: the last one in which the vehicle was there and not served, or else the last it was there.
    Raises:
        RunFolderError: a file is missing or cannot be read, or files contradict each other.
        UsageError: the vehicle was never there, or not in that period.
    """
    if not run_dir.is_dir():
        raise RunFolderError("run folder", str(run_dir), "a folder that `skyrelay run` has left")
    settings = _settings(run_dir)
    members = _read(run_dir, "members", None)
    proposals = _read(run_dir, "proposals", None)
    chosen = _period(members, proposals, vehicle, period)
    mine = next(row for row in members if row["vehicle"] == vehicle and row["period"] == chosen)
    fleet = {row["uav"]: row for row in _read(run_dir, "fleet", chosen)}
    asked = [row for row in proposals if row["period"] == chosen]
    for row in asked:
        if row["uav"] not in fleet:
            raise RunFolderError(run_dir / "proposals.parquet", row["uav"], f"a UAV of fleet.parquet, period {chosen}")
    asks = _asks(asked, vehicle, fleet)
    rounds = {ask.uav: ask.round for ask in asks}
    weighed = [row for row in _read(run_dir, "candidates", chosen) if row["vehicle"] == vehicle]
    weighed.sort(key=lambda row: -row["qou"])  # stable: the first of equals stays first
    candidates = tuple(
        Candidate(row["uav"], row["qou"], rank, rounds.get(row["uav"])) for rank, row in enumerate(weighed, start=1)
    )
    served_by = next((row["uav"] for row in asked if row["vehicle"] == vehicle and row["accepted"]), None)
    return Explanation(
        vehicle=vehicle,
        period=chosen,
        zone=mine["zone"],
        demand=mine["demand_kbps"],
        served_by=served_by,
        reason=_reason(mine, served_by, candidates, asks, fleet.values(), settings),
        candidates=candidates,
        asks=asks,
    )


def to_text(told: Explanation) -> str:
    """An explanation for people, in lines."""
    lines = [
        f"Vehicle {told.vehicle}, period {told.period}, zone {told.zone}, asks {_mbps(told.demand)}",
        told.reason,
        "",
        "Candidates by QoU:" if told.candidates else "No candidates.",
    ]
    lines += [
        f"  {candidate.rank:>3}. {candidate.uav:<12} QoU {candidate.qou:6.2f}"
        + (f"   asked in round {candidate.asked_in}" if candidate.asked_in is not None else "")
        for candidate in told.candidates
    ]
    for ask in told.asks:
        decided = f" in round {ask.decided_in}" if ask.outcome == "displaced" else ""
        lines += [
            "",
            f"Round {ask.round}: asked {ask.uav} ({_mbps(ask.bandwidth)}), {ask.outcome}{decided}; "
            f"place {ask.rank} of {ask.of} in its list",
        ]
        width = max((len(rival.vehicle) for rival in ask.taken_by), default=0)
        lines += [
            f"  {rival.vehicle:<{width}} {_mbps(rival.demand):>14}   before this vehicle" for rival in ask.taken_by
        ]
        lines.append(f"  left for {told.vehicle}: {_mbps(ask.left)} of the {_mbps(told.demand)} it asks")
    return "\n".join(lines)


def _asks(asked: Sequence[Mapping[str, Any]], vehicle: str, fleet: Mapping[str, Mapping[str, Any]]) -> tuple[Ask, ...]:
    """The vehicle's proposals, each UAV's choices replayed round by round."""
    told = []
    for own in (row for row in asked if row["vehicle"] == vehicle):
        there = [row for row in asked if row["uav"] == own["uav"]]
        told.append(_replay(own, there, int(fleet[own["uav"]]["bandwidth_kbps"])))
    return tuple(sorted(told, key=lambda ask: ask.round))


def _replay(own: Mapping[str, Any], there: Sequence[Mapping[str, Any]], bandwidth: int) -> Ask:
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


def _reason(
    mine: Mapping[str, Any],
    served_by: str | None,
    candidates: Sequence[Candidate],
    asks: Sequence[Ask],
    fleet: Any,
    settings: Settings,
) -> str:
    if served_by is not None:
        rank = next((candidate.rank for candidate in candidates if candidate.uav == served_by), None)
        choice = f", its choice number {rank} of {len(candidates)}" if rank else ""
        return f"Served by {served_by}{choice}."
    if not asks:
        return f"Not served: {_without_asking(mine, candidates, fleet, settings)}."
    last = asks[-1]
    if mine["demand_kbps"] > last.bandwidth:
        why = f"it asks {_mbps(mine['demand_kbps'])}, more than {last.uav} has at all ({_mbps(last.bandwidth)})"
    elif last.outcome == "displaced":
        why = f"in round {last.decided_in} vehicles before it in {last.uav}'s list took its bandwidth"
    elif last.outcome == "refused":
        why = (
            f"{_counted(len(last.taken_by), 'vehicle')} before it in {last.uav}'s list left {_mbps(last.left)} "
            f"of the {_mbps(mine['demand_kbps'])} it asks"
        )
    else:
        why = f"{last.uav} accepted it, but it was not served in the end (it left, or the UAV did)"
    unasked = len(candidates) - len(asks)
    more = (
        f"; never asked: {_counted(unasked, 'candidate')} (selection.rounds = {settings.rounds})" if unasked > 0 else ""
    )
    return f"Not served: {why}{more}."


def _without_asking(mine: Mapping[str, Any], candidates: Sequence[Candidate], fleet: Any, settings: Settings) -> str:
    """Why a vehicle made no proposal."""
    if any(candidate.qou > 0.0 for candidate in candidates):
        return "it had candidates and made no proposal (its transaction may have been refused: see events.parquet)"
    if candidates:
        return "all its candidates have a QoU of 0, and such a UAV is never asked"
    there = [row for row in fleet if row["zone"] == mine["zone"]]
    if not there:
        return f"no UAV is in its zone ({mine['zone']})"
    nearest = min(there, key=lambda row: _distance(mine, row))
    away = f"{_distance(mine, nearest):,.0f} m away, beyond selection.max_distance ({settings.max_distance:,.0f} m)"
    return f"the nearest of {_counted(len(there), 'UAV')} of its zone, {nearest['uav']}, is {away}"


def _distance(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    return float(np.hypot(one["x"] - other["x"], one["y"] - other["y"]))


def _period(
    members: Sequence[Mapping[str, Any]], proposals: Sequence[Mapping[str, Any]], vehicle: str, period: int | None
) -> int:
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


def _settings(run_dir: Path) -> Settings:
    path = run_dir / "scenario.toml"
    if not path.is_file():
        raise RunFolderError(path, None, "a file of the run folder; it is not there")
    try:
        return load_scenario(path).selection
    except ScenarioError as error:
        raise RunFolderError(error.place, error.value, error.expected) from error


def _read(run_dir: Path, name: str, period: int | None) -> list[dict[str, Any]]:
    """Rows of one of the run's tables, of one period or all."""
    path = run_dir / f"{name}.parquet"
    try:
        with path.open("rb") as file:
            table = pq.read_table(file, columns=list(_COLUMNS[name]))
    except FileNotFoundError:
        raise RunFolderError(path, None, "a file of the run folder; it is not there") from None
    except (OSError, pa.ArrowException) as error:
        raise RunFolderError(path, None, f"readable Parquet ({' '.join(str(error).split())})") from error
    missing = [column for column in _COLUMNS[name] if column not in table.column_names]
    if missing:
        raise RunFolderError(path, ", ".join(table.column_names), f"a column {missing[0]!r} among its columns")
    if period is not None:
        table = table.filter(pc.equal(table["period"], period))
    rows: list[dict[str, Any]] = table.to_pylist()
    return rows


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _mbps(kbps: float) -> str:
    return f"{kbps / 1000:,.3f} Mbit/s"
