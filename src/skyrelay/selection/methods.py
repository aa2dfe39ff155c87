"""Every selection method behind one call."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from skyrelay.core import plugins
from skyrelay.core.entities import FloatArray, IntArray, UavTable, VehicleTable
from skyrelay.core.errors import SelectionError, SkyRelayError, UsageError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.deferred_acceptance import Round, deferred_acceptance
from skyrelay.selection.load_aware import load_aware_lists
from skyrelay.selection.near_feasible import near_feasible
from skyrelay.selection.nearest_neighbor import nearest_neighbor
from skyrelay.selection.optimal import Objective, optimal
from skyrelay.selection.quality import pair_qou, pair_qov
from skyrelay.selection.sequential import nearest, random
from skyrelay.selection.stability import count_blocking_pairs, excess, is_valid

METHODS = ("two-sided", "near-feasible", "load-aware", "nnm", "optimal", "nearest", "random")
OBJECTIVES = ("qou", "qov", "served")
GROUP = "skyrelay.methods"
"""Of entry points."""

ANY_GAIN = 1e9
"""Points of QoU, as a hysteresis: more than any UAV is better."""

Method = Callable[[VehicleTable, UavTable, Settings], IntArray]
"""An own method: [V] index of each vehicle's UAV, or -1."""


@dataclass(frozen=True)
class Selection:
    """Which UAV serves which vehicle.

    Attributes:
        method: one of `METHODS`, or an own one's name.
        assignment: [V] index of the UAV, or -1.
        qou, qov: [V] of the vehicle with its UAV, NaN where it has none.
        rounds: of proposals, as played; empty for the methods that have none.
        objective: what ``optimal`` maximised, and the total it reached; None for the others.
        gap: of ``optimal``: (bound - total) / total, 0 where proved optimal, infinite where there is no bound yet; None
            for the others.
    """

    method: str
    assignment: IntArray
    qou: FloatArray
    qov: FloatArray
    rounds: tuple[Round, ...] = ()
    objective: tuple[str, float] | None = None
    gap: float | None = None


@dataclass(frozen=True)
class Metrics:
    """A selection in numbers; a mean over nothing is None.

    Attributes:
        vehicles, uavs: how many there were.
        served: vehicles that have a UAV.
        served_percent: of the vehicles.
        uavs_selected: UAVs that serve at least one vehicle.
        uavs_selected_percent: of the UAVs.
        vehicles_per_uav: served vehicles per selected UAV.
        mean_qou, mean_qov: over the served vehicles.
        used_bandwidth: that the served vehicles asked [kbit/s].
        used_bandwidth_percent: of what all UAVs have.
        excess_bandwidth: that UAVs promised above what they have, in all [kbit/s]; only ``near-feasible`` does.
        max_excess: of one UAV [kbit/s].
        uavs_exceeded: how many UAVs promised more than they have.
        blocking_pairs: see `stability.count_blocking_pairs`.
    """

    vehicles: int
    uavs: int
    served: int
    served_percent: float | None
    uavs_selected: int
    uavs_selected_percent: float | None
    vehicles_per_uav: float | None
    mean_qou: float | None
    mean_qov: float | None
    used_bandwidth: float
    used_bandwidth_percent: float | None
    excess_bandwidth: float
    max_excess: float
    uavs_exceeded: int
    blocking_pairs: int


