"""Selection within a period, over tables."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from selection_tables import uavs_at, vehicles_at

from skyrelay.core.errors import SelectionError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection.reselection import reselect
from skyrelay.selection.stability import is_valid


@given(seed=st.integers(0, 2**32 - 1))
def test_links_stay_and_nobody_who_finds_room_is_left_out_alone(seed):
    random = np.random.default_rng(seed)
    vehicles = vehicles_at(random.uniform(0, 1000, 12), demand=random.integers(1000, 4000, 12).astype(float))
    uavs = uavs_at(random.uniform(0, 1000, 3), bandwidth=random.integers(0, 12000, 3).astype(float))
    rules = Settings(max_distance=600.0)
    before = reselect(vehicles, uavs, np.full(12, -1), rules)
    before[random.random(12) < 0.4] = -1
    after = reselect(vehicles, uavs, before, rules)
    assert is_valid(vehicles, uavs, after, rules)
    assert (after[before >= 0] == before[before >= 0]).all()
    again = reselect(vehicles, uavs, after, rules)
    if (again == after).all():  # nobody asks any more: nobody fits anywhere within reach
        left = uavs.bandwidth - np.bincount(after[after >= 0], vehicles.demand[after >= 0], 3)
        near = abs(vehicles.x[:, None] - uavs.x) <= 600.0
        assert not (near & (left >= vehicles.demand[:, None]))[after < 0].any()


def test_the_better_of_two_gets_what_is_left():
    vehicles = vehicles_at([0.0, 100.0, 10.0], demand=[3000.0, 2000.0, 2000.0])
    uavs = uavs_at([0.0], bandwidth=[5500.0])
    assert reselect(vehicles, uavs, np.array([0, -1, -1]), Settings(max_distance=600.0)).tolist() == [0, -1, 0]


@pytest.mark.parametrize("assignment", [[-1], [0, 3]])
def test_an_assignment_that_does_not_fit_is_refused(assignment):
    with pytest.raises(SelectionError, match="assignment"):
        reselect(vehicles_at([0.0, 1.0]), uavs_at([0.0]), np.array(assignment), Settings())
