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

from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.runfolder import new_run_folder
from skyrelay.simulation import play


def one_run(uavs: int, seed: int, steps: int) -> dict[str, float]:
    """A whole run in a worker; its folder is not kept."""
    scenario = load_scenario("bologna", [f"fleet.uavs={uavs}", f"coordination.steps={steps}"], seed)
    with tempfile.TemporaryDirectory() as place, new_run_folder(Path(place) / "run") as folder:
        return play(scenario, folder, Silent())


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
        inside = mean(result["in_range"] for result in results)
        print(f"{uavs:3} UAVs: {inside:5.1f} of {results[0]['connected']:.0f} vehicles in range at a time")
    ray.shutdown()


if __name__ == "__main__":
    main()
