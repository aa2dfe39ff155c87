"""NNM, the paper's benchmark: nearest-neighbour matching on a propensity score made of QoU and QoV.

The paper modifies the matching of Dehejia and Wahba (2002): treated and control units are vehicles and UAVs, and the
propensity score is replaced by the two metrics. It leaves the details open; they are fixed here:

- the score of a vehicle towards a UAV is its QoV there, the score of the UAV towards the vehicle its QoU; the distance
  between two units is the absolute difference of the two;
- a vehicle's acceptable list holds its candidates that still have the bandwidth it asks;
- matching is greedy, in list order and with replacement up to the UAV's bandwidth: the closest score is taken, the
  first of equals, and a match is never undone. Nobody's preference is asked.
"""

from __future__ import annotations

import numpy as np

from skyrelay.core.entities import IntArray, UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.candidates import candidate_pairs
from skyrelay.selection.sequential import take_in_turn


def nearest_neighbor(vehicles: VehicleTable, uavs: UavTable, settings: Settings) -> IntArray:
    """Match by similar score.

    Returns: [V] UAV or -1.
    Source: Section "Selection Mechanism".
    """
    pairs = candidate_pairs(vehicles, uavs, settings)
    return take_in_turn(vehicles, uavs, pairs, np.abs(pairs.qou - pairs.qov), np.arange(len(vehicles)))
