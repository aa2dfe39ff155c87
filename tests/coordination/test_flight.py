"""Motion and links: against plain loops, and the same in JAX and NumPy."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
from game_reference import connected
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skyrelay.airspace import flight

# Whole numbers: distances are exact, so that no rounding decides a link.
positions = st.integers(1, 7).flatmap(lambda n: arrays(np.int64, (n, 2), elements=st.integers(0, 12)))


def test_actions_are_the_papers_angles():
    moves = flight.unit_moves()
    assert moves.shape == (flight.ACTIONS, 2)
    assert tuple(moves[flight.STAY]) == (0.0, 0.0)
    for k in range(1, 9):
        theta = 2 * math.pi * k / 8
        np.testing.assert_allclose(moves[k], (math.cos(theta), math.sin(theta)), atol=1e-7)


def test_a_move_ends_at_the_border():
    uavs = np.array([[0.99, 0.5], [0.5, 0.5]], dtype=np.float32)
    moved = flight.move(uavs, np.array([8, 2]), 0.05)
    np.testing.assert_allclose(moved, [[1.0, 0.5], [0.5, 0.55]], atol=1e-6)
    in_metres = flight.move(np.array([[5.0, 5.0]]), np.array([4]), 30.0, np.array([0.0, 0.0]), np.array([100.0, 100.0]))
    np.testing.assert_allclose(in_metres, [[0.0, 5.0]], atol=1e-5)


@settings(deadline=None)  # the first example pays for imports
@given(positions, st.integers(0, 12), st.data())
def test_links_against_plain_loops(points, reach, data):
    active = data.draw(arrays(np.bool_, len(points)))
    graph = flight.links(points.astype(np.float64), float(reach), active)
    flying = [tuple(point) for point, there in zip(points, active, strict=True) if there]
    assert bool(flight.connectivity(graph, active)) == connected(flying, reach)
    neighbored = len(flying) <= 1 or all(
        any(math.dist(a, b) <= reach for j, b in enumerate(flying) if j != i) for i, a in enumerate(flying)
    )
    assert bool(flight.connectivity_neighbor(graph, active)) == neighbored


@settings(deadline=None)  # the first example pays for imports
@given(positions, st.integers(0, 12), st.data())
def test_coverage_against_plain_loops(uavs, reach, data):
    vehicles = data.draw(arrays(np.int64, (data.draw(st.integers(0, 9)), 2), elements=st.integers(0, 12)))
    owner = data.draw(arrays(np.int64, len(vehicles), elements=st.integers(-1, len(uavs) - 1)))
    inside = [math.dist(uavs[o], v) <= reach for v, o in zip(vehicles, owner, strict=True) if o >= 0]
    expected = sum(inside) / len(inside) if inside else 1.0
    result = flight.coverage(uavs.astype(np.float64), vehicles.astype(np.float64), owner, float(reach))
    assert math.isclose(float(result), expected)


def test_jax_and_numpy_agree_on_batches():
    random = np.random.default_rng(1)
    uavs = random.uniform(0, 1, (50, 6, 2)).astype(np.float32)
    vehicles = random.uniform(0, 1, (50, 15, 2)).astype(np.float32)
    owner = random.integers(-1, 6, (50, 15))
    reach = random.uniform(0.1, 0.7, 50).astype(np.float32)
    active = random.random((50, 6)) < 0.8
    actions = random.integers(0, 9, (50, 6))
    for function, arguments in (
        (flight.move, (uavs, actions, reach)),
        (flight.coverage, (uavs, vehicles, owner, reach)),
        (flight.served, (uavs, vehicles, owner, reach)),
        (flight.links, (uavs, reach, active)),
    ):
        np.testing.assert_allclose(function(*map(jnp.asarray, arguments)), function(*arguments), rtol=1e-5)
    graph = flight.links(uavs, reach, active)
    for measure in (flight.connectivity, flight.connectivity_neighbor):
        batch = measure(graph, active)
        np.testing.assert_array_equal(measure(jnp.asarray(graph), jnp.asarray(active)), batch)
        np.testing.assert_array_equal([measure(graph[i], active[i]) for i in range(50)], batch)
        assert 0 < batch.sum() < 50