def select(
    vehicles: VehicleTable,
    uavs: UavTable,
    method: str | None = None,
    *,
    settings: Settings | None = None,
    rounds: int | Literal["full"] | None = None,
    incumbent: IntArray | None = None,
    hysteresis: float | FloatArray | None = None,
    objective: str = "qou",
    time_limit: float | None = None,
    gap: float = 1e-4,
    seed: int = 0,
    within: bool = False,
) -> Selection:
    """Select a UAV for each vehicle.

    Args:
        method: ``two-sided`` (the paper's), ``near-feasible`` (stable, bandwidths exceeded by less than one demand),
            ``load-aware`` (QoU lowered by what is asked of a UAV), ``nnm`` (the paper's benchmark), ``optimal`` (MILP),
            ``nearest`` or ``random``; an entry point of the group `GROUP`, or ``module:function`` that the user has
            named: `Method`; left out: as ``settings`` say.
        settings: weights, maxima, candidate rule; left out: the defaults of a scenario's ``[selection]``.
        rounds: of ``two-sided`` and ``load-aware``: 1 is the paper; more: a refused or displaced vehicle proposes
            again; ``"full"``: until nobody has anyone left to ask (deferred acceptance); left out: as ``settings`` say.
        incumbent: of ``two-sided``: [V] index of the UAV that serves each vehicle now, or -1.
        hysteresis: of ``two-sided``: how many points of QoU above its incumbent another UAV must have for a vehicle to
            ask it first, one number or [V]; left out: as ``settings`` say.
        objective: of ``optimal``: the total of ``qou``, of ``qov``, or the number ``served``.
        time_limit: of ``optimal``: [s] after which the best assignment found is taken; None: no limit.
        gap: of ``optimal``: share of the bound within which an assignment is good enough.
        seed: of ``random``.
        within: of ``near-feasible``: hold UAVs to their bandwidths, as the contract does. They choose among the
            vehicles that they were given by Algorithm 2; who is refused asks on, until nobody has anyone left to ask.
    Raises:
        UsageError: a method, an objective or a number of rounds that there is not.
        SelectionError: an incumbent that is no UAV of the table; an own method that raises, or breaks the rules.
    """
    rule = settings or Settings()
    method = rule.method if method is None else method
    if method not in METHODS:
        return _result(vehicles, uavs, _by_own(named(method), method, vehicles, uavs, rule), rule, method)
    if method == "two-sided":
        assignment, played = deferred_acceptance(
            vehicles,
            uavs,
            rule,
            round_limit(rule.rounds if rounds is None else rounds),
            _checked_incumbent(incumbent, vehicles, uavs),
            check_hysteresis(rule.hysteresis if hysteresis is None else hysteresis, len(vehicles)),
        )
        return _result(vehicles, uavs, assignment, rule, method, rounds=played)
    if method == "load-aware":
        limit, lists = round_limit(rule.rounds if rounds is None else rounds), load_aware_lists(vehicles, uavs, rule)
        assignment, played = deferred_acceptance(vehicles, uavs, rule, limit, preferences=lists)
        return _result(vehicles, uavs, assignment, rule, method, rounds=played)
    if method == "near-feasible":
        assignment = near_feasible(vehicles, uavs, rule).assignment
        if within:
            # Whoever has a UAV asks it first, whatever others offer.
            assignment, _ = deferred_acceptance(vehicles, uavs, rule, None, assignment, ANY_GAIN)
        return _result(vehicles, uavs, assignment, rule, method)
    if method == "optimal":
        _check(objective, OBJECTIVES, "objective")
        assignment, total, left = optimal(vehicles, uavs, rule, cast("Objective", objective), time_limit, gap)
        return _result(vehicles, uavs, assignment, rule, method, objective=(objective, total), gap=left)
    if method == "nnm":
        return _result(vehicles, uavs, nearest_neighbor(vehicles, uavs, rule), rule, method)
    if method == "nearest":
        return _result(vehicles, uavs, nearest(vehicles, uavs, rule), rule, method)
    return _result(vehicles, uavs, random(vehicles, uavs, rule, seed), rule, method)


def evaluate(vehicles: VehicleTable, uavs: UavTable, selection: Selection, settings: Settings | None = None) -> Metrics:
    """Measure a selection, blocking pairs included."""
    served = np.flatnonzero(selection.assignment >= 0)
    selected = len(np.unique(selection.assignment[served]))
    over = excess(vehicles, uavs, selection.assignment)
    used, available = float(vehicles.demand[served].sum()), float(uavs.bandwidth.sum())
    return Metrics(
        vehicles=len(vehicles),
        uavs=len(uavs),
        served=len(served),
        served_percent=100.0 * len(served) / len(vehicles) if len(vehicles) else None,
        uavs_selected=selected,
        uavs_selected_percent=100.0 * selected / len(uavs) if len(uavs) else None,
        vehicles_per_uav=len(served) / selected if selected else None,
        mean_qou=float(selection.qou[served].mean()) if selected else None,
        mean_qov=float(selection.qov[served].mean()) if selected else None,
        used_bandwidth=used,
        used_bandwidth_percent=100.0 * used / available if available else None,
        excess_bandwidth=float(over.sum()),
        max_excess=float(over.max(initial=0.0)),
        uavs_exceeded=int((over > 0.0).sum()),
        blocking_pairs=count_blocking_pairs(vehicles, uavs, selection.assignment, settings or Settings()),
    )


