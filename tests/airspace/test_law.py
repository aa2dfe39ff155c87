"""What a scenario says of an area's law."""

import numpy as np
import pytest

from skyrelay.airspace.law import Law
from skyrelay.core.resolved import resolve
from skyrelay.core.scenario import load_scenario
from skyrelay.core.zones import ZoneGrid

GRID = ZoneGrid(0.0, 0.0, 1000.0, 1, 1)


def law(*overrides):
    return Law.of(resolve(load_scenario("bologna", list(overrides)), GRID), GRID)


@pytest.mark.parametrize(
    ("overrides", "separation"),
    [((), 0.0), (("radio.model=tr36777",), 30.0), (("fleet.separation=12.5",), 12.5)],
)
def test_uavs_keep_apart_where_the_radio_is_real_or_the_scenario_says_so(overrides, separation):
    assert law(*overrides).separation == separation


def test_an_action_that_ends_too_near_to_another_is_replaced_by_the_nearest_that_does_not():
    area, other = law("radio.model=air-to-ground"), np.array([[560.0, 500.0]])
    east = 8
    assert area.stride == 60.0
    assert law().apart(east, 1, (500.0, 500.0), other) == east
    assert area.apart(east, 1, (500.0, 500.0), np.array([[700.0, 500.0]])) == east
    assert area.apart(4, 1, (500.0, 500.0), other) == 4  # west is free
    assert area.apart(east, 1, (500.0, 500.0), other) == 0
