"""What the fleet of a run could have carried at most: linear programs, each bound certified by its dual prices.

A step's program lets every UAV split its bandwidth among all vehicles that it can have within its range by then, had it
flown straight there from where the run began, while its battery can last; each vehicle takes what it asks for, of any
number of UAVs. A radio that is no disc ends at no range: there every vehicle counts as within reach. A real fleet must
serve more at once from one place, each vehicle whole, so that no way of flying and no selection has more. Buildings,
links and team size are left out, which can only raise the bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog
from scipy.sparse import csr_array, vstack

from skyrelay.airspace.law import Law
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.core.errors import UsageError
from skyrelay.core.resolved import resolve
from skyrelay.runfolder.reader import Run, Table, read_run, read_table

MOST_PAIRS = 2_000_000
"""UAVs and vehicles within reach of each other at one step: beyond that a program takes minutes."""
LEVELS = ("free", "periods", "zones")


@dataclass(frozen=True)
class Bound:
    """At one level, means over the steps 1 to N [Mbit/s].

    Attributes:
        level: ``free``: any UAV may serve any vehicle at any time; ``periods``: only one that was there when the
            period's selection was made; ``zones``: and only one that was in the zone where the UAV was in that period.
        mbps: what the fleet could have carried at most.
        share: of it that the run had; None where it is 0.
        by_zone: of ``zones``: the bound of each zone by its id; empty for the others.
        capacity: of the UAVs whose battery can have lasted.
        demand: of the vehicles that the level allows to be served.
    """

    level: str
    mbps: float
    share: float | None
    by_zone: dict[int, float]
    capacity: float
    demand: float


def bound(folder: Path, every: int = 1) -> list[Bound]:
    """The bounds of a run, level by level: ``free`` alone where vehicles were selected within periods, too.

    Args:
        every: look at every so many steps only, for what the run carried as well.
    Raises:
        RunFolderError: the folder is no run's.
        UsageError: more pairs within reach than a program should have, or a step that is not from 1 on.
    """
    if every < 1:
        raise UsageError("--every", every, "a number of steps from 1 on")
    run = read_run(folder)
    law = Law.of(resolve(run.scenario, run.grid), run.grid)
    fleet, members = read_table(folder, "fleet"), read_table(folder, "members")
    steps = np.arange(1, run.summary.steps + 1, every)
    carried = float(np.nanmean(run.metric("carried_mbps")[steps]))
    levels = LEVELS[:1] if run.scenario.reselections else LEVELS
    totals = {level: np.zeros(3) for level in levels}
    by_zone = dict.fromkeys(run.grid.ids, 0.0)
    world = _World(run, law, fleet, members)
    for step in steps.tolist():
        for level in levels:
            reach, demand, capacity, zone = world.at(step, level)
            taken = certified(reach, demand, capacity)
            totals[level] += np.array([taken.sum(), capacity.sum(), demand.sum()])
            if level == "zones":
                for number in np.unique(zone).tolist():
                    by_zone[number] += float(taken[zone == number].sum())
    told = []
    for level in levels:
        mbps, capacity, demand = (totals[level] / len(steps) / 1000.0).tolist()
        zones = {number: value / len(steps) / 1000.0 for number, value in by_zone.items()} if level == "zones" else {}
        told.append(Bound(level, mbps, carried / mbps if mbps > 0.0 else None, zones, capacity, demand))
    return told


def certified(reach: npt.NDArray[np.bool_], demand: FloatArray, capacity: FloatArray) -> FloatArray:
    """Split the UAVs' bandwidth among the vehicles that they reach, as much of it as can be.

    The solver's prices are made feasible and priced out: by weak duality no split is worth more than that, whatever the
    solver's own tolerances are. What is returned adds up to this certificate.

    Args:
        reach: [U, V] whether a UAV can have a vehicle in range.
        demand: [V] [kbit/s].
        capacity: [U] [kbit/s].
    Returns: [V] what each vehicle and the UAVs that it is left to contribute to the bound [kbit/s].
    Raises:
        UsageError: too many pairs.
    Source: HiGHS, as scipy carries it.
    """
    uav, vehicle = np.nonzero(reach)
    if len(uav) > MOST_PAIRS:
        raise UsageError("bound", len(uav), f"at most {MOST_PAIRS:,} pairs of UAV and vehicle within reach at a step")
    if not len(uav):
        return np.zeros(len(demand))
    column, one = np.arange(len(uav)), np.ones(len(uav))
    taken = csr_array((one, (vehicle, column)), shape=(len(demand), len(uav)))
    given = csr_array((one, (uav, column)), shape=(len(capacity), len(uav)))
    programme: Any = linprog  # its stubs know no sparse matrices
    solved = programme(
        -one, A_ub=vstack([taken, given]), b_ub=np.concatenate([demand, capacity]), bounds=(0, None), method="highs"
    )
    prices = np.clip(-solved.ineqlin.marginals[: len(demand)], 0.0, 1.0) if solved.status == 0 else np.ones(len(demand))
    # Of any prices of the vehicles, these of the UAVs are the least that no pair undercuts.
    wanted = np.zeros(len(capacity))
    np.maximum.at(wanted, uav, 1.0 - prices[vehicle])
    total = float(demand @ prices + capacity @ wanted)
    split: FloatArray = (
        np.zeros(len(demand))
        if solved.status
        else np.asarray(np.bincount(vehicle, solved.x, len(demand)), dtype=np.float64)
    )
    found = float(split.sum())
    return split * (total / found) if found > 0.0 else np.full(len(demand), total / max(len(demand), 1))


class _World:
    """A run's vehicles and UAVs, step by step."""

    def __init__(self, run: Run, law: Law, fleet: Table, members: Table) -> None:
        self._law, self._period_steps = law, run.summary.period_steps
        self._vehicles, self._uavs = run.vehicles, run.uavs
        self._there: dict[int, dict[str, int]] = {}
        for period, vehicle, zone in zip(
            members["period"].tolist(), members["vehicle"], members["zone"].tolist(), strict=True
        ):
            self._there.setdefault(period, {})[vehicle] = zone
        start = self._uavs["step"] == 0
        self._names = self._uavs["uav"][start]
        self._start = np.column_stack([self._uavs["x"][start], self._uavs["y"][start]])
        offered = dict(zip(fleet["uav"], fleet["bandwidth_kbps"].tolist(), strict=True))
        self._bandwidth = np.array([offered.get(name, 0) for name in self._names], dtype=np.float64)
        least = min(law.cost.hover, law.cost.move)
        charge = self._uavs["battery"][start] - law.energy.reserve
        charged = law.energy.charge_per_minute > 0.0 or bool(law.places)
        # In the row of the step at which a battery is down to the reserve the UAV has landed.
        self._lasts = np.where(charge > 0.0, np.inf if charged or least <= 0.0 else charge / max(least, 1e-12), 0.0)

    def at(self, step: int, level: str) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray, IntArray]:
        """[U, V] who can have been in whose range; [V] demands; [U] capacities [kbit/s]; [V] zones at the selection."""
        here = np.flatnonzero(self._vehicles["step"] == step)
        period = (step - 1) // self._period_steps
        there = self._there.get(period, {})
        names = self._vehicles["vehicle"][here]
        zone = np.array([there.get(name, 0) for name in names], dtype=np.int64)
        if level != "free":
            here, names, zone = here[zone > 0], names[zone > 0], zone[zone > 0]
        places = np.column_stack([self._vehicles["x"][here], self._vehicles["y"][here]])
        demand = self._vehicles["demand_kbps"][here].astype(np.float64)
        apart = np.hypot(*(places[None] - self._start[:, None]).transpose(2, 0, 1))
        reach = np.ones(apart.shape, dtype=bool)
        if self._law.network.air is None:  # any other radio carries over any distance, however little
            reach = apart <= self._law.reach + step * self._law.stride
        if level == "zones":
            row = self._uavs["step"] == period * self._period_steps + 1
            reach &= self._uavs["zone"][row][:, None] == zone
        capacity = np.where(self._lasts > step, self._bandwidth, 0.0)
        return reach, demand, capacity, zone
