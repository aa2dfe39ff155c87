import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from skyrelay.baselines.centroid import Centroid, centroids, connected
from skyrelay.baselines.player import play
from skyrelay.coordination import game
from skyrelay.learning.evaluation import starts


def _game(key, shape, domain):
    return jax.tree.map(lambda x: x[0], starts(key, 1, shape, domain))


def test_centroids_are_the_means_of_own_vehicles(key, shape, moving):
    state = _game(key, shape, moving)
    found, owner = np.asarray(jax.jit(centroids)(state)), np.asarray(state.served_by)
    for uav in range(shape.uavs):
        own = np.asarray(state.traffic.position)[owner == uav]
        expected = own.mean(axis=0) if len(own) else np.asarray(state.uavs)[uav]
        np.testing.assert_allclose(found[uav], expected, atol=1e-6)


def test_a_uav_without_vehicles_stays(key, shape, still):
    state = _game(key, shape, still)
    state = dataclasses.replace(state, owner=jnp.ones_like(state.owner))
    actions, _ = jax.jit(Centroid().act)(state, None)
    assert (np.asarray(actions)[[0, 2]] == 0).all()


def test_the_rule_arrives_over_its_vehicles(key, shape, still):
    state, turn = _game(key, shape, still), jax.jit(lambda s: game.step(s, Centroid().act(s, None)[0])[0])
    for _ in range(shape.steps):
        state = turn(state)
    distance = np.linalg.norm(np.asarray(state.uavs - jax.jit(centroids)(state)), axis=-1)
    # Eight headings of one length leave at most half a step in each direction.
    assert (distance <= float(state.parameters.uav_step)).all()


def test_linked_never_gives_up_a_connection(key, shape, moving):
    played = play(Centroid(linked=True), key, 64, shape, moving)
    connectivity = np.asarray(played.joined("connectivity"))
    assert (np.diff(connectivity, axis=0) >= 0.0).all()
    assert connectivity[-1].all()


def test_connected_is_the_games_own_measure(key, shape, moving):
    games = starts(key, 40, shape, moving)
    ours = jax.jit(jax.vmap(lambda state: connected(state, state.uavs)))(games)
    theirs = jax.jit(jax.vmap(game.measure))(games).connectivity
    assert 0 < int(ours.sum()) < 40
    np.testing.assert_array_equal(np.asarray(ours, float), theirs)
