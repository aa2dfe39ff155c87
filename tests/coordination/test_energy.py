"""Charge: what flying takes and the charging point gives, and what a UAV without any does."""

from __future__ import annotations

from dataclasses import replace

import game_reference as reference
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from in_flight import observe_team

from skyrelay.airspace.maps import map_names, normalise
from skyrelay.coordination import game
from skyrelay.coordination.energy import Batteries
from skyrelay.coordination.pettingzoo import UavCoordination
from skyrelay.coordination.settings import Shape, physical
from skyrelay.coordination.testing import check_parallel_env
from skyrelay.core.errors import UsageError
from skyrelay.core.names import GamesName
from skyrelay.learning.presets import games_of

SHAPE = Shape(3, 6, n=5, steps=12, energy=True)
DOMAIN = replace(physical((3, 3), (6, 6)), batteries=Batteries(radius=(0.1, 0.1)))


@pytest.fixture(scope="module")
def start() -> game.State:
    return jax.jit(lambda key: game.reset(key, SHAPE, DOMAIN.draw(key)))(jax.random.key(2))


@pytest.fixture(scope="module")
def step():
    return jax.jit(game.step)


def test_flying_costs_and_hovering_at_the_point_charges(start, step):
    charging = start.parameters.charging
    uavs = jnp.stack([charging.point, charging.point + jnp.array([0.09, 0.0]), charging.point - 0.3])
    charge = jnp.array([0.5, 0.5, 0.5])
    after, _ = step(replace(start, uavs=uavs, charge=charge), jnp.array([0, 0, 0]))
    np.testing.assert_allclose(after.charge[:2], 0.5 + charging.gain, rtol=1e-6)
    np.testing.assert_allclose(after.charge[2], 0.5 - charging.hover, rtol=1e-6)
    moved, _ = step(replace(start, uavs=uavs, charge=charge), jnp.array([1, 2, 3]))
    np.testing.assert_allclose(moved.charge, 0.5 - charging.move, rtol=1e-6)  # a move through the point charges nothing
    full, _ = step(replace(start, uavs=uavs, charge=jnp.ones(3)), jnp.array([0, 0, 0]))
    assert (full.charge <= 1.0).all()


@pytest.mark.parametrize(("speed", "ratio"), [(10.0, 126.03 / 168.48), (30.0, 356.28 / 168.48)])
def test_a_rotary_wing_uav_s_moves_cost_what_its_speed_takes(speed, ratio):
    """Below hovering at 10 m/s, twice as much at 30 m/s; all else is drawn as without it."""
    key = jax.random.key(5)
    drawn, plain = Batteries(speeds=(speed, speed)).draw(key), Batteries().draw(key)
    assert float(drawn.move / drawn.hover) == pytest.approx(ratio, rel=1e-3)
    assert float(plain.move / plain.hover) >= 1.0
    np.testing.assert_array_equal(np.asarray(drawn.point), np.asarray(plain.point))
    assert (float(drawn.hover), float(drawn.gain)) == (float(plain.hover), float(plain.gain))


@pytest.mark.parametrize("speeds", [(0.0, 10.0), (20.0, 10.0), (10.0, 101.0)])
def test_speeds_that_are_none_are_refused(speeds):
    with pytest.raises(UsageError, match=r"game\.batteries\.speeds"):
        Batteries(speeds=speeds)


GAMES_AND_SPEEDS: tuple[tuple[GamesName, tuple[float, float] | None], ...] = (
    ("energy", None),
    ("rotary-wing", (5.0, 30.0)),
)


def test_the_games_of_that_name_have_it():
    for games, speeds in GAMES_AND_SPEEDS:
        domain, shape = games_of(games, (2, 2), (4, 4), Shape.n)
        assert (domain.batteries.speeds, shape.energy) == (speeds, True)


