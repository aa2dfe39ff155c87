"""The fast observation against the plain loops, in JAX and in NumPy."""

from __future__ import annotations

from dataclasses import replace

import game_reference as reference
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.coordination import game, observation
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.maps import LOCAL_VEHICLES, PAPER_MAPS, VEHICLE_SCALE, map_names, normalise
from skyrelay.policy import observation as flying

observe = jax.jit(observation.observe, static_argnames=("n", "zoom"))

CASES = [
    (seed, n, zoom, uavs, vehicles)
    for seed, (n, zoom, uavs, vehicles) in enumerate(
        [(3, 2, 1, 1), (5, 2, 2, 5), (5, 3, 3, 9), (11, 2, 3, 20), (7, 3, 8, 40), (11, 2, 2, 33), (7, 2, 4, 0)]
    )
]


def draw(seed, uavs, vehicles):
    random = np.random.default_rng(seed)
    uav_xy = random.uniform(0, 1, (uavs, 2)).astype(np.float32)
    if uavs > 2:
        uav_xy[0], uav_xy[1] = (0.0, 1.0), (1.0, 0.0)  # on the border, where the window is shifted
    vehicle_xy = random.uniform(0, 1, (vehicles, 2)).astype(np.float32)
    owner = random.integers(-1, uavs, vehicles)
    active = np.ones(uavs, bool)
    return uav_xy, active, vehicle_xy, owner, np.float32(random.uniform(0.2, 0.7))


@pytest.mark.parametrize(("seed", "n", "zoom", "uavs", "vehicles"), CASES)
def test_maps_equal_the_plain_loops(seed, n, zoom, uavs, vehicles):
    uav_xy, active, vehicle_xy, owner, reach = draw(seed, uavs, vehicles)
    if uavs > 2:
        active[-1] = False
        owner[owner == uavs - 1] = 0
    expected = reference.observe(uav_xy, active, vehicle_xy, owner, reach, n, zoom)
    result = np.asarray(observe(*map(jnp.asarray, (uav_xy, active, vehicle_xy, owner, reach)), n=n, zoom=zoom))
    np.testing.assert_array_equal(result, expected)
    np.testing.assert_allclose(
        np.asarray(normalise(jnp.asarray(result), zoom)), reference.normalise(expected, zoom), rtol=1e-6
    )


@pytest.mark.parametrize(("seed", "n", "zoom", "uavs", "vehicles"), CASES)
def test_a_uav_in_flight_sees_the_same_in_metres(seed, n, zoom, uavs, vehicles):
    uav_xy, active, vehicle_xy, owner, reach = draw(seed, uavs, vehicles)
    expected = reference.normalise(reference.observe(uav_xy, active, vehicle_xy, owner, reach, n, zoom), zoom)
    corner, side = (-512.0, 2048.0), 1024.0  # powers of two: no rounding on the way there and back
    uav_m, vehicle_m = uav_xy * side + corner, vehicle_xy * side + corner
    team = flying.observe_team(uav_m, vehicle_m, owner, corner, side, float(reach) * side, n=n, zoom=zoom)
    assert team.dtype == np.float32
    np.testing.assert_allclose(team, expected, rtol=1e-6)
    for i in range(uavs):
        others, own = np.delete(uav_m, i, axis=0), vehicle_m[owner == i]
        alone = flying.observe(uav_m[i], others, own, corner, side, float(reach) * side, n=n, zoom=zoom)
        np.testing.assert_array_equal(alone, team[i])


def test_the_range_is_told_in_the_game_and_in_flight():
    names = map_names(obstacles=False, energy=False, tells_range=True)
    shape = Shape(4, 9, n=7, zoom=3, tells_range=True)
    assert shape.maps == names == (*PAPER_MAPS, "own_range")
    for ratio in (1.5, 2.7):
        domain = replace(physical((3, 3), (9, 9)), ratio=(ratio, ratio))
        state = game.reset(jax.random.key(3), shape, domain.draw(jax.random.key(4)))
        maps = np.asarray(game.observe(state))
        expected = np.zeros((4, 7, 7))
        expected[:3] = np.round(255 / ratio)  # the fourth row holds no UAV
        np.testing.assert_array_equal(maps[:, 6], expected)
        plain = game.observe(replace(state, shape=replace(shape, tells_range=False)))
        np.testing.assert_array_equal(maps[:, :6], plain)
        corner, side = (-512.0, 2048.0), 1024.0
        uavs, vehicles = (np.asarray(x) * side + corner for x in (state.uavs[:3], state.traffic.position))
        flown = flying.observe_team(
            uavs, vehicles, np.asarray(state.owner), corner, side, side / ratio, n=7, zoom=3, names=names
        )
        np.testing.assert_allclose(flown, np.asarray(normalise(maps[:3], 3, names)), rtol=1e-6)
        assert flown[0, 6, 0, 0] == pytest.approx(1 / ratio, abs=1 / 255)


def test_absent_and_outlying_vehicles():
    uavs = np.array([[50.0, 50.0]])
    there = np.array([[10.0, 10.0], [np.nan, np.nan], [400.0, -400.0]])
    maps = flying.observe_team(uavs, there, np.array([0, 0, 0]), (0.0, 0.0), 100.0, 50.0, n=11, zoom=2)
    at_border = flying.observe_team(
        uavs, np.array([[10.0, 10.0], [100.0, 0.0]]), np.array([0, 0]), (0.0, 0.0), 100.0, 50.0, n=11, zoom=2
    )
    np.testing.assert_array_equal(maps, at_border)
    assert maps[0, flying.GLOBAL_VEHICLES].sum() == pytest.approx(VEHICLE_SCALE)
    assert maps[0, LOCAL_VEHICLES].sum() == 0


def test_the_maps_do_not_depend_on_the_unit_of_length():
    random = np.random.default_rng(5)
    uavs, vehicles, owner = random.uniform(0, 1, (3, 2)), random.uniform(0, 1, (9, 2)), random.integers(0, 3, 9)
    one = flying.observe_team(uavs, vehicles, owner, (0.0, 0.0), 1.0, 0.4, n=11, zoom=2)
    big = flying.observe_team(uavs * 8192, vehicles * 8192, owner, (0.0, 0.0), 8192.0, 0.4 * 8192, n=11, zoom=2)
    np.testing.assert_array_equal(one, big)
