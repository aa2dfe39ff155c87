"""Wind: what of a move is made, where gusts end, and that whatever holds in still air holds in wind."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrelay.airspace.flight import ACTIONS, STAY, unit_moves
from skyrelay.airspace.law import Law
from skyrelay.airspace.wind import Weather, progress
from skyrelay.core.errors import ScenarioError
from skyrelay.core.resolved import resolve
from skyrelay.core.scenario import Energy, Wind, load_scenario
from skyrelay.core.zones import ZoneGrid
from skyrelay.simulation.flight import Flight
from skyrelay.simulation.world import Fleet

SPEED = 20.0
GRID = ZoneGrid(0.0, 0.0, 1000.0, 1, 1)
LAW = Law(GRID, reach=500.0, speed=SPEED, seconds=2.0, energy=Energy(), walls=None, patience=10.0, separation=40.0)


def fleet_at(places):
    x, y = np.array(places, dtype=float).T
    count = len(x)
    return Fleet(
        ids=tuple(f"u{row}" for row in range(count)),
        x=x,
        y=y,
        zone=np.ones(count, dtype=np.int64),
        bandwidth=np.full(count, 5000),
        battery=np.full(count, 90.0),
        reputation=np.full(count, 50.0),
    )


def test_a_headwind_slows_a_tailwind_does_not_hurry_and_a_crosswind_costs_the_lean():
    east, north = (int(np.argmax(unit_moves() @ way)) for way in ([1.0, 0.0], [0.0, 1.0]))
    made = progress(np.array([east, east, north, STAY]), np.array([-12.0, 0.0]), SPEED)
    np.testing.assert_allclose(made, [0.4, 0.4, 0.8, 1.0], atol=1e-6)  # 20 - 12; sqrt(20^2 - 12^2) = 16
    assert progress(np.array([east]), np.array([12.0, 0.0]), SPEED).tolist() == [1.0]


@given(st.integers(0, ACTIONS - 1), st.floats(0, 0.99), st.floats(0, 360))
def test_the_wind_triangle_closes(action, share, towards):
    angle = np.radians(towards)
    wind = share * SPEED * np.array([np.cos(angle), np.sin(angle)])
    made = progress(np.array([action]), wind, SPEED)[0]
    ground = made * SPEED * unit_moves()[action]
    assert 0.0 < made <= 1.0
    through_air = np.hypot(*(ground - wind))
    if made < 1.0 and action != STAY:
        assert through_air == pytest.approx(SPEED, rel=1e-5)
    else:
        assert through_air <= SPEED * (1.0 + 1e-5)


@given(st.integers(0, 2**32 - 1), st.floats(0, 1e6))
def test_gusts_stay_within_their_bounds_and_follow_the_seed(seed, seconds):
    weather = Weather.of(Wind(speed=6.0, gusts=3.0, direction=270.0), seed)
    x, y = weather.at(seconds)
    assert 3.0 <= x <= 9.0  # from the west, to the east
    assert y == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_array_equal(Weather.of(Wind(speed=6.0, gusts=3.0, direction=270.0), seed).at(seconds), [x, y])


def test_gusts_gust():
    strengths = [np.hypot(*Weather.of(Wind(speed=6.0, gusts=3.0), 1).at(2.0 * step)) for step in range(300)]
    assert np.ptp(strengths) > 1.5
    assert np.mean(strengths) == pytest.approx(6.0, abs=0.3)


def test_without_wind_there_is_no_weather():
    assert Weather.of(Wind(), 1) is None


@given(st.integers(0, 2**32 - 1), st.floats(0, 360), st.integers(2, 6))
def test_the_separation_and_the_zone_hold_in_wind(seed, direction, count):
    """Each moves at random as it may in still air (`Law.apart`), and the wind takes of each move what it takes."""
    draw = np.random.default_rng(seed)
    spots = draw.permutation(16)[:count]
    fleet = fleet_at([(430.0 + 45.0 * (spot % 4), 10.0 + 45.0 * (spot // 4)) for spot in spots])
    law = replace(LAW, weather=Weather.of(Wind(speed=12.0, gusts=6.0, direction=direction), seed))
    flight = Flight(law, fleet, np.zeros(0, dtype=np.int64))
    for _ in range(5):
        here = np.column_stack([fleet.x, fleet.y])
        moves = {
            row: law.apart(int(draw.integers(ACTIONS)), 1, tuple(here[row]), np.delete(here, row, axis=0))
            for row in range(count)
        }
        flight.move(moves)
        there = np.column_stack([fleet.x, fleet.y])
        assert (np.hypot(*(there - here).T) <= law.stride * (1 + 1e-6)).all()
        apart = np.hypot(*(there[:, None] - there[None]).transpose(2, 0, 1))[~np.eye(count, dtype=bool)]
        assert apart.min() >= law.separation * (1 - 1e-3)
        assert (there >= 0.0).all()
        assert (there <= 1000.0).all()


def test_a_fleet_makes_less_way_against_the_wind():
    still, windy = fleet_at([(500.0, 500.0)]), fleet_at([(500.0, 500.0)])
    east = int(np.argmax(unit_moves()[:, 0]))
    Flight(LAW, still, np.zeros(0, dtype=np.int64)).move({0: east})
    law = replace(LAW, weather=Weather.of(Wind(speed=10.0, direction=90.0), 1))
    Flight(law, windy, np.zeros(0, dtype=np.int64)).move({0: east})
    assert still.x[0] == pytest.approx(540.0)
    assert windy.x[0] == pytest.approx(520.0)


def test_hovering_in_wind_costs_what_flying_at_its_speed_costs():
    def cost(*overrides):
        sets = ["energy.model=rotary-wing", "fleet.range=800", *overrides]
        return Law.of(resolve(load_scenario("bologna", sets), GRID), GRID).energy.hover_per_minute

    assert cost("wind.speed=10") == pytest.approx(cost() * 126.0 / 168.5, rel=0.02)  # Zeng et al., Fig. 2
    assert cost("wind.speed=25") > cost()


@pytest.mark.parametrize(
    ("overrides", "place"),
    [
        (["wind.speed=30"], "slower than fleet.speed"),
        (["wind.speed=20", "wind.gusts=10"], "slower than fleet.speed"),
        (["wind.speed=3", "energy.places=2"], "still air"),
        (["wind.speed=-1"], "wind.speed"),
        (["wind.gusts=-1"], "wind.gusts"),
        (["wind.direction=361"], "wind.direction"),
    ],
)
def test_a_wind_that_no_uav_could_counter_is_refused(overrides, place):
    with pytest.raises(ScenarioError, match=place):
        load_scenario("bologna", overrides)
