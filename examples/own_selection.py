"""A selection method of your own, flown in a run beside the shipped ones.

The contract checks what it can of any method: that no UAV takes more than its bandwidth holds, and nobody twice.

python examples/own_selection.py --out out/own-selection
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import skyrelay as sr
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.candidates import candidate_pairs


def best_payer_first(vehicles: sr.VehicleTable, uavs: sr.UavTable, settings: Settings) -> np.ndarray:
    """[V] index of each vehicle's UAV, or -1. Whoever pays most chooses first: its best UAV that has room."""
    pairs = candidate_pairs(vehicles, uavs, settings)
    left = uavs.bandwidth.copy()
    assignment = np.full(len(vehicles), -1)
    for vehicle in np.argsort(-vehicles.payment, kind="stable"):
        mine = np.flatnonzero(pairs.vehicle == vehicle)
        for pair in mine[np.argsort(-pairs.qou[mine], kind="stable")]:
            if left[pairs.uav[pair]] >= vehicles.demand[vehicle]:
                assignment[vehicle] = pairs.uav[pair]
                left[pairs.uav[pair]] -= vehicles.demand[vehicle]
                break
    return assignment


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/own-selection"))
    parser.add_argument("--steps", type=int, default=100)
    arguments = parser.parse_args()
    print(f"{'method':<18} {'served':>6} {'in range':>9} {'mean QoU':>9} {'mean QoV':>9}")
    for name, method in (("two-sided", "two-sided"), ("nearest", "nearest"), ("best-payer-first", best_payer_first)):
        settings = {"coordination.steps": arguments.steps}
        run = sr.run("bologna", out=arguments.out / name, method=method, settings=settings, force=True)
        told = run.summary
        marks = f"{told.mean_qou:>9.1f} {told.mean_qov:>9.1f}"
        print(f"{name:<18} {told.served_per_period:>6.0f} {told.in_range:>9.0f} {marks}")


if __name__ == "__main__":
    main()
