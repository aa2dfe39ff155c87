import numpy as np
import pytest

from skyrelay.runfolder.figures import over_the_run

METRICS = {
    "step": [0, 0, 1, 1, 2, 2],
    "zone": [1, 0, 1, 0, 1, 0],
    "connected": [9, 99, 5, 10, 5, 30],
    "vehicles": [9, 99, 4, 8, 2, 2],
    "covered": [9, 0, 4, 6, 2, 2],
    "static_vehicles": [9, 99, 0, 4, 0, 6],
    "static_covered": [9, 0, 0, 1, 0, 4],
    "connectivity": [0, 0, 0, 1.0, 0, 0.5],
    "connectivity_neighbor": [0, 0, 0, 1.0, 0, 1.0],
    "static_connectivity": [0, 0, 0, np.nan, 0, 0.25],
    "served_mbps": [0, 0, 0, 10.0, 0, 30.0],
    "static_served_mbps": [0, 0, 0, 1.0, 0, 2.0],
    "energy_percent": [0, 0, 0, 50.0, 0, 40.0],
}


def test_counts_are_summed_measures_averaged_and_the_first_moment_is_left_out():
    figures = over_the_run({name: np.array(column) for name, column in METRICS.items()})
    assert figures == {
        "connected": 20.0,
        "in_range": 4.0,
        "static_in_range": 2.5,
        "in_range_share": 0.2,
        "static_in_range_share": 0.125,
        "coverage": 0.8,
        "static_coverage": 0.5,
        "connectivity": 0.75,
        "connectivity_neighbor": 1.0,
        "static_connectivity": 0.25,
        "served_mbps": 20.0,
        "static_served_mbps": 1.5,
        "energy_percent": 40.0,
    }


@pytest.mark.parametrize("rows", [slice(0, 0), slice(0, 2)])
def test_a_share_of_nobody_is_none(rows):
    figures = over_the_run({name: np.array(column)[rows] for name, column in METRICS.items()})
    assert set(figures.values()) == {None}
