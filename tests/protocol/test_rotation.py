"""Who goes to be charged and who comes back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrelay.airspace.law import Law
from skyrelay.chain.abi import Event
from skyrelay.core.resolved import resolve
from skyrelay.core.scenario import load_scenario
from skyrelay.core.zones import ZoneGrid
from skyrelay.protocol.dispatch import Books
from skyrelay.protocol.rotation import leaving, rotate, stations

GRID = ZoneGrid(0.0, 0.0, 1000.0, 2, 1)
MIDDLES = np.array([[500.0, 500.0], [1500.0, 500.0]])


def law(*overrides):
    told = ("energy.model=rotary-wing", "energy.battery=150", "energy.places=2", "energy.charging_power=600")
    told = (*told, "fleet.speed=15", "coordination.step_seconds=4", "coordination.period_steps=20", *overrides)
    return Law.of(resolve(load_scenario("bologna", told), GRID), GRID)


def turn(rules, zone, battery, bandwidth=None, asked=(50e3, 50e3), place=None):
    """The plan for UAVs above their charging points; those without a zone are at the first."""
    zone = np.array(zone)
    return rotate(
        np.array(asked),
        2500.0,
        zone,
        np.full(len(zone), 10e3) if bandwidth is None else np.array(bandwidth),
        np.array(battery, dtype=float),
        MIDDLES[np.maximum(zone, 1) - 1] if place is None else np.array(place),
        rules,
    ).tolist()


@pytest.mark.parametrize(
    ("left", "hold", "busy", "slots", "expected"),
    [
        ([9, 9, 9], [1, 1, 1], [], 1, 0),  # one after the other, later
        ([3, 3, 3], [2, 2, 2], [], 1, 1),  # a place for two periods each: now, at 2, and at 4 it is too late, alas
        ([4, 4, 4], [2, 2, 2], [], 1, 1),  # now, at 2 and at 4
        ([5, 5, 5], [2, 2, 2], [], 1, 0),  # at 1, 3 and 5
        ([2, 2], [5, 5], [], 2, 0),  # two places: in one period and the next
        ([1, 1], [5, 5], [], 2, 1),  # one leaves in a period, no more
        ([0, 1], [5, 5], [], 2, 1),  # one cannot wait
        ([1, 1], [5, 5], [9], 2, 1),  # one place is taken, so one goes now; for the other there is none either way
        ([1, 2], [5, 5], [1], 2, 0),  # it falls free in time
        ([1, 1], [5, 5], [9, 9], 2, 0),  # there is none
        ([], [], [], 3, 0),
    ],
)
def test_they_leave_as_late_as_those_behind_allow(left, hold, busy, slots, expected):
    assert leaving(left, hold, 0.0, busy, slots) == expected


def in_time(count, left, hold, busy, slots, pace):
    """Period by period: whether all find a place in time, the first ``count`` now."""
    ends, queue = [*busy, *hold[:count]], list(zip(left[count:], hold[count:], strict=True))
    for now in range(1, 60):
        ends = [end for end in ends if end > now]
        for _ in range(pace):
            if queue and len(ends) < slots:
                last, periods = queue.pop(0)
                if last < now:
                    return False
                ends.append(now + periods)
    return not queue


@settings(deadline=None)
@given(st.data())
def test_the_fewest_leave_with_which_all_find_a_place(data):
    count = data.draw(st.integers(0, 7))
    left = sorted(data.draw(st.lists(st.integers(0, 12), min_size=count, max_size=count)))
    hold = data.draw(st.lists(st.integers(1, 6), min_size=count, max_size=count))
    slots, pace = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 3))
    busy = data.draw(st.lists(st.integers(1, 8), max_size=slots))
    most = min(slots - len(busy), pace, count)
    fits = [number for number in range(most + 1) if in_time(number, left, hold, busy, slots, pace)]
    assert leaving(left, hold, 0.0, busy, slots, pace) == (fits[0] if fits else most)


def test_full_batteries_stay_and_spent_ones_go_whatever_there_is_room_for():
    assert turn(law(), [1, 1, 2, 2], [100] * 4) == [1, 1, 2, 2]
    assert turn(law(), [1, 1, 2, 2], [6, 100, 100, 100]) == [0, 1, 2, 2]
    assert turn(law("energy.places=1"), [1, 1, 1, 2], [6, 6, 6, 100]) == [0, 0, 0, 2]


def test_equal_batteries_do_not_leave_together():
    rules, zone, battery = law(), np.array([1] * 6 + [2] * 6), np.full(12, 100.0)
    gone = []
    for _ in range(60):
        before = zone
        zone = np.array(turn(rules, before, battery, place=MIDDLES[[0] * 6 + [1] * 6]))
        gone.append(int(((before > 0) & (zone == 0)).sum()))
        gain = rules.places.gain[0] * rules.period_steps
        battery = np.where(zone > 0, battery - rules.worst * rules.period_steps, np.minimum(battery + gain, 100.0))
        assert battery.min() > rules.energy.reserve
        assert (np.bincount(zone, minlength=3)[1:] >= 4).all()
    assert max(gone) <= 2  # one of each zone
    assert sum(gone) >= 12  # everyone had a turn


def test_who_is_charged_goes_where_most_is_missing_once_the_next_has_left():
    rules = law()
    spare = [[500.0, 500.0], [500.0, 500.0], [1500.0, 500.0]]
    assert turn(rules, [0, 1, 2], [100, 50, 50], asked=(10e3, 30e3), place=spare) == [2, 1, 2]
    # The one of zone 1 is the next to leave: who comes back takes over from it.
    assert turn(rules, [0, 1, 2], [100, 8, 90], asked=(10e3, 10e3), place=spare) == [1, 1, 2]
    assert turn(rules, [0, 1, 2], [80, 90, 90], asked=(10e3, 30e3), place=spare) == [0, 1, 2]


def test_who_takes_over_is_there_before_the_other_leaves():
    rules = law("energy.places=1")
    place = [[500.0, 500.0]] * 3
    # The only place falls free; the next one waits a period for it, as its battery can.
    first = turn(rules, [0, 1, 1], [100, 8, 90], asked=(20e3, 0.0), place=place)
    assert first == [1, 1, 1]
    assert turn(rules, first, [97, 5.5, 87], asked=(20e3, 0.0), place=place) == [1, 0, 1]


def test_the_last_of_a_zone_stays_as_long_as_it_can():
    rules = law()
    assert turn(rules, [1, 2, 2, 2], [8, 25, 26, 90])[0] == 1
    assert turn(rules, [1, 2, 2, 2], [6, 25, 26, 90])[0] == 0


def told(books, name, **args):
    books.hear(Event(name, args, 0, 0, 0))


def books_of(*batteries):
    books = Books()
    for number, battery in enumerate(batteries):
        uav = f"u{number}"
        told(books, "UAVRegistered", uav=uav, x=5000, y=5000, bandwidth=10000, battery=battery)
        told(books, "UAVZoneUpdated", uav=uav, **{"from": 0, "to": 1})
    told(books, "VehicleUpdated", vehicle="v", zone=2)
    return books


def test_nobody_rotates_before_anything_was_asked_for():
    books = books_of(600, 9000)
    assert stations(books, law()) == {}
    told(books, "VehSelectionSubmitted", vehicle="v", demand=4000)
    assert stations(books, law()) == {"u0": 0}
    assert stations(books, law("energy.rotation=alone")) == {}


def test_where_vehicles_tell_their_place_with_their_proposals_the_period_before_counts():
    books = books_of(600, 9000)
    told(books, "VehSelectionSubmitted", vehicle="v", demand=4000)
    told(books, "ZoneListsReset", zone=1, round=2)
    told(books, "ZoneListsReset", zone=2, round=2)
    assert stations(books, law()) == {"u0": 0}
    assert books.moves(GRID, 60.0) == {}


def test_with_dispatch_the_others_go_where_they_are_needed_and_the_plan_stays_until_all_have_gone():
    books, rules = books_of(600, 9000, 9000), law("coordination.dispatch=true")
    told(books, "VehicleUpdated", vehicle="w", zone=2)
    told(books, "VehSelectionSubmitted", vehicle="v", demand=4000)
    plan = stations(books, rules)
    assert plan["u0"] == 0
    assert 2 in plan.values()
    told(books, "UAVZoneUpdated", uav="u0", **{"from": 1, "to": 0})
    assert stations(books, rules) == plan
