"""How long a policy takes to reach the paper's level, ours beside a PyTorch library's.

The level is a mean return over -5 of the greedy policy on 200 unseen episodes (N = 3, V = 20), tested every 2,048
steps; neither tests nor compilation count. Ours is `skyrelay train --preset fast`, several seeds, as it is and with
``--paper-maps``. The peer is BenchMARL's IPPO on the PettingZoo adapter, with the latter's maps, networks and batch, in
the environment ``.venv/peers`` (`make peers`); where it does not get there in time, the return it reached and a lower
bound of the ratio are printed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from skyrelay.core.statistics import Interval, interval
from skyrelay.learning.presets import Training, training
from skyrelay.learning.training import Report, train

ROOT = Path(__file__).parents[1]
PEERS = ROOT / ".venv" / "peers" / "bin" / "python"
SIZES = ((3, 3), (20, 20))
EVERY, EPISODES = 2048, 200


class ReachedError(Exception):
    """The level is reached."""


def ours(config: Training, level: float) -> dict[str, float]:
    """Train until the level, as the command does; returns steps, seconds of training and of compiling, the return."""
    began = time.perf_counter()
    found: dict[str, float] = {}

    def watch(report: Report) -> None:
        if report.row is None:
            return
        found.setdefault("compile_seconds", time.perf_counter() - began - report.seconds)
        if report.row.get("test_return", level) > level:
            found.update(steps=report.steps, seconds=report.seconds, value=report.row["test_return"])
            raise ReachedError

    with tempfile.TemporaryDirectory() as folder:
        try:
            result = train(config, Path(folder), report=watch, evaluation_episodes=2)
        except ReachedError:
            return found
    last = result.curves[-1]
    return found | {"steps": last["steps"], "seconds": last["seconds"], "value": last["test_return"]}


def peer(level: float, limit: float, seed: int) -> list[dict[str, float]]:
    """The peer's greedy tests: steps, seconds, return."""
    with tempfile.TemporaryDirectory() as folder:
        line = [PEERS, ROOT / "benchmarks" / "peers" / "train_benchmarl.py", "--out", folder, "--seed", seed]
        line += ["--level", level, "--limit", limit, "--every", 2, "--episodes", EPISODES]
        subprocess.run(list(map(str, line)), check=True, stdout=sys.stderr)
        tests: list[dict[str, float]] = json.loads((Path(folder) / "tests.json").read_text())
    return tests


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="trainings of ours")
    parser.add_argument("--level", type=float, default=-5.0)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds of training that the peer gets")
    options = parser.parse_args()
    result: dict[str, Any] = {"level": options.level}

    seconds: dict[str, Interval] = {}
    for name, paper_maps in (("skyrelay", False), ("skyrelay_paper_maps", True)):
        runs = result[name] = []
        for seed in range(options.seeds):
            config = training("fast", *SIZES, seed=seed, paper_maps=paper_maps)
            runs.append(run := ours(replace(config, test_every=EVERY, test_episodes=EPISODES), options.level))
            print(
                f"{name}, seed {seed}: return {run['value']:.2f} after {run['steps']:,.0f} steps, "
                f"{run['seconds']:.1f} s of training (compiling {run['compile_seconds']:.1f} s)",
                flush=True,
            )
        if reached := [run["seconds"] for run in runs if run["value"] > options.level]:
            seconds[name] = mean = interval(reached)
            print(
                f"{name}: {len(reached)} of {len(runs)} seeds over {options.level:g}, "
                f"{mean.mean:.2f} s (95 % interval {mean.low:.2f} to {mean.high:.2f})"
            )

    if not PEERS.exists():
        print("BenchMARL: not measured, there is no environment .venv/peers (make peers makes it)")
    else:
        tests = peer(options.level, options.limit, seed=0)
        last, best = tests[-1], max(test["return"] for test in tests)
        result["benchmarl"] = tests
        got_there = last["return"] > options.level
        print(
            f"BenchMARL IPPO: {'reached' if got_there else 'did not reach'} {options.level:g}; "
            f"return {last['return']:.2f} (best {best:.2f}) after {last['steps']:,.0f} steps, "
            f"{last['seconds']:.1f} s of training"
        )
        for name, mean in seconds.items():
            result[f"ratio_to_{name}"] = ratio = last["seconds"] / mean.mean
            print(f"BenchMARL over {name}: {'' if got_there else 'more than '}{ratio:.0f} times the time")

    print(json.dumps(result))


if __name__ == "__main__":
    main()