def test_a_uav_without_charge_is_on_the_ground(start, step):
    at = jnp.array([[0.5, 0.5], [0.5, 0.6], [0.5, 0.7]])
    traffic = start.traffic._replace(position=jnp.tile(at[0], (6, 1)))
    state = replace(start, uavs=at, traffic=traffic, owner=jnp.array([0, 0, 1, 1, 2, 2]), charge=jnp.array([0.0, 1, 1]))
    score = game.measure(state)
    assert float(score.coverage) == pytest.approx(4 / 6)
    assert float(score.connectivity) == 0.0
    assert float(game.measure(replace(state, charge=jnp.ones(3))).connectivity) == 1.0
    charging = state.parameters.charging
    far = state.parameters._replace(charging=charging._replace(point=jnp.array([0.1, 0.1])))
    after, _ = step(replace(state, parameters=far), jnp.array([1, 1, 1]))
    np.testing.assert_array_equal(after.uavs[0], at[0])
    assert (np.asarray(after.uavs[1:, 0]) > 0.5).all()
    assert float(after.charge[0]) == 0.0
    at_point = state.parameters._replace(charging=charging._replace(point=at[0]))
    risen, _ = step(replace(state, parameters=at_point), jnp.array([0, 1, 1]))
    assert bool(risen.flying[0])


@pytest.mark.parametrize(("far", "linked"), [(0.7, 1.0), (5.0, 0.0)])
def test_who_is_on_the_ground_answers_for_the_cut_and_the_others_for_their_own_links(start, far, linked):
    at = jnp.array([[0.5, 0.5], [0.5, 0.6], [0.5, far]])
    owner = jnp.array([0, 0, 1, 1, 2, 2])
    state = replace(start, uavs=at, traffic=start.traffic._replace(position=at[owner]), owner=owner)
    score = game.measure(replace(state, charge=jnp.array([0.0, 1.0, 1.0])))
    assert float(score.connectivity) == 0.0
    np.testing.assert_allclose(score.credit, [-1.0 - 2 / 6, linked - 1.0, linked - 1.0], rtol=1e-6)


def test_a_margin_shortens_the_links_of_those_in_the_air(start):
    reach, move = float(start.parameters.reach), float(start.parameters.uav_step)
    at = jnp.array([[0.0, 0.0], [0.1, 0.5], [0.1 + reach - 0.5 * move, 0.5]])
    state = replace(start, uavs=at, charge=jnp.array([0.0, 1.0, 1.0]))
    assert game.linked(state, 0.0).tolist() == [0.0, 1.0, 1.0]
    assert game.linked(state, 0.75).tolist() == [0.0, 0.0, 0.0]


def test_the_potential_tells_when_to_turn_back(start):
    charging = start.parameters.charging._replace(point=jnp.array([0.0, 0.5]), move=jnp.float32(0.01))
    still = start.parameters._replace(charging=charging)

    def short(x, charge):
        state = replace(start, parameters=still, uavs=jnp.array([[x, 0.5]] * 3), charge=jnp.full(3, charge))
        rich = replace(state, charge=jnp.ones(3))
        return float(game.potential(state)[0] - game.potential(rich)[0])

    assert short(0.9, 0.9) == 0.0
    assert short(0.7, 0.1) < short(0.6, 0.1) < 0.0
    assert short(0.05, 0.5) == 0.0


def test_maps_equal_the_plain_loops_in_the_game_and_in_flight(start):
    names = map_names(obstacles=False, energy=True)
    point = np.asarray(start.parameters.charging.point)
    start = replace(start, uavs=start.uavs.at[1].set(point + 0.05), charge=start.charge.at[2].set(0.1))
    maps = np.asarray(jax.jit(game.observe)(start))
    uavs, vehicles, owner, charge = (
        np.asarray(x) for x in (start.uavs, start.traffic.position, start.owner, start.charge)
    )
    flight = charge / float(start.parameters.charging.move) * float(start.parameters.uav_step)
    assert flight[2] < 2 < flight.max()
    np.testing.assert_array_equal(maps[:, 6:], reference.energy_maps(uavs, point, 0.1, flight, 5, 2))
    assert maps[:, 9].any(axis=(1, 2)).tolist() == [False, True, False]
    corner, side = (-512.0, 2048.0), 1024.0
    flown = observe_team(
        uavs * side + corner,
        vehicles * side + corner,
        owner,
        corner,
        side,
        float(start.parameters.reach) * side,
        n=5,
        zoom=2,
        names=names,
        charger=(*(point * side + corner), 0.1 * side),
        flight=flight * side,
    )
    np.testing.assert_allclose(flown, np.asarray(normalise(maps, 2, names)), rtol=1e-6)


def test_the_environment_conforms():
    assert check_parallel_env(lambda: UavCoordination(SHAPE, DOMAIN), episodes=2) == 24