def named(method: str) -> Method:
    """An own method.

    Raises:
        UsageError: there is none of that name, or it cannot be loaded.
    """
    found = plugins.load(GROUP, method, {}, "method", METHODS)
    if not callable(found):
        raise UsageError("method", method, "a function of vehicles, UAVs and settings")
    own: Method = found
    return own


def require_method(method: str) -> None:
    """Check that there is such a method.

    Raises:
        UsageError: there is none; the closest name is suggested.
    """
    if method not in METHODS:
        named(method)


def _by_own(own: Method, name: str, vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> IntArray:
    """What an own method answers, if it is a selection.

    Raises:
        SelectionError: it raises, or answers with something else.
    """
    place = f"method {name}"
    try:
        answer = np.asarray(own(vehicles, uavs, settings))
    except SkyRelayError:
        raise
    except Exception as error:  # own code may raise anything
        raise SelectionError(place, None, f"a method that selects ({plugins.fault(error)})") from error
    if answer.shape != (len(vehicles),) or (len(answer) and not np.issubdtype(answer.dtype, np.integer)):
        shown = f"{answer.dtype} of shape {answer.shape}"
        raise SelectionError(f"{place}: answer", shown, f"one whole number for each of {len(vehicles)} vehicles")
    assignment = answer.astype(np.int64)
    wrong = (assignment < -1) | (assignment >= len(uavs))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise SelectionError(f"{place}: answer[{row}]", int(assignment[row]), f"-1 or one of {len(uavs)} UAVs")
    if not is_valid(vehicles, uavs, assignment, settings):
        raise SelectionError(
            f"{place}: answer", None, "candidates of QoU above 0, and no UAV that serves more than its bandwidth"
        )
    return assignment


def _result(
    vehicles: VehicleTable, uavs: UavTable, assignment: IntArray, settings: Settings, method: str, **extra: Any
) -> Selection:
    served = np.flatnonzero(assignment >= 0)
    qou, qov = np.full(len(vehicles), np.nan), np.full(len(vehicles), np.nan)
    qou[served] = pair_qou(vehicles, uavs, served, assignment[served], settings)
    qov[served] = pair_qov(vehicles, uavs, served, assignment[served], settings)
    return Selection(method, assignment, qou, qov, **extra)


def _check(value: str, known: tuple[str, ...], what: str) -> None:
    if value in known:
        return
    close = difflib.get_close_matches(value.lower(), known, n=1)
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    raise UsageError(what, value, f"one of {', '.join(known)}{hint}")


def round_limit(rounds: int | Literal["full"]) -> int | None:
    """The number of rounds, None for ``"full"``.

    Raises:
        UsageError: it is neither.
    """
    if rounds == "full":
        return None
    if isinstance(rounds, bool) or not isinstance(rounds, int) or rounds < 1:
        raise UsageError("rounds", rounds, "a whole number from 1, or 'full'")
    return rounds


def _checked_incumbent(incumbent: IntArray | None, vehicles: VehicleTable, uavs: UavTable) -> IntArray | None:
    if incumbent is None:
        return None
    if incumbent.shape != (len(vehicles),):
        raise SelectionError("incumbent.shape", incumbent.shape, f"one index for each of {len(vehicles)} vehicles")
    wrong = (incumbent < -1) | (incumbent >= len(uavs))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise SelectionError(f"incumbent[{row}]", int(incumbent[row]), f"-1 or the index of one of {len(uavs)} UAVs")
    return incumbent


def check_hysteresis(hysteresis: float | FloatArray, vehicles: int = 0) -> float | FloatArray:
    """The hysteresis, if it can be one: a number, or one for each of so many vehicles.

    Raises:
        UsageError: it cannot.
    """
    points = np.asarray(hysteresis, dtype=np.float64)
    if points.shape not in {(), (vehicles,)}:
        raise UsageError("hysteresis.shape", points.shape, f"one number, or one for each of {vehicles} vehicles")
    wrong = ~(np.isfinite(points) & (points >= 0.0))
    if wrong.any():
        raise UsageError("hysteresis", float(points[wrong].flat[0]), "a finite number of QoU points, at least 0")
    return hysteresis
