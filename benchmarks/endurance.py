"""What ways of taking turns at charging places deliver over hours: whole runs, 95 % intervals over seeds, paired.

python benchmarks/endurance.py --seeds 5 --jobs 2
python benchmarks/endurance.py --seeds 3 --set coordination.steps=900 --set energy.places=3
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from scipy import stats

from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.simulation import play

WAYS = {
    "rotate": ["coordination.policy=serve", "energy.rotation=rotate"],
    "alone": ["coordination.policy=serve", "energy.rotation=alone"],
    "recharge": ["coordination.policy=recharge", "energy.rotation=alone"],
}
"""Each by the keys of the scenario that make it."""
BEGINNING = 600.0
"""What the whole is held against [s]."""


def fly(way: str, seed: int, overrides: list[str]) -> dict[str, float]:
    """A run's figures."""
    scenario = load_scenario("shift", [*overrides, *WAYS[way]], seed)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        summary = play(scenario, Path(folder), Silent())
        seconds = time.process_time() - begin
        metrics = pq.read_table(Path(folder) / "metrics.parquet").to_pandas()
    whole = metrics[(metrics.zone == 0) & (metrics.step > 0)]
    first = whole[whole.time <= BEGINNING]
    last = whole[whole.time > whole.time.max() - BEGINNING]
    return {
        "seed": seed,
        "delivered_mbps": round(float(whole.delivered_mbps.mean()), 2),
        "first_10_minutes": round(float(first.delivered_mbps.mean()), 2),
        "last_10_minutes": round(float(last.delivered_mbps.mean()), 2),
        "demand_mbps": summary["demand_mbps"],
        "lowest_battery": summary["lowest_battery"],
        "landed_empty": summary["uavs_retired"],
        "charged_share": summary["charged_share"],
        "waiting_seconds": summary["waiting_seconds"],
        "handovers": summary["handovers"],
        "gas_millions": round(summary["gas_used"] / 1e6, 1),
        "hours": scenario.coordination.steps * scenario.coordination.step_seconds / 3600.0,
        "cpu_ms_a_step": round(1000.0 * seconds / scenario.coordination.steps, 1),
    }


def interval(values: np.ndarray) -> list[float]:
    """Mean and half of the 95 % interval (Student's t)."""
    half = stats.sem(values) * stats.t.ppf(0.975, len(values) - 1) if len(values) > 1 else 0.0
    return [round(float(values.mean()), 4), round(float(half), 4)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE")
    args = parser.parse_args()
    ways = args.ways.split(",")
    tasks = [(way, seed) for seed in range(1, args.seeds + 1) for way in ways]
    runs: dict[str, list[dict[str, float]]] = {way: [] for way in ways}
    with ProcessPoolExecutor(args.jobs) as pool:
        started = [(way, pool.submit(fly, way, seed, args.overrides)) for way, seed in tasks]
        for way, run in started:
            runs[way].append(run.result())
    by_seed = {way: np.array([run["delivered_mbps"] for run in found]) for way, found in runs.items()}
    told = {
        way: {
            "delivered_mbps": interval(by_seed[way]),
            "of_first_10_minutes": interval(by_seed[way] / [run["first_10_minutes"] for run in found]),
            "over": {other: interval(by_seed[way] / by_seed[other]) for other in ways if other != way},
            "landed_empty": sum(run["landed_empty"] for run in found),
            "lowest_battery": min(run["lowest_battery"] for run in found),
            "runs": found,
        }
        for way, found in runs.items()
    }
    print(json.dumps({"seeds": args.seeds, "overrides": args.overrides, "ways": told}, indent=1))


if __name__ == "__main__":
    main()
