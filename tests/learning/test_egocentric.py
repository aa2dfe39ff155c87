"""Maps seen from the UAV: against plain loops, and what they are for."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.airspace.maps import (
    GLOBAL_LOCATION,
    GLOBAL_TEAM,
    GLOBAL_VEHICLES,
    LOCAL_LOCATION,
    MAPS,
    PAPER_MAPS,
    map_names,
    normalise,
    range_map,
)
from skyrelay.airspace.observation import Scene
from skyrelay.coordination.observation import six_maps
from skyrelay.learning import egocentric

N = 5
SIDE = 2 * N - 1


def slow(maps, names):
    """The same, cell by cell."""
    if "own_range" in names:
        return slow_in_ranges(maps, names)
    location = maps[GLOBAL_LOCATION] / MAPS["local_location"].scale
    column, row = location.sum(0), location.sum(1)
    parts = [egocentric.PLACE_SCALE * column, egocentric.PLACE_SCALE * row]
    for number, name in enumerate(names):
        if name in ("global_team", "global_coverage", "global_vehicles", "global_buildings", "global_charger"):
            parts.append(moved_by(column, row, maps[number]).ravel())
    parts += slow_near(maps, names) + slow_ahead(maps, names)
    parts += [maps[k, 0, :1] for k, name in enumerate(names) if name in ("own_flight", "at_charger")]
    return np.concatenate(parts)


def slow_near(maps, names):
    """The options' local maps, moved by the own place in the window."""
    location = maps[LOCAL_LOCATION] / MAPS["local_location"].scale
    column, row = location.sum(0), location.sum(1)
    local = ("local_buildings", "local_sight", "local_charger")
    return [moved_by(column, row, maps[k]).ravel() for k, name in enumerate(names) if name in local]


