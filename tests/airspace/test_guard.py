"""The guard: whoever moves only as it allows, however, a linked team stays linked."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree

from skyrelay.airspace.flight import connectivity, links, move
from skyrelay.airspace.guard import keep_apart, safe_moves, spanning_tree, too_far

REACH, STEP = np.asarray(0.4), np.asarray(0.05)


def linked(uavs, active):
    return bool(connectivity(links(uavs, REACH, active), active))


def joined_team(random, uavs, reach=0.4):
    """[N, 2]: each within range of one before it, often at the very edge."""
    places = [random.uniform(0.0, 1.0, 2)]
    while len(places) < uavs:
        angle, away = random.uniform(0, 2 * np.pi), (1 - 2e-5) * reach * random.choice([1.0, random.uniform(0, 1)])
        place = places[random.integers(len(places))] + away * np.array([np.cos(angle), np.sin(angle)])
        if (place >= 0).all() and (place <= 1).all():
            places.append(place)
    return np.array(places)


@pytest.mark.parametrize("uavs", [1, 2, 3, 6, 8])
def test_the_tree_is_the_minimum_spanning_tree(uavs):
    random = np.random.default_rng(uavs)
    for _ in range(20):
        places = random.uniform(0, 1, (uavs, 2))
        apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
        expected = minimum_spanning_tree(apart).toarray() > 0
        found = spanning_tree(places, np.ones(uavs, bool))
        np.testing.assert_array_equal(found, expected | expected.T)


def test_who_is_not_there_is_in_no_tree():
    places = np.array([[0.1, 0.5], [0.5, 0.5], [0.9, 0.5]])
    tree = spanning_tree(places, np.array([True, False, True]))
    assert tree.tolist() == [[False, False, True], [False, False, False], [True, False, False]]


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), uavs=st.integers(2, 8), absent=st.booleans())
def test_any_choice_among_safe_moves_keeps_a_team_linked(seed, uavs, absent):
    random = np.random.default_rng(seed)
    places, active = joined_team(random, uavs), np.ones(uavs, bool)
    if absent:  # a row that holds no UAV, anywhere
        places, active = np.vstack([places, random.uniform(0, 1, 2)]), np.append(active, False)
    assert linked(places, active)
    for _ in range(5):
        safe = safe_moves(places, active, REACH, STEP)
        assert safe.any(axis=0).all()
        actions = np.array([random.choice(np.flatnonzero(safe[:, uav])) for uav in range(len(places))])
        places = np.where(active[:, None], move(places, actions, STEP), places)
        assert linked(places, active)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), uavs=st.integers(2, 6))
def test_a_scattered_team_comes_together_by_safe_moves_alone(seed, uavs):
    random = np.random.default_rng(seed)
    places, active = random.uniform(0, 1, (uavs, 2)), np.ones(uavs, bool)
    for _ in range(100):
        safe = safe_moves(places, active, REACH, STEP)
        assert safe.any(axis=0).all()
        actions = np.array([random.choice(np.flatnonzero(safe[:, uav])) for uav in range(uavs)])
        places = move(places, actions, STEP)
    assert linked(places, active)


def test_a_uav_alone_may_go_anywhere():
    assert safe_moves(np.array([[0.5, 0.5]]), np.array([True]), REACH, STEP).all()
    assert safe_moves(np.array([[0.5, 0.5], [0.9, 0.9]]), np.array([True, False]), REACH, STEP).all()


def test_two_at_the_edge_may_not_part():
    uavs = np.array([[0.3, 0.5], [0.7, 0.5]])
    safe = safe_moves(uavs, np.ones(2, bool), np.asarray(0.4), STEP)
    # North-east, north, north-west, west, south-west, south, south-east, east.
    assert safe[1:, 0].tolist() == [True, False, False, False, False, False, True, True]
    assert safe[1:, 1].tolist() == [False, False, True, True, True, False, False, False]
    # Straight across, half a step out of the disc about the middle: (0.2^2 + 0.05^2)^(1/2) - 0.2.
    away = too_far(move(uavs[None], np.array([[2, 2]]), STEP), uavs, np.ones(2, bool), np.asarray(0.4))
    np.testing.assert_allclose(away, [[0.006155, 0.006155]], atol=3e-6)


def test_the_same_compiled():
    random = np.random.default_rng(1)
    for _ in range(20):
        places, active = random.uniform(0, 1, (5, 2)).astype(np.float32), random.uniform(0, 1, 5) < 0.8
        expected = safe_moves(places, active, np.float32(0.4), np.float32(0.05))
        found = jax.jit(safe_moves)(*map(jnp.asarray, (places, active, np.float32(0.4), np.float32(0.05))))
        np.testing.assert_array_equal(found, expected)


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), uavs=st.integers(2, 8), crowded=st.booleans())
def test_whatever_each_chooses_no_two_come_nearer_than_the_separation(seed, uavs, crowded):
    random = np.random.default_rng(seed)
    places, separation = random.uniform(0, 0.1 if crowded else 1.0, (uavs, 2)), 0.08
    pairs = np.triu_indices(uavs, 1)
    for _ in range(8):
        before = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))[pairs]
        ends = []
        for own in range(uavs):
            reached = move(np.tile(places[own], (9, 1)), np.arange(9), STEP)
            free = keep_apart(reached, places[own], np.delete(places, own, axis=0), separation)
            assert free[0]  # staying is always one
            ends.append(reached[random.choice(np.flatnonzero(free))])
        places = np.array(ends)
        after = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))[pairs]
        assert (after >= np.minimum(before, separation) * (1 - 2e-5)).all()


def test_who_is_in_another_s_way_is_kept_from_its_side_alone():
    places, own, other = np.array([[0.1, 0.0], [-0.1, 0.0], [0.0, 0.1]]), np.zeros(2), np.array([[0.2, 0.0]])
    assert keep_apart(places, own, other, 0.1).tolist() == [False, True, True]
    assert keep_apart(places, own, own[None], 0.1).all()  # in one place: whoever leaves, leaves
