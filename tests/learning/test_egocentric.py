"""Maps seen from the UAV: against plain loops, and what they are for."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.coordination.observation import observe
from skyrelay.core.maps import (
    GLOBAL_LOCATION,
    GLOBAL_TEAM,
    GLOBAL_VEHICLES,
    LOCATION_SCALE,
    PAPER_MAPS,
    map_names,
    normalise,
)
from skyrelay.learning import egocentric

N = 5
SIDE = 2 * N - 1


def slow(maps, names):
    """The same, cell by cell."""
    location = maps[GLOBAL_LOCATION] / LOCATION_SCALE
    column, row = location.sum(0), location.sum(1)
    parts = [egocentric.PLACE_SCALE * column, egocentric.PLACE_SCALE * row]
    for number, name in enumerate(names):
        if name in ("global_team", "global_coverage", "global_vehicles", "global_buildings", "global_charger"):
            view = np.zeros((SIDE, SIDE))
            for own_row in range(N):
                for own_column in range(N):
                    for r in range(N):
                        for c in range(N):
                            view[r - own_row + N - 1, c - own_column + N - 1] += (
                                row[own_row] * column[own_column] * maps[number, r, c]
                            )
            parts.append(view.ravel())
    local = ("local_buildings", "local_sight", "local_charger")
    parts += [maps[k].ravel() for k, name in enumerate(names) if name in local]
    parts += [maps[k, 0, :1] for k, name in enumerate(names) if name in ("own_flight", "at_charger")]
    return np.concatenate(parts)


@pytest.mark.parametrize("obstacles", [False, True])
@pytest.mark.parametrize("energy", [False, True])
def test_equals_the_plain_loops(obstacles, energy):
    names = map_names(obstacles=obstacles, energy=energy)
    maps = np.random.default_rng(1).random((3, len(names), N, N)).astype(np.float32)
    seen = egocentric.egocentric(jnp.asarray(maps), names)
    assert seen.shape == (3, egocentric.width(N, names))
    np.testing.assert_allclose(seen, [slow(one, names) for one in maps], rtol=1e-4, atol=1e-4)


def view(uav, other, vehicle, number):
    """[2 n - 1, 2 n - 1] of one map, of the first of two UAVs."""
    levels = observe(
        jnp.array([uav, other]), jnp.array([True, True]), jnp.array([vehicle]), jnp.array([0]), jnp.float32(0.4), N, 2
    )
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


def test_an_empty_row_is_zeros():
    assert not jnp.any(egocentric.egocentric(jnp.zeros((1, 6, N, N)), PAPER_MAPS))
