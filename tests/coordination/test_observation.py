"""The fast observation against the plain loops, in JAX and in NumPy."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import game_reference as reference
import in_flight as flying
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.airspace.guard import safe_moves
from skyrelay.airspace.maps import (
    GLOBAL_VEHICLES,
    LOCAL_VEHICLES,
    MAPS,
    PAPER_MAPS,
    VEHICLE_SCALE,
    map_names,
    normalise,
    safe_of,
)
from skyrelay.airspace.observation import Scene
from skyrelay.coordination import game, observation
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.errors import UsageError


@partial(jax.jit, static_argnames=("n", "zoom"))
def observe(uavs, active, vehicles, owner, reach, n, zoom):
    return observation.six_maps(Scene(uavs, vehicles, owner, reach), active, n, zoom)


COVER_SCALE = MAPS["cover_nearby"].scale

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


@pytest.mark.parametrize("n", [5, 9, 11])
@pytest.mark.parametrize("vehicles", [0, 1, 30])
def test_the_outlook_equals_the_plain_loops_in_the_game_and_in_flight(n, vehicles):
    names = map_names(obstacles=False, energy=False, outlook=True)
    assert names == (*PAPER_MAPS, "safe_moves", "cover_nearby")
    shape = Shape(5, max(vehicles, 1), n=n, outlook=True)
    domain = replace(physical((4, 4), (1, 1)), ratio=(3.0, 3.0))
    corner, side = (-512.0, 2048.0), 1024.0
    moves = []
    for seed in range(5):
        state = game.reset(jax.random.key(seed), shape, domain.draw(jax.random.key(4)))
        state = replace(state, present=jnp.arange(shape.vehicles) < vehicles)
        maps = np.asarray(jax.jit(game.observe)(state))
        uavs, active, places = (np.asarray(x) for x in (state.uavs, state.active, state.traffic.position))
        owner, step = np.asarray(state.served_by), float(state.parameters.uav_step)
        expected = reference.outlook_maps(uavs, active, places, owner, 1 / 3, step, n)
        np.testing.assert_array_equal(maps[:, 6:], expected)
        moves.append(expected[:4, 0].sum(axis=(1, 2)))
        in_metres = {"n": n, "zoom": 2, "names": names, "step": step * side}
        flown = flying.observe_team(
            uavs[:4] * side + corner, places * side + corner, owner, corner, side, side / 3, **in_metres
        )
        np.testing.assert_allclose(flown, np.asarray(normalise(maps[:4], 2, names)), rtol=1e-6)
        others, own = np.delete(uavs[:4], 1, axis=0), places[owner == 1]
        me, mates, mine = (x * side + corner for x in (uavs[1], others, own))
        alone = flying.observe(me, mates, mine, corner, side, side / 3, **in_metres)
        np.testing.assert_allclose(alone, flown[1], rtol=1e-6)
        shown = np.asarray(safe_of(jnp.asarray(flown), names))
        np.testing.assert_array_equal(shown, safe_moves(uavs[:4], active[:4], np.float32(1 / 3), np.float32(step)).T)
    assert 1 <= np.min(moves) < np.max(moves) <= 9


def test_a_byte_holds_what_one_uav_covers_of_as_many_vehicles_as_there_are_bytes_for():
    state = game.reset(
        jax.random.key(0), Shape(1, 28, n=5, outlook=True), physical((1, 1), (28, 28)).draw(jax.random.key(1))
    )
    beneath = replace(state, traffic=state.traffic._replace(position=jnp.broadcast_to(state.uavs, (28, 2))))
    maps = game.observe(beneath)
    assert maps.dtype == jnp.uint8
    assert maps[0, -1, 2, 2] == 28 * 8


def test_whoever_looks_ahead_says_how_far_it_moves():
    names = map_names(obstacles=False, energy=False, outlook=True)
    with pytest.raises(UsageError, match="step: expected the length of a UAV's move"):
        flying.observe([1.0, 1.0], [], [[2.0, 2.0]], (0.0, 0.0), 10.0, 5.0, n=5, zoom=2, names=names)


def test_a_team_of_nobody_sees_nothing():
    names = map_names(obstacles=True, energy=True, tells_range=True, outlook=True)
    nobody = np.zeros((0, 2)), np.array([[1.0, 1.0]]), np.array([-1])
    assert flying.observe_team(*nobody, (0.0, 0.0), 10.0, 5.0, n=5, zoom=2, names=names).shape == (0, len(names), 5, 5)


def test_what_is_covered_nearby_is_in_sight():
    """A wall between a UAV and its vehicle: it is covered from where the wall is not in the way."""
    names, wall = map_names(obstacles=True, energy=False, outlook=True), np.array([[48.0, 55.0, 52.0, 55.0, 0.9]])
    uav, vehicle = np.array([[50.0, 50.0]]), np.array([[50.0, 60.0]])
    options = {"n": 5, "zoom": 2, "names": names, "step": 5.0}
    behind = flying.observe_team(
        uav, vehicle, np.array([0]), (0.0, 0.0), 100.0, 30.0, walls=np.repeat(wall, 3, 0), **options
    )
    clear = flying.observe_team(uav, vehicle, np.array([0]), (0.0, 0.0), 100.0, 30.0, **options)
    cover = names.index("cover_nearby")
    assert (clear[0, cover] == COVER_SCALE).all()
    assert behind[0, cover, 2].tolist() == [COVER_SCALE, COVER_SCALE, 0.0, COVER_SCALE, COVER_SCALE]
    assert behind[0, cover, 4, 2] == COVER_SCALE  # on the vehicle's side of the wall


def test_who_may_be_gone_on_arrival_counts_in_part():
    """From half a move inside the edge of the range to half a move outside, a vehicle counts less and less."""
    names = map_names(obstacles=False, energy=False, outlook=True)
    uav, options = np.array([[50.0, 50.0]]), {"n": 5, "zoom": 2, "names": names, "step": 4.0}
    for distance, counts in ((17.9, 1.0), (19.0, 0.75), (20.0, 0.5), (21.0, 0.25), (22.1, 0.0)):
        vehicle = uav + np.array([distance, 0.0])
        maps = flying.observe_team(uav, vehicle, np.array([0]), (0.0, 0.0), 100.0, 20.0, **options)
        assert maps[0, names.index("cover_nearby"), 2, 2] == pytest.approx(counts * COVER_SCALE)


def test_who_has_left_the_zone_is_covered_from_where_it_truly_is_in_range():
    """It is drawn at the border; to the UAV it is as far as it is, and nearer from where the border lets it go."""
    names = map_names(obstacles=False, energy=False, outlook=True)
    options = {"n": 5, "zoom": 2, "names": names, "step": 4.0}
    uav, vehicle = np.array([[90.0, 50.0]]), np.array([[118.0, 50.0]])
    seen = flying.observe_team(uav, vehicle, np.array([0]), (0.0, 0.0), 100.0, 24.0, **options)[0]
    at_border = flying.observe_team(
        uav, vehicle * 0 + [100.0, 50.0], np.array([0]), (0.0, 0.0), 100.0, 24.0, **options
    )[0]
    cover = names.index("cover_nearby")
    np.testing.assert_array_equal(np.delete(seen, cover, 0), np.delete(at_border, cover, 0))
    assert (at_border[cover] == COVER_SCALE).all()
    assert seen[cover, 2].tolist() == [0.0, 0.0, 0.0, COVER_SCALE / 2, COVER_SCALE]


def test_absent_and_outlying_vehicles():
    uavs = np.array([[50.0, 50.0]])
    there = np.array([[10.0, 10.0], [np.nan, np.nan], [400.0, -400.0]])
    maps = flying.observe_team(uavs, there, np.array([0, 0, 0]), (0.0, 0.0), 100.0, 50.0, n=11, zoom=2)
    at_border = flying.observe_team(
        uavs, np.array([[10.0, 10.0], [100.0, 0.0]]), np.array([0, 0]), (0.0, 0.0), 100.0, 50.0, n=11, zoom=2
    )
    np.testing.assert_array_equal(maps, at_border)
    assert maps[0, GLOBAL_VEHICLES].sum() == pytest.approx(VEHICLE_SCALE)
    assert maps[0, LOCAL_VEHICLES].sum() == 0


def test_the_maps_do_not_depend_on_the_unit_of_length():
    random = np.random.default_rng(5)
    uavs, vehicles, owner = random.uniform(0, 1, (3, 2)), random.uniform(0, 1, (9, 2)), random.integers(0, 3, 9)
    one = flying.observe_team(uavs, vehicles, owner, (0.0, 0.0), 1.0, 0.4, n=11, zoom=2)
    big = flying.observe_team(uavs * 8192, vehicles * 8192, owner, (0.0, 0.0), 8192.0, 0.4 * 8192, n=11, zoom=2)
    np.testing.assert_array_equal(one, big)
