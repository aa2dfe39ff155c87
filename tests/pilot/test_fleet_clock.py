"""The fleet's time: more than half have it, and fewer than half do nothing to it, whatever they say."""

import math

from hypothesis import given
from hypothesis import strategies as st

from skyrelay.pilot.fleet_clock import FleetClock

PATIENCE = 5.0
ANY = st.floats(allow_nan=False)


def fleet(size):
    clock = FleetClock()
    for uav in range(size):
        clock.join(f"u{uav}")
    return clock


def hear(clock, uav, time, heard, most=math.inf):
    clock.hear(f"u{uav}", time, heard, PATIENCE, most)


@given(st.integers(1, 4), st.data())
def test_fewer_than_half_do_not_matter(liars, data):
    size = 2 * liars + 1
    clock = fleet(size)
    order = data.draw(st.permutations(range(size)))
    for second in range(1, 6):
        for uav in order:
            time = data.draw(ANY) if uav < liars else float(second)
            hear(clock, uav, time, second + 0.01 * uav)
            assert clock.time <= second
        assert clock.time == second


def test_half_of_the_fleet_waits_for_the_other_half_and_then_goes_on_without():
    clock = fleet(4)
    for second in range(3):
        for uav in range(4):
            hear(clock, uav, float(second), float(second))
    for second in range(3, 20):
        for uav in range(2):
            hear(clock, uav, float(second), float(second), most=15.0)
        assert clock.time == (
            2.0 if second - 3 <= PATIENCE else min(second, 15.0)
        )  # 15 s, as the onlooker knows itself
    for uav in range(2, 4):
        hear(clock, uav, 19.0, 19.0)
    assert clock.time == 19.0


def test_a_fleet_that_steps_slowly_is_waited_for_longer():
    clock = fleet(3)
    for number in range(4):
        for uav in range(2):
            hear(clock, uav, float(number), 10.0 * number)
        for moment in range(9 if number else 5):  # its pace shows from the second step on
            hear(clock, 2, 1e9, 10.0 * number + moment)
        assert clock.time == number


def test_who_has_landed_or_was_never_there_does_not_count():
    clock = fleet(3)
    hear(clock, 7, 1e9, 0.0)
    assert clock.time == -math.inf
    clock.leave("u1")
    clock.leave("u2")
    hear(clock, 0, 4.0, 0.0)
    assert clock.time == 4.0
