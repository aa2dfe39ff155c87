"""Time and memory of selection, its growth with the candidate pairs, and its ratio to what one would pick instead.

    python benchmarks/selection.py [--json] [--peer-seconds 60] [--largest 1000000]

Every figure is measured in a process of its own, so that the peak of memory is its own; the best of several repeats
is taken, and its processor time stands beside the wall time. The peers solve the problem that they can: with equal
demands, `matching` finds the same stable matching as all rounds of ours (the assignments are compared) and scipy's
`linear_sum_assignment` the greatest total QoU over the UAVs' places. Both are given our candidate pairs; "theirs" is
from the tables to the assignment as "ours" is, "solving" their solver's own part. `pip install matching` for the first.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.scenario import Mobility, Scenario, Zones
from skyrelay.selection import reference, select
from skyrelay.selection.candidates import candidate_pairs
from skyrelay.selection.instances import draw_instance

CITY_UAVS_PER_KM2 = 4.0  # 10,000 UAVs on 50 x 50 km
CASES: dict[str, tuple[int, int, float, str]] = {
    # vehicles, UAVs, side of the area [km], candidate rule
    "paper 200 x 160": (200, 160, 50.0, "range"),
    "paper 200 x 160, one zone without a range": (200, 160, 50.0, "zone"),
    "city 10k x 1k": (10_000, 1_000, math.sqrt(1_000 / CITY_UAVS_PER_KM2), "range"),
    "city 100k x 5k": (100_000, 5_000, math.sqrt(5_000 / CITY_UAVS_PER_KM2), "range"),
    "city 1M x 10k": (1_000_000, 10_000, 50.0, "range"),
    "dense city 1M x 10k on 20 x 20 km": (1_000_000, 10_000, 20.0, "range"),
}
GROWTH = ("city 10k x 1k", "city 100k x 5k", "city 1M x 10k")
DEMAND = 2500.0
"""[kbit/s] of every vehicle where a peer knows places only."""


def instance(case: str, equal: bool = False) -> tuple[VehicleTable, UavTable, Scenario]:
    """The tables of a case, and its scenario; one zone, so that the range alone decides who is a candidate."""
    vehicles, uavs, side, rule = CASES[case]
    scenario = Scenario(mobility=Mobility(source="random-waypoint", area=1000.0 * side), zones=Zones(columns=1, rows=1))
    scenario = scenario.model_copy(update={"selection": scenario.selection.model_copy(update={"candidates": rule})})
    asking, flying = draw_instance(vehicles, uavs, 1, scenario)
    if equal:
        asking = replace(asking, demand=np.full(vehicles, DEMAND))
    return asking, flying, scenario


def best_time(work: Callable[[], Any], seconds: float = 3.0) -> tuple[Any, float, float]:
    """Result, least wall and least processor time of as many repeats as fit in ``seconds``, at least two."""
    walls: list[float] = []
    processor: list[float] = []
    begin = time.perf_counter()
    while len(walls) < 2 or time.perf_counter() - begin < seconds:
        wall, own = time.perf_counter(), time.process_time()
        result = work()
        walls.append(time.perf_counter() - wall)
        processor.append(time.process_time() - own)
    return result, min(walls), min(processor)


def measure_ours(case: str, rounds: int | str, equal: bool) -> dict[str, Any]:
    """Our selection, peak memory with the tables in it."""
    vehicles, uavs, scenario = instance(case, equal)
    chosen, wall, processor = best_time(
        lambda: select(vehicles, uavs, settings=scenario.selection, rounds=rounds)  # type: ignore[arg-type]
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    return {
        "seconds": wall,
        "cpu_seconds": processor,
        "peak_gib": peak,
        "served": int((chosen.assignment >= 0).sum()),
        "rounds": len(chosen.rounds),
        "pairs": count_pairs(vehicles, uavs, scenario),
    }


def count_pairs(vehicles: VehicleTable, uavs: UavTable, scenario: Scenario) -> int:
    """How many candidate pairs there are."""
    if scenario.selection.candidates == "zone":
        return len(vehicles) * len(uavs)
    trees = [cKDTree(np.column_stack([table.x, table.y])) for table in (vehicles, uavs)]
    return int(trees[0].count_neighbors(trees[1], scenario.selection.max_distance))


def measure_loop(case: str) -> dict[str, Any]:
    """The plain-loop reference, one round; equal to ours."""
    vehicles, uavs, scenario = instance(case)
    begin = time.perf_counter()
    assignment = reference.two_sided(vehicles, uavs, scenario.selection, 1)
    wall = time.perf_counter() - begin
    ours = select(vehicles, uavs, settings=scenario.selection, rounds=1).assignment
    return {"seconds": wall, "agrees": assignment == ours.tolist()}


def measure_matching(case: str) -> dict[str, Any]:
    """`matching`'s hospital-resident solver: making its preference lists (with our pairs), its game, solving."""
    from matching.games import HospitalResident

    sys.setrecursionlimit(10**6)  # it deletes pairs recursively
    vehicles, uavs, scenario = instance(case, equal=True)
    begin = time.perf_counter()
    pairs = candidate_pairs(vehicles, uavs, scenario.selection)
    places = (uavs.bandwidth // DEMAND).astype(int)
    residents: dict[str, list[str]] = {}
    hospitals: dict[str, list[str]] = {}
    order = np.lexsort((pairs.uav, -pairs.qou))
    for vehicle, uav in zip(pairs.vehicle[order], pairs.uav[order], strict=True):
        if places[uav] > 0:
            residents.setdefault(f"v{vehicle}", []).append(f"u{uav}")
    order = np.lexsort((pairs.vehicle, -pairs.qov))
    for vehicle, uav in zip(pairs.vehicle[order], pairs.uav[order], strict=True):
        if places[uav] > 0:
            hospitals.setdefault(f"u{uav}", []).append(f"v{vehicle}")
    capacities = {name: int(places[int(name[1:])]) for name in hospitals}
    game = HospitalResident.create_from_dictionaries(residents, hospitals, capacities)
    solving = time.perf_counter()
    solution = game.solve(optimal="resident")
    end = time.perf_counter()
    theirs = {(str(v), str(u)) for u, members in solution.items() for v in members}
    ours = select(vehicles, uavs, settings=scenario.selection, rounds="full").assignment
    same = {(f"v{v}", f"u{u}") for v, u in enumerate(ours) if u >= 0}
    return {"seconds": end - begin, "solving": end - solving, "agrees": theirs == same}


def measure_assignment(case: str) -> dict[str, Any]:
    """scipy's `linear_sum_assignment` over the UAVs' places: making its matrix (with our pairs), solving."""
    vehicles, uavs, scenario = instance(case, equal=True)
    begin = time.perf_counter()
    pairs = candidate_pairs(vehicles, uavs, scenario.selection)
    places = (uavs.bandwidth // DEMAND).astype(int)
    worth = np.zeros((len(vehicles), len(uavs)))
    worth[pairs.vehicle, pairs.uav] = pairs.qou
    matrix = np.repeat(worth, places, axis=1)
    solving = time.perf_counter()
    rows, columns = linear_sum_assignment(matrix, maximize=True)
    end = time.perf_counter()
    ours = select(vehicles, uavs, settings=scenario.selection, rounds="full")
    return {
        "seconds": end - begin,
        "solving": end - solving,
        "total_qou": float(matrix[rows, columns].sum()),
        "our_total_qou": float(np.nansum(ours.qou)),
    }


def measure_milp(case: str) -> dict[str, Any]:
    """The MILP (HiGHS), unequal demands, greatest total QoU."""
    vehicles, uavs, scenario = instance(case)
    begin = time.perf_counter()
    chosen = select(vehicles, uavs, "optimal", settings=scenario.selection)
    return {"seconds": time.perf_counter() - begin, "gap": chosen.gap}


def in_a_process(what: str, case: str, seconds: float) -> dict[str, Any]:
    """One measurement in a fresh process; empty of figures where it did not finish."""
    call = [sys.executable, __file__, "--measure", what, "--case", case]
    try:
        done = subprocess.run(call, capture_output=True, text=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        return {"note": f"not finished in {seconds:g} s"}
    if done.returncode:
        return {"note": done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"status {done.returncode}"}
    result: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return result


MEASURES: dict[str, Callable[[str], dict[str, Any]]] = {
    "ours": lambda case: measure_ours(case, 1, equal=False),
    "ours, all rounds": lambda case: measure_ours(case, "full", equal=False),
    "ours, all rounds, equal demands": lambda case: measure_ours(case, "full", equal=True),
    "plain loop": measure_loop,
    "matching": measure_matching,
    "linear_sum_assignment": measure_assignment,
    "MILP": measure_milp,
}
PEERS = {
    "plain loop": "ours",
    "MILP": "ours",
    "matching": "ours, all rounds, equal demands",
    "linear_sum_assignment": "ours, all rounds, equal demands",
}
"""Each peer, and which of ours solves its problem."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--peer-seconds", type=float, default=60.0, help="time a peer gets for a case")
    parser.add_argument("--largest", type=int, default=1_000_000, help="leave out cases of more vehicles")
    parser.add_argument("--measure", choices=MEASURES, help=argparse.SUPPRESS)
    parser.add_argument("--case", choices=CASES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(MEASURES[options.measure](options.case)))
        return
    cases = [case for case in CASES if CASES[case][0] <= options.largest]
    ours = {case: in_a_process("ours", case, 600.0) for case in cases}
    peers: dict[str, dict[str, Any]] = {}
    stopped: set[str] = set()
    for case in [name for name in cases if CASES[name][0] <= 100_000]:
        for peer, counterpart in PEERS.items():
            if peer in stopped:
                continue  # it did not finish a smaller case
            theirs = in_a_process(peer, case, options.peer_seconds)
            if "seconds" not in theirs:
                stopped.add(peer)
                peers[f"{peer}: {case}"] = theirs
                continue
            mine = ours[case] if counterpart == "ours" else in_a_process(counterpart, case, 600.0)
            peers[f"{peer}: {case}"] = theirs | {"ours": mine["seconds"], "ratio": theirs["seconds"] / mine["seconds"]}
    growth = [ours[case] for case in GROWTH if "seconds" in ours.get(case, {})]
    exponent = None
    if len(growth) > 1:
        logs = np.log([[entry["pairs"], entry["cpu_seconds"]] for entry in growth])
        exponent = float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])
    if options.json:
        print(json.dumps({"ours": ours, "peers": peers, "growth_exponent": exponent}, indent=1))
        return
    print(f"{'two-sided, one round':<44}{'wall':>10}{'cpu':>10}{'peak':>11}{'pairs':>14}")
    for case, entry in ours.items():
        print(
            f"{case:<44}{entry['seconds']:>8.4f} s{entry['cpu_seconds']:>8.4f} s{entry['peak_gib']:>7.2f} GiB"
            f"{entry['pairs']:>14,}"
            if "seconds" in entry
            else f"{case:<44}{entry['note']}"
        )
    if exponent is not None:
        print(f"\ngrowth of processor time with candidate pairs (constant city density): exponent {exponent:.2f}")
    print(f"\n{'peer':<66}{'theirs':>11}{'solving':>11}{'ours':>11}{'ratio':>10}")
    for name, entry in peers.items():
        note = "" if entry.get("agrees") is None else "   same assignment" if entry["agrees"] else "   DIFFERS"
        print(
            f"{name:<66}{entry['seconds']:>9.4f} s{entry.get('solving', entry['seconds']):>9.4f} s"
            f"{entry['ours']:>9.4f} s{entry['ratio']:>9.3g}x{note}"
            if "seconds" in entry
            else f"{name:<66}{entry['note']}"
        )


if __name__ == "__main__":
    main()
