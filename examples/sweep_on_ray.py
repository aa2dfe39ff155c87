"""A sweep over fleet sizes and seeds on a Ray cluster, or on this machine's cores by Ray.

pip install ".[ray]"
python examples/sweep_on_ray.py --uavs 18 27 36 --seeds 3
python examples/sweep_on_ray.py --address ray://head:10001
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from statistics import mean

import skyrelay as sr


def one_run(uavs: int, seed: int, steps: int) -> tuple[float, float]:
    """A whole run in a worker, its folder not kept: vehicles in range and connected, at a time."""
    settings = {"fleet.uavs": uavs, "coordination.steps": steps}
    with tempfile.TemporaryDirectory() as place:
        summary = sr.run("bologna", out=Path(place) / "run", seed=seed, settings=settings, report=False).summary
    return summary.in_range or 0.0, summary.connected or 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--address", help="of a cluster; left out: this machine")
    parser.add_argument("--uavs", type=int, nargs="+", default=[18, 36])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--steps", type=int, default=100)
    arguments = parser.parse_args()
    try:
        import ray
    except ImportError:
        sys.exit("This example needs Ray: pip install '.[ray]'")
    ray.init(address=arguments.address or "local", log_to_driver=False)
    run = ray.remote(num_cpus=1)(one_run)
    asked = {
        uavs: [run.remote(uavs, seed, arguments.steps) for seed in range(1, arguments.seeds + 1)]
        for uavs in arguments.uavs
    }
    for uavs, runs in asked.items():
        results = ray.get(runs)
        inside, connected = (mean(values) for values in zip(*results, strict=True))
        print(f"{uavs:3} UAVs: {inside:5.1f} of {connected:.0f} vehicles in range at a time")
    ray.shutdown()


if __name__ == "__main__":
    main()
