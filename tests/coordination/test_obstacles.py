"""Sight and the maps of a city against plain loops; what a game with obstacles makes of them."""

from __future__ import annotations

from dataclasses import replace

import game_reference as reference
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from in_flight import observe_team

from skyrelay.airspace import flight
from skyrelay.airspace.maps import MAPS, OBSTACLE_MAPS, PAPER_MAPS, footprint, map_names, normalise
from skyrelay.coordination import game
from skyrelay.coordination.obstacles import Cities
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.errors import UsageError

# Small whole numbers: products are exact, so that no rounding decides what is in sight.
place = st.tuples(st.integers(-6, 6), st.integers(-6, 6))
wall = st.tuples(place, place, st.integers(0, 7)).map(lambda w: (*w[0], *w[1], w[2] / 8))


@settings(deadline=None)
@given(place, place, st.lists(wall, min_size=1, max_size=6))
def test_sight_against_plain_loops(ground, air, walls):
    p, q, w = (np.array(x, dtype=np.float64) for x in (ground, air, walls))
    expected = reference.sees(ground, air, walls)
    assert bool(flight.in_sight(p, q, w)) == expected
    assert (float(flight.sight_share(p, q, w)) == 1.0) == expected


def test_jax_and_numpy_see_the_same_in_batches():
    random = np.random.default_rng(3)
    uavs, vehicles = (random.uniform(0, 1, (40, count, 2)).astype(np.float32) for count in (3, 8))
    owner, flying = random.integers(-1, 3, (40, 8)), random.random((40, 3)) < 0.8
    walls = random.uniform(0, 1, (40, 6, 5)).astype(np.float32)
    arguments = (uavs, vehicles, owner, np.float32(0.6), walls, flying)
    seen = flight.served(*arguments)
    np.testing.assert_array_equal(jax.jit(flight.served)(*map(jnp.asarray, arguments)), seen)
    for game_, vehicle in np.ndindex(owner.shape):
        uav = owner[game_, vehicle]
        near = uav >= 0 and np.hypot(*(uavs[game_, uav] - vehicles[game_, vehicle])) <= np.float32(0.6)
        covered = (
            near and flying[game_, uav] and reference.sees(vehicles[game_, vehicle], uavs[game_, uav], walls[game_])
        )
        assert seen[game_, vehicle] == covered
    assert 0 < seen.sum() < (owner >= 0).sum()


@settings(deadline=None)
@given(place, place, st.integers(1, 6), place, st.lists(wall, max_size=5))
def test_coming_nearer_brings_into_sight(ground, air, eighth, half, walls):
    p, q, side = (np.array(x, dtype=np.float64) for x in (ground, air, half))
    middle = p + eighth / 8 * (q - p)
    # Between the two stands a wall, high enough.
    w = np.array([(*(middle - side), *(middle + side), 7 / 8), *walls], dtype=np.float64)
    share = float(flight.sight_share(p, q, w))
    # Not where the line only just touches a wall's end: there rounding decides.
    shorter = w + 1e-6 * np.column_stack([w[:, 2:4] - w[:, :2], w[:, :2] - w[:, 2:4], np.zeros(len(w))])
    assume(share < 1.0 and float(flight.sight_share(p, q, shorter)) == pytest.approx(share))
    for closer, seen in ((0.999 * share, True), (1.001 * share, False)):
        assert bool(flight.in_sight(p, p + closer * (q - p), w)) == seen


def test_what_one_sees_around_a_house():
    house = [(4, 4), (6, 4), (6, 6), (4, 6)]
    walls = np.array([(*a, *b, 0.5) for a, b in zip(house, house[1:] + house[:1], strict=True)], dtype=np.float64)

    def sees(ground, air):
        return bool(flight.in_sight(np.array(ground, float), np.array(air, float), walls))

    assert not sees((3, 5), (8, 5))  # 0.2 of the way up, the wall stands 0.5 high
    assert sees((3, 5), (4.5, 5))  # steep: 0.67 of the way up at the wall
    assert sees((0, 5), (6, 5))  # the far vehicle's line is above the roof by then
    assert sees((3, 5), (0, 5))
    assert sees((4, 5), (0, 5))  # on the wall, looking away from the house
    assert sees((5, 5), (5.5, 5))  # inside, through the roof
    assert not sees((5, 5), (9, 5))  # inside, through the wall


def city(seed=0, **kwargs):
    cities = Cities(**{"lots": 3, "built": (0.6, 0.6), **kwargs})
    walls = np.asarray(jax.jit(cities.draw)(jax.random.key(seed)))
    assert walls.shape == (cities.walls, 5)
    sides = walls.reshape(4, -1, 5)
    return walls, [[tuple(side[:2]) for side in sides[:, lot]] for lot in range(sides.shape[1]) if sides[0, lot, 4] > 0]


def test_a_city_keeps_to_its_lots():
    walls, buildings = city(lots=4, width=(0.3, 0.5), rise=(0.2, 0.4))
    assert 0 < len(buildings) < 16
    for corners in np.array(buildings):
        low, high = corners.min(0), corners.max(0)
        assert (np.floor(low * 4) == np.floor(high * 4 - 1e-6)).all()
        assert ((high - low) * 4 >= 0.3 - 1e-5).all()
        assert ((high - low) * 4 <= 0.5 + 1e-5).all()
        area = np.prod(high - low)
        turn = sum(flight._cross(a, b) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True))
        assert turn == pytest.approx(2 * area, rel=1e-3)  # counter-clockwise
    rise = walls[:, 4]
    assert (((rise >= 0.2) & (rise <= 0.4)) | (rise == 0)).all()


