"""What somebody who watched a run would have been told to look at."""

from __future__ import annotations

import json

import numpy as np

from skyrelay.core.resolved import charging_points
from skyrelay.runfolder import Run
from skyrelay.runfolder.feed import LOW_BATTERY, Alert


def alerts(run: Run) -> list[tuple[int, Alert]]:
    """By step: batteries that run low, UAVs that land, and allocations that came after their period's first step."""
    found = [*_batteries(run), *_late(run)]
    return sorted(found, key=lambda one: (one[0], one[1].about))


def _batteries(run: Run) -> list[tuple[int, Alert]]:
    found = []
    reserve = run.scenario.energy.reserve
    charged = bool(charging_points(run.scenario, run.grid))  # who leaves is on its way there
    order = np.lexsort((run.uavs["step"], run.uavs["uav"].astype(str)))
    columns = (run.uavs[name][order].tolist() for name in ("step", "uav", "zone", "battery"))
    warned, landed, last = False, False, ""
    for step, uav, zone, battery in zip(*columns, strict=True):
        if uav != last:
            warned, landed, last = False, False, uav
        if zone == 0 and not landed and not charged:
            landed = True
            found.append((step, Alert("low-battery", uav, f"{uav} has landed, its battery at {battery:.1f} %")))
        elif charged and battery > reserve + LOW_BATTERY:
            warned = False
        elif not warned and not landed and battery <= reserve + LOW_BATTERY:
            warned = True
            found.append((step, Alert("low-battery", uav, f"{uav} has {battery:.1f} % left")))
    return found


def _late(run: Run) -> list[tuple[int, Alert]]:
    found = []
    names, steps = run.events["name"], run.events["step"]
    due = (steps % run.summary.period_steps == 0) | np.isin(steps, list(run.scenario.reselections))
    for row in np.flatnonzero((names == "ZoneAllocated") & ~due).tolist():
        zone = json.loads(run.events["args"][row]).get("zone", "")
        late = int(steps[row]) % run.summary.period_steps
        text = f"zone {zone} was allocated {late} steps after its period began"
        found.append((int(steps[row]), Alert("late-allocation", str(zone)[:256], text[:500])))
    return found
