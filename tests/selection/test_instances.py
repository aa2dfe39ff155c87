import numpy as np
import pytest

from skyrelay.core.errors import UsageError
from skyrelay.core.scenario import load_scenario
from skyrelay.selection.instances import draw_instance

PAPER = load_scenario("paper")


def test_the_papers_set_up_is_drawn_within_its_table():
    vehicles, uavs = draw_instance(200, 160, 1, PAPER)
    for column, low, high in (
        (vehicles.x, 0, 50_000),
        (uavs.y, 0, 50_000),
        (vehicles.demand, 1000, 4000),
        (vehicles.payment, 0, 700),
        (vehicles.reputation, 1, 100),
        (uavs.bandwidth, 0, 20_000),
        (uavs.battery, 1, 100),
        (uavs.reputation, 1, 100),
    ):
        assert low <= column.min() < column.max() <= high
        assert np.mean(column) == pytest.approx((low + high) / 2, rel=0.15)
    assert set(uavs.zone.tolist()) <= set(range(1, 26))


def test_a_seed_gives_the_same_tables_and_the_counts_do_not_mix():
    vehicles, uavs = draw_instance(30, 10, 4, PAPER)
    again, more = draw_instance(30, 20, 4, PAPER)
    np.testing.assert_array_equal(vehicles.demand, again.demand)
    assert len(more) == 20
    assert (draw_instance(30, 10, 5, PAPER)[1].x != uavs.x).all()


def test_a_negative_number_is_refused():
    with pytest.raises(UsageError, match="uavs: is -1"):
        draw_instance(1, -1, 1, PAPER)
