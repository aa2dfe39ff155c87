"""Where a UAV may fly that comes from another zone."""

import numpy as np
import pytest

from skyrelay.airspace.flight import STAY, move
from skyrelay.airspace.law import Law
from skyrelay.core.scenario import Energy
from skyrelay.core.zones import ZoneGrid

LAW = Law(
    ZoneGrid(0.0, 0.0, 1000.0, 2, 2), reach=500.0, speed=30.0, seconds=2.0, energy=Energy(), walls=None, patience=10.0
)


def test_inside_its_zone_a_uav_is_fenced_by_the_zone_alone():
    low, high = LAW.fence(2, np.array([1200.0, 300.0]))
    assert low.tolist() == [1000.0, 0.0]
    assert high.tolist() == [2000.0, 1000.0]
    assert LAW.way_in(2, (1200.0, 300.0)) is None


@pytest.mark.parametrize("place", [(120.0, 700.0), (990.0, 1800.0), (1500.0, 1999.0)])
def test_from_another_zone_it_flies_in_without_a_jump(place):
    here, steps = np.array([place]), 0
    while (action := LAW.way_in(2, tuple(here[0]))) is not None:
        assert action != STAY
        end = move(here, np.array([action]), np.array(LAW.stride), *LAW.fence(2, here[0]))
        assert 0.0 < np.hypot(*(end - here)[0]) <= LAW.stride + 1e-3
        here, steps = end, steps + 1
        assert steps < 40
    assert LAW.grid.zone_of(here[:, 0], here[:, 1])[0] == 2
