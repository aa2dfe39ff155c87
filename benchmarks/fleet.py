"""What each part of the fleet's behaviour adds to the traffic carried, in whole runs; 95 % intervals over seeds.

python benchmarks/fleet.py --seeds 10
python benchmarks/fleet.py --seeds 3 --set mobility.source=manhattan --set mobility.area=4000
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.simulation import play

PARTS = {
    "learned, one round": ["coordination.policy=generalist", "selection.rounds=1"],
    "learned": ["coordination.policy=generalist"],
    "serve": ["coordination.policy=serve"],
    "learned, dispatch": ["coordination.policy=generalist", "coordination.dispatch=true"],
    "serve, dispatch": ["coordination.policy=serve", "coordination.dispatch=true"],
    "serve, dispatch, period of 10": [
        "coordination.policy=serve",
        "coordination.dispatch=true",
        "coordination.period_steps=10",
    ],
    "learned, again every 5": ["coordination.policy=generalist", "coordination.reselect_steps=5"],
    "learned, again every 2": ["coordination.policy=generalist", "coordination.reselect_steps=2"],
    "serve, dispatch, again every 5": [
        "coordination.policy=serve",
        "coordination.dispatch=true",
        "coordination.reselect_steps=5",
    ],
    "serve, dispatch, again every 2": [
        "coordination.policy=serve",
        "coordination.dispatch=true",
        "coordination.reselect_steps=2",
    ],
}
"""Each way of flying, by the keys of the scenario that differ from `COMMON`."""
COMMON = ["selection.rounds=5", "coordination.dispatch=false", "coordination.reselect_steps=0"]


def interval(values: np.ndarray) -> list[float]:
    """Mean and half of the 95 % interval."""
    half = stats.sem(values) * stats.t.ppf(0.975, len(values) - 1) if len(values) > 1 else 0.0
    return [round(float(values.mean()), 3), round(float(half), 3)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--parts", default=",".join(map(str, range(len(PARTS)))), help="numbers, from 0")
    args = parser.parse_args()
    names = [list(PARTS)[int(part)] for part in args.parts.split(",")]
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for seed in range(1, args.seeds + 1):
        for name in names:
            with tempfile.TemporaryDirectory() as folder:
                scenario = load_scenario("bologna", [*COMMON, *args.overrides, *PARTS[name]], seed)
                runs[name].append(play(scenario, Path(folder), Silent()))
    rows = []
    first = np.array([summary["carried_mbps"] for summary in runs[names[0]]])
    first_hovering = np.array([summary["static_carried_mbps"] for summary in runs[names[0]]])
    for name, summaries in runs.items():
        flying, hovering, gas = (
            np.array([summary[key] for summary in summaries], dtype=float)
            for key in ("carried_mbps", "static_carried_mbps", "gas_used")
        )
        rows.append(
            {
                "part": name,
                "over_first": interval(flying / first),
                "carried_mbps": interval(flying),
                "over_hovering": interval(flying / hovering),
                "over_hovering_of_first": interval(flying / first_hovering),
                "hand_overs": interval(np.array([summary["handovers"] for summary in summaries])),
                "gas_millions": interval(gas / 1e6),
                "seeds": flying.round(1).tolist(),
                "connectivity": interval(np.array([summary["connectivity"] for summary in summaries])),
            }
        )
    print(json.dumps({"seeds": args.seeds, "overrides": args.overrides, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
