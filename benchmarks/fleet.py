"""What each part of the fleet's behaviour adds to the traffic carried, in whole runs; 95 % intervals over seeds.

python benchmarks/fleet.py --seeds 10
python benchmarks/fleet.py --seeds 3 --set mobility.source=manhattan --set mobility.area=4000
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from scipy import stats

from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.simulation import play

PARTS = {
    "learned, one round": ["coordination.policy=generalist", "selection.rounds=1", "coordination.dispatch=false"],
    "learned": ["coordination.policy=generalist", "selection.rounds=5", "coordination.dispatch=false"],
    "serve": ["coordination.policy=serve", "selection.rounds=5", "coordination.dispatch=false"],
    "learned, dispatch": ["coordination.policy=generalist", "selection.rounds=5", "coordination.dispatch=true"],
    "serve, dispatch": ["coordination.policy=serve", "selection.rounds=5", "coordination.dispatch=true"],
    "serve, dispatch, 20 rounds": ["coordination.policy=serve", "selection.rounds=20", "coordination.dispatch=true"],
    "serve, dispatch, period of 10": [
        "coordination.policy=serve",
        "selection.rounds=5",
        "coordination.dispatch=true",
        "coordination.period_steps=10",
    ],
}
"""Each way of flying, by the keys of the scenario that make it."""


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
    runs: dict[str, list[dict]] = {name: [] for name in names}
    for seed in range(1, args.seeds + 1):
        for name in names:
            with tempfile.TemporaryDirectory() as folder:
                scenario = load_scenario("bologna", [*args.overrides, *PARTS[name]], seed)
                runs[name].append(play(scenario, Path(folder), Silent()))
    rows = []
    first = np.array([summary["carried_mbps"] for summary in runs[names[0]]])
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
                "gas_millions": interval(gas / 1e6),
                "seeds": flying.round(1).tolist(),
                "connectivity": interval(np.array([summary["connectivity"] for summary in summaries])),
            }
        )
    print(json.dumps({"seeds": args.seeds, "overrides": args.overrides, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