def test_overlapping_buildings_are_built_once():
    square = np.array([(0.1, 0.1), (0.6, 0.1), (0.6, 0.6), (0.1, 0.6)])
    walls = np.concatenate(
        [np.column_stack([c, np.roll(c, -1, 0), np.full(4, 0.5)]) for c in (square, square + 0.3, square + 0.01)]
    )
    built = footprint(walls, 40)
    centres = (np.arange(40) + 0.5) / 40
    one = (centres > 0.1) & (centres < 0.61)
    other = (centres > 0.4) & (centres < 0.9)
    np.testing.assert_array_equal(built, np.outer(one, one) | np.outer(other, other))


@pytest.mark.parametrize("seed", range(3))
def test_maps_equal_the_plain_loops_in_the_game_and_in_flight(seed):
    walls, buildings = city(seed)
    shape = Shape(3, 9, n=5, walls=len(walls))
    domain = replace(physical((2, 3), (9, 9)), cities=Cities(lots=3))
    parameters = jax.jit(domain.draw)(jax.random.key(seed))._replace(walls=jnp.asarray(walls))
    state = jax.jit(game.reset, static_argnums=1)(jax.random.key(seed), shape, parameters)
    maps = np.asarray(jax.jit(game.observe)(state))
    active = np.asarray(state.active)
    uavs, vehicles, owner = (np.asarray(x) for x in (state.uavs, state.traffic.position, state.owner))
    expected = reference.obstacle_maps(uavs, vehicles, owner, float(parameters.reach), walls, buildings, 5, 2)
    np.testing.assert_array_equal(maps[active, 6:], expected[active])
    assert (maps[~active] == 0).all()
    assert expected[active, 2].any()

    names = map_names(obstacles=True, energy=False)
    corner, side, count = (-512.0, 2048.0), 1024.0, active.sum()
    in_metres = np.column_stack([walls[:, :4] * side + np.tile(corner, 2), walls[:, 4]])
    flown = observe_team(
        uavs[active] * side + corner,
        vehicles * side + corner,
        np.where(owner < count, owner, -1),
        corner,
        side,
        float(parameters.reach) * side,
        n=5,
        zoom=2,
        names=names,
        walls=in_metres,
    )
    np.testing.assert_allclose(flown, np.asarray(normalise(maps, 2, names))[active], rtol=1e-6)
    for i in np.flatnonzero(active):
        vehicles_of = max(int((owner == i).sum()), 1)
        for y, x in np.ndindex(5, 5):
            assert flown[i, 8, y, x] == pytest.approx(MAPS["local_sight"].scale * maps[i, 8, y, x] / vehicles_of)
            assert flown[i, 6, y, x] == 0.5 * maps[i, 6, y, x]
            assert flown[i, 7, y, x] == 0.5 * maps[i, 7, y, x] / 4
    blind = observe_team(uavs, vehicles, owner, (0.0, 0.0), 1.0, 0.5, n=5, zoom=2, names=names)
    assert (blind[:, 6:] == 0).all()  # open ground: empty maps
    assert blind[:, :6].any()


def test_coverage_needs_range_and_sight():
    shape = Shape(2, 12, n=5, walls=36)
    domain = replace(physical((2, 2), (12, 12)), cities=Cities(lots=3, built=(0.9, 0.9), rise=(0.5, 0.9)))
    state = jax.jit(lambda k: game.reset(k, shape, domain.draw(k)))(jax.random.key(4))
    score, potential = jax.jit(game.measure)(state), jax.jit(game.potential)(state)
    uavs, vehicles, owner, walls = (
        np.asarray(x) for x in (state.uavs, state.traffic.position, state.owner, state.parameters.walls)
    )
    seen = [reference.sees(v, uavs[o], walls) for v, o in zip(vehicles, owner, strict=True)]
    assert 0 < sum(seen) < 12  # all are in range at the start
    assert float(score.coverage) == pytest.approx(sum(seen) / 12)
    missed = [sum(not s for s, o in zip(seen, owner, strict=True) if o == uav) / 12 for uav in range(2)]
    np.testing.assert_allclose(score.credit, float(score.connectivity) - 1 - np.array(missed), rtol=1e-5)
    open_ground = replace(state, parameters=state.parameters._replace(walls=None), built=None)
    assert float(game.measure(open_ground).coverage) == 1.0
    assert (potential < game.potential(open_ground)).any()


def test_shape_and_domain_must_agree():
    parameters = physical((2, 2), (4, 4)).draw(jax.random.key(0))
    with pytest.raises(UsageError, match=r"shape\.walls: is 36; expected 0"):
        game.reset(jax.random.key(0), Shape(2, 4, walls=36), parameters)
    with pytest.raises(UsageError, match=r"shape\.energy"):
        game.reset(jax.random.key(0), Shape(2, 4, energy=True), parameters)
    with pytest.raises(UsageError, match="rise"):
        Cities(rise=(0.2, 1.0))


def test_the_names_follow_the_options():
    assert Shape(2, 4).maps == PAPER_MAPS
    assert Shape(2, 4, walls=4).maps == PAPER_MAPS + OBSTACLE_MAPS
