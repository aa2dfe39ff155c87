"""Near-feasible stable matching at the size of a city: time, memory, rounds, blocking pairs, excess.

    python benchmarks/near_feasible.py [--json] [--largest 1000000] [--unchecked]

Each case is measured in a process of its own, from the tables (or the list of pairs) to the matching; the better of
two. Blocking pairs are counted by `selection.stability`, which shares nothing with the matching, over all candidate
pairs (107 million in the largest city: `--unchecked` leaves them out). "Scarce" are the paper's bandwidths: a UAV for
100 vehicles, and 4 % of them served; "balanced" gives a UAV 25 times as much, about what vehicles ask for in all. The
list of pairs is each vehicle's 20 nearest UAVs, shuffled.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from selection import best_time, instance

from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.scenario import Selection
from skyrelay.selection import count_blocking_pairs, near_feasible_matching
from skyrelay.selection.near_feasible import near_feasible
from skyrelay.selection.quality import density, pair_qou, pair_qov

NEAREST = 20
CASES: dict[str, tuple[str, float, str]] = {
    # drawn as, bandwidth as a multiple, from what
    "city 10k x 1k, scarce": ("city 10k x 1k", 1.0, "tables"),
    "city 100k x 5k, scarce": ("city 100k x 5k", 1.0, "tables"),
    "city 1M x 10k, scarce": ("city 1M x 10k", 1.0, "tables"),
    "city 1M x 10k, balanced": ("city 1M x 10k", 25.0, "tables"),
    "city 1M x 10k, scarce, list of 20M pairs": ("city 1M x 10k", 1.0, "pairs"),
    "city 1M x 10k, balanced, list of 20M pairs": ("city 1M x 10k", 25.0, "pairs"),
}


def drawn(case: str) -> tuple[VehicleTable, UavTable, Selection]:
    """The tables of a case."""
    name, times, _ = CASES[case]
    vehicles, uavs, scenario = instance(name)
    rule = scenario.selection
    more = rule.model_copy(update={"max_uav_bandwidth": rule.max_uav_bandwidth * times})
    return vehicles, replace(uavs, bandwidth=uavs.bandwidth * times), more


def nearest_pairs(vehicles: VehicleTable, uavs: UavTable, rule: Selection) -> dict[str, Any]:
    """Each vehicle's nearest UAVs, shuffled, as `near_feasible_matching` takes them."""
    tree = cKDTree(np.column_stack([uavs.x, uavs.y]))
    _, near = tree.query(np.column_stack([vehicles.x, vehicles.y]), k=NEAREST, workers=-1)
    vehicle, uav = np.repeat(np.arange(len(vehicles)), NEAREST), near.ravel()
    order = np.random.default_rng(1).permutation(len(vehicle))
    vehicle, uav = vehicle[order], uav[order]
    score = density(pair_qov(vehicles, uavs, vehicle, uav, rule), vehicles.demand[vehicle])
    return {"vehicle": vehicle, "uav": uav, "liking": pair_qou(vehicles, uavs, vehicle, uav, rule), "score": score}


def blocking(pairs: dict[str, Any], demand: Any, capacity: Any, assignment: Any) -> int:
    """Blocking pairs of a list of pairs with each capacity raised to its load, UAV by UAV."""
    load = np.bincount(assignment[assignment >= 0], demand[assignment >= 0], len(capacity))
    raised, found = np.maximum(capacity, load), 0
    order = np.argsort(pairs["uav"], kind="stable")
    mine = pairs["uav"] == assignment[pairs["vehicle"]]
    current = np.full(len(demand), -np.inf)
    current[pairs["vehicle"][mine]] = pairs["liking"][mine]
    for rows in np.split(order, np.flatnonzero(np.diff(pairs["uav"][order])) + 1):
        u, vehicle, score = pairs["uav"][rows[0]], pairs["vehicle"][rows], pairs["score"][rows]
        held = assignment[vehicle] == u
        ranked = np.argsort(score[held])
        above = np.append(np.cumsum(demand[vehicle[held]][ranked][::-1])[::-1], 0.0)
        stays = above[np.searchsorted(score[held][ranked], score, side="left")]
        gains = (pairs["liking"][rows] > current[vehicle]) & (demand[vehicle] <= capacity[u])
        found += int((gains & (demand[vehicle] <= raised[u] - stays)).sum())
    return found


def measure(case: str, checked: bool) -> dict[str, Any]:
    """One case."""
    vehicles, uavs, rule = drawn(case)
    if CASES[case][2] == "pairs":
        pairs = nearest_pairs(vehicles, uavs, rule)
        amounts = {"demand": vehicles.demand, "capacity": uavs.bandwidth}
        found, wall, processor = best_time(lambda: near_feasible_matching(**pairs, **amounts), 0.0)
    else:
        found, wall, processor = best_time(lambda: near_feasible(vehicles, uavs, rule), 0.0)
    result = {
        "seconds": wall,
        "cpu_seconds": processor,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2,
        "rounds": found.rounds,
        "served": int((found.assignment >= 0).sum()),
        "uavs_exceeded": int((found.excess > 0).sum()),
        "max_excess_kbps": float(found.excess.max()),
        "max_demand_kbps": float(vehicles.demand.max()),
        "excess_percent": 100.0 * float(found.excess.sum() / uavs.bandwidth.sum()),
    }
    if checked and CASES[case][2] == "pairs":
        result["blocking_pairs"] = blocking(pairs, vehicles.demand, uavs.bandwidth, found.assignment)
    elif checked:
        result["blocking_pairs"] = count_blocking_pairs(vehicles, uavs, found.assignment, rule)
    return result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--largest", type=int, default=1_000_000, help="leave out cases of more vehicles")
    parser.add_argument("--unchecked", action="store_true", help="do not count blocking pairs")
    parser.add_argument("--case", choices=CASES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        print(json.dumps(measure(options.case, not options.unchecked)))
        return
    results = {}
    for case in CASES:
        if len(instance(CASES[case][0])[0]) > options.largest:
            continue
        call = [sys.executable, __file__, "--case", case, *(["--unchecked"] if options.unchecked else [])]
        results[case] = json.loads(subprocess.run(call, capture_output=True, text=True, check=True).stdout)
    if options.json:
        print(json.dumps(results, indent=1))
        return
    print(f"{'':<44}{'wall':>9}{'cpu':>9}{'peak':>10}{'rounds':>8}{'served':>9}{'blocking':>10}  excess: most, share")
    for case, entry in results.items():
        print(
            f"{case:<44}{entry['seconds']:>7.2f} s{entry['cpu_seconds']:>7.2f} s{entry['peak_gib']:>6.2f} GiB"
            f"{entry['rounds']:>8}{entry['served']:>9,}{entry.get('blocking_pairs', '-'):>10}"
            f"{entry['max_excess_kbps']:>9,.0f} of {entry['max_demand_kbps']:,.0f} kbit/s, "
            f"{entry['excess_percent']:.1f} %"
        )


if __name__ == "__main__":
    main()
