"""A selection method of your own beside the shipped ones, on the same vehicles and UAVs.

python examples/own_selection.py
"""

from __future__ import annotations

import numpy as np

from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.core.scenario import load_scenario
from skyrelay.selection import METHODS, Selection, evaluate, is_valid, select
from skyrelay.selection.candidates import candidate_pairs
from skyrelay.selection.instances import draw_instance
from skyrelay.selection.quality import pair_qou, pair_qov


def best_payer_first(vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> Selection:
    """Whoever pays most chooses first: its candidate of highest QoU that still has the bandwidth."""
    pairs = candidate_pairs(vehicles, uavs, settings)
    quality = pair_qou(vehicles, uavs, pairs.vehicle, pairs.uav, settings)
    left = uavs.bandwidth.copy()
    assignment = np.full(len(vehicles), -1)
    for vehicle in np.argsort(-vehicles.payment, kind="stable"):
        mine = np.flatnonzero(pairs.vehicle == vehicle)
        for pair in mine[np.argsort(-quality[mine], kind="stable")]:
            if left[pairs.uav[pair]] >= vehicles.demand[vehicle]:
                assignment[vehicle] = pairs.uav[pair]
                left[pairs.uav[pair]] -= vehicles.demand[vehicle]
                break
    served = np.flatnonzero(assignment >= 0)
    qou, qov = np.full(len(vehicles), np.nan), np.full(len(vehicles), np.nan)
    qou[served] = pair_qou(vehicles, uavs, served, assignment[served], settings)
    qov[served] = pair_qov(vehicles, uavs, served, assignment[served], settings)
    return Selection("best-payer-first", assignment, qou, qov)


def main() -> None:
    scenario = load_scenario("paper", ["selection.candidates=zone"])
    settings = scenario.selection
    vehicles, uavs = draw_instance(vehicles=200, uavs=40, seed=1, scenario=scenario)
    selections = [select(vehicles, uavs, method, settings=settings, time_limit=10) for method in METHODS]
    selections.append(best_payer_first(vehicles, uavs, settings))
    print(f"{'method':<18} {'served':>6} {'mean QoU':>9} {'mean QoV':>9} {'blocking pairs':>15}")
    for selection in selections:
        if not is_valid(vehicles, uavs, selection.assignment, settings):
            raise SystemExit(f"{selection.method}: a UAV has more vehicles than bandwidth, or one that is no candidate")
        metrics = evaluate(vehicles, uavs, selection, settings)
        print(
            f"{selection.method:<18} {metrics.served:>6} {metrics.mean_qou:>9.1f} {metrics.mean_qov:>9.1f} "
            f"{metrics.blocking_pairs:>15}"
        )


if __name__ == "__main__":
    main()