def slow_ahead(maps, names):
    """What is covered from nearby, against what is from the middle; and that."""
    if "cover_nearby" not in names:
        return []
    cover = maps[names.index("cover_nearby")]
    return [
        np.array([cover[r, c] - cover[N // 2, N // 2] for r in range(N) for c in range(N)]),
        cover[N // 2, [N // 2]],
    ]


def moved_by(column, row, content):
    """[2 n - 1, 2 n - 1], each cell brought to its offsets from every own cell."""
    view = np.zeros((SIDE, SIDE))
    for own_row in range(N):
        for own_column in range(N):
            for r in range(N):
                for c in range(N):
                    offset = r - own_row + N - 1, c - own_column + N - 1
                    view[offset] += row[own_row] * column[own_column] * content[r, c]
    return view


def slow_in_ranges(maps, names):
    """Likewise: each cell's content goes to the marks about where it is, as seen from where the own place balances."""
    marks = [-mark for mark in egocentric.MARKS[:0:-1]] + list(egocentric.MARKS)
    location = maps[GLOBAL_LOCATION] / MAPS["local_location"].scale
    column, row = location.sum(0), location.sum(1)
    reach = maps[names.index("own_range"), 0, 0]
    own_x, own_y = (sum(k * share for k, share in enumerate(own)) for own in (column, row))

    def shares(away):
        """Of the marks, along one axis."""
        found = np.zeros(len(marks))
        away = min(max(away, marks[0]), marks[-1])
        after = next(k for k, mark in enumerate(marks) if k and away <= mark)
        found[after] = (away - marks[after - 1]) / (marks[after] - marks[after - 1])
        found[after - 1] = 1 - found[after]
        return found

    parts = [egocentric.PLACE_SCALE * column, egocentric.PLACE_SCALE * row]
    for number, name in enumerate(names):
        if name in ("global_team", "global_vehicles", "global_buildings", "global_charger"):
            view = np.zeros((len(marks), len(marks)))
            for r in range(N):
                for c in range(N):
                    north, east = (r - own_y) / N / reach, (c - own_x) / N / reach
                    view += maps[number, r, c] * np.outer(shares(north), shares(east))
            parts.append(view.ravel())
    parts += slow_near(maps, names) + slow_ahead(maps, names)
    parts += [maps[k, 0, :1] for k, name in enumerate(names) if name in ("own_flight", "at_charger", "own_range")]
    return np.concatenate(parts)


@pytest.mark.parametrize("obstacles", [False, True])
@pytest.mark.parametrize("energy", [False, True])
@pytest.mark.parametrize("tells_range", [False, True])
@pytest.mark.parametrize("outlook", [False, True])
def test_equals_the_plain_loops(obstacles, energy, tells_range, outlook):
    names = map_names(obstacles=obstacles, energy=energy, tells_range=tells_range, outlook=outlook)
    maps = np.random.default_rng(1).random((3, len(names), N, N)).astype(np.float32)
    seen = egocentric.egocentric(jnp.asarray(maps), names)
    assert seen.shape == (3, egocentric.width(N, names))
    np.testing.assert_allclose(seen, [slow(one, names) for one in maps], rtol=1e-4, atol=1e-4)


def view(uav, other, vehicle, number):
    """[2 n - 1, 2 n - 1] of one map, of the first of two UAVs."""
    scene = Scene(jnp.array([uav, other]), jnp.array([vehicle]), jnp.array([0]), jnp.float32(0.4))
    levels = six_maps(scene, jnp.array([True, True]), N, 2)
    seen = egocentric.egocentric(normalise(levels, 2), PAPER_MAPS)[0]
    first = 2 * N + egocentric.moved(PAPER_MAPS).index(number) * SIDE**2
    return np.asarray(seen[first : first + SIDE**2]).reshape(SIDE, SIDE)


@pytest.mark.parametrize("number", [GLOBAL_TEAM, GLOBAL_VEHICLES])
def test_the_same_from_anywhere_in_the_zone(number):
    here = view((0.35, 0.25), (0.65, 0.35), (0.25, 0.45), number)
    there = view((0.55, 0.65), (0.85, 0.75), (0.45, 0.85), number)
    np.testing.assert_allclose(here, there, atol=1e-5)
    assert here.max() > 0.5


def test_the_middle_of_what_is_seen_is_where_the_vehicle_is():
    """To a twentieth of a cell: what lay between the cells is not lost."""
    for away in (0.1, 0.2, 0.3):
        weight = view((0.35, 0.55), (0.9, 0.9), (0.35 + away, 0.45), GLOBAL_VEHICLES)
        offset = np.arange(SIDE) - (N - 1)
        east, north = (weight.sum(0) @ offset) / weight.sum(), (weight.sum(1) @ offset) / weight.sum()
        assert east / N == pytest.approx(away, abs=0.01)
        assert north / N == pytest.approx(-0.1, abs=0.01)


@pytest.mark.parametrize("number", [GLOBAL_TEAM, GLOBAL_VEHICLES])
def test_in_ranges_the_same_at_every_scale(number):
    """Half of everything, seen with half the range."""
    names, n = map_names(obstacles=False, energy=False, tells_range=True), 11
    seen = []
    for scale in (1.0, 0.5):
        uavs, vehicle = scale * np.array([[0.5, 0.5], [0.7, 0.9]]), scale * np.array([[0.9, 0.3]])
        scene = Scene(jnp.array(uavs), jnp.array(vehicle), jnp.array([0]), jnp.float32(scale / 2))
        levels = six_maps(scene, jnp.array([True, True]), n, 3)
        told = jnp.concatenate([levels, range_map(jnp.float32(scale / 2), 2, n).astype(levels.dtype)[:, None]], 1)
        view = egocentric.egocentric(normalise(told, 3, names), names)[0]
        side = egocentric.side(n, names)
        first = 2 * n + egocentric.moved(names).index(number) * side**2
        square = np.asarray(view[first : first + side**2]).reshape(side, side)
        marks = egocentric.marks()[0].ravel()
        seen.append((square.sum(0) @ marks / square.sum(), square.sum(1) @ marks / square.sum()))
    # What a cell is, in ranges, is how well a place can be told.
    np.testing.assert_allclose(seen[0], seen[1], atol=2 / (3 * n))
    assert seen[0] == pytest.approx((0.4, 0.8) if number == GLOBAL_TEAM else (0.8, -0.4), abs=1 / (3 * n))


@pytest.mark.parametrize(
    "names", [PAPER_MAPS, map_names(obstacles=False, energy=False, tells_range=True, outlook=True)]
)
def test_an_empty_row_is_zeros(names):
    assert not jnp.any(egocentric.egocentric(jnp.zeros((1, len(names), N, N)), names))
