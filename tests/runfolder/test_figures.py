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
    "time": [0, 0, 2.0, 2.0, 4.0, 4.0],
    "demand_mbps": [0, 0, 0, 20.0, 0, 60.0],
    "carried_mbps": [0, 0, 0, 10.0, 0, 30.0],
    "delivered_mbps": [0, 0, 0, 8.0, 0, 20.0],
    "static_carried_mbps": [0, 0, 0, 1.0, 0, 3.0],
    "static_delivered_mbps": [0, 0, 0, 0.0, 0, 0.0],
}


def tracks(*vehicles):
    """Each vehicle's (first step, UAVs, rates) step by step; all ask for 100."""
    rows = [
        (first + number, f"v{index}", uav, rate)
        for index, (first, uavs, rates) in enumerate(vehicles)
        for number, (uav, rate) in enumerate(zip(uavs, rates, strict=True))
    ]
    rows.sort(key=lambda row: row[0])
    steps, names, uavs, rates = (np.array(column) for column in zip(*rows, strict=True))
    return {
        "step": steps,
        "vehicle": names,
        "demand_kbps": np.full(len(rows), 100),
        "uav": uavs,
        "delivered_kbps": rates,
        "static_uav": np.full(len(rows), ""),
        "static_delivered_kbps": np.zeros(len(rows)),
    }


VEHICLES = tracks((0, ["c", "a", "a", "b"], [0, 100, 100, 100]), (1, ["", "a", ""], [0, 0, 0]))


def test_counts_are_summed_measures_averaged_and_the_first_moment_is_left_out():
    figures = over_the_run({name: np.array(column) for name, column in METRICS.items()}, VEHICLES)
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
        "demand_mbps": 40.0,
        "carried_mbps": 20.0,
        "delivered_mbps": 14.0,
        "carried_share": 0.5,
        "delivered_share": 0.35,
        "fairness": 0.5,
        "handovers": 1,
        "outage_p95_seconds": 6.0,
        "static_carried_mbps": 2.0,
        "static_delivered_mbps": 0.0,
        "static_carried_share": 0.05,
        "static_delivered_share": 0.0,
        "static_fairness": None,
        "static_handovers": 0,
        "static_outage_p95_seconds": 6.0,
    }


def received(*vehicles):
    figures = over_the_run({name: np.array(column) for name, column in METRICS.items()}, tracks(*vehicles))
    return figures["fairness"], figures["handovers"], figures["outage_p95_seconds"]


def test_a_handover_is_to_another_uav_than_the_last_and_a_way_back_is_one():
    assert received((1, ["a", "", "a", "b", "a"], [1] * 5))[1] == 2
    assert received((1, ["a"], [1]), (2, ["b"], [1]))[1] == 0  # another vehicle


def test_an_outage_ends_where_something_comes_or_the_vehicle_is_gone():
    assert received((1, ["a"] * 6, [0, 0, 1, 0, 1, 1]))[2] == 4.0
    assert received((1, ["a"] * 2, [1, 0]), (1, ["a"] * 2, [0, 1]))[2] == 2.0
    assert received((1, ["a"] * 2, [1, 1]))[2] == 0.0
    gap = tracks((1, ["a"] * 3, [0, 0, 0]))
    gap["step"] = np.array([1, 2, 9])
    figures = over_the_run({name: np.array(column) for name, column in METRICS.items()}, gap)
    assert figures["outage_p95_seconds"] == 4.0


def test_of_twenty_outages_the_longest_is_left_out():
    short = [(1, ["a", "a"], [0, 1])] * 19
    assert received(*short, (1, ["a"] * 9, [0] * 9))[2] == 2.0


def test_fairness_is_of_what_each_vehicle_got_in_all():
    assert received((1, ["a", "a"], [100, 0]), (1, ["a", "a"], [0, 100]))[0] == 1.0
    assert received((1, ["a"], [100]), (1, ["a"], [50]))[0] == 0.9


@pytest.mark.parametrize("rows", [slice(0, 0), slice(0, 2)])
def test_a_share_of_nobody_is_none(rows):
    nobody = {name: column[:0] for name, column in VEHICLES.items()}
    figures = over_the_run({name: np.array(column)[rows] for name, column in METRICS.items()}, nobody)
    assert (figures.pop("handovers"), figures.pop("static_handovers")) == (0, 0)
    assert set(figures.values()) == {None}
