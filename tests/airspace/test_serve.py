"""The rule `serve`: what a UAV carries first, what nobody serves next, and its links before both."""

from dataclasses import replace

import numpy as np
import pytest

from skyrelay.airspace.flight import STAY, in_range, move
from skyrelay.airspace.law import Law
from skyrelay.airspace.serve import serve
from skyrelay.airspace.sight import Sight
from skyrelay.core.scenario import Energy
from skyrelay.core.zones import ZoneGrid

LAW = Law(
    ZoneGrid(0.0, 0.0, 3000.0, 1, 1), reach=600.0, speed=30.0, seconds=2.0, energy=Energy(), walls=None, patience=10.0
)
HERE = (1500.0, 1500.0)


def sight(vehicles=(), demands=(), team=(), seekers=(), sought=(), own=HERE, selected=True):
    margins = (0.0,) * len(team)
    asked = {"demands": demands, "seekers": seekers, "sought": sought}
    return Sight(LAW, 1, own, team, margins, vehicles, 90.0, "u1", selected=selected, **asked)


def after(looked, steps=1, decide=serve):
    """Where the UAV is after some steps in which nobody else moves."""
    place = np.array(looked.own)
    for _ in range(steps):
        action = decide(replace(looked, own=tuple(place)))
        place = move(place[None], np.array([action]), np.array(LAW.stride), 0.0, 3000.0)[0]
    return place


def test_it_goes_back_to_a_vehicle_that_leaves_its_range():
    east = ((2140.0, 1500.0),)
    assert in_range(after(sight(east, (2000.0,)), 3), np.array(east[0]), LAW.reach)


def test_the_vehicle_that_asks_for_more_counts_more():
    apart = ((1500.0 - 610.0, 1500.0), (1500.0 + 610.0, 1500.0))
    west, east = after(sight(apart, (3000.0, 1000.0)), 4), after(sight(apart, (1000.0, 3000.0)), 4)
    assert west[0] < 1500.0 < east[0]


def test_it_comes_within_reach_of_who_has_no_uav_without_losing_its_own():
    own, seeker = ((1900.0, 1500.0),), ((800.0, 1500.0),)
    place = after(sight(own, (2000.0,), seekers=seeker, sought=(2000.0,)), 6)
    assert in_range(place, np.array(own[0]), LAW.reach)
    assert in_range(place, np.array(seeker[0]), LAW.reach)


def test_what_it_carries_outweighs_what_it_could_find():
    own, seeker = ((2100.0, 1500.0),), ((300.0, 1500.0),)
    place = after(sight(own, (2000.0,), seekers=seeker, sought=(2000.0,)), 6)
    assert in_range(place, np.array(own[0]), LAW.reach)


@pytest.mark.parametrize("selected", [True, False])
def test_links_hold_it_back_only_where_it_serves(selected):
    looked = sight(team=((1500.0 - 590.0, 1500.0),), seekers=((2800.0, 1500.0),), sought=(4000.0,), selected=selected)
    place = after(looked, 12)
    assert in_range(place, np.array(looked.team[0]), LAW.reach) == selected


def test_with_nobody_to_serve_it_stays():
    assert serve(sight()) == STAY
