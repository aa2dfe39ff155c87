import dataclasses

import jax
import numpy as np
import pytest

from skyrelay.baselines.centroid import Centroid
from skyrelay.baselines.planner import Planner, _drive
from skyrelay.baselines.player import play
from skyrelay.coordination import game
from skyrelay.learning.evaluation import starts


@pytest.fixture(scope="module")
def planner():
    return Planner(horizon=8, futures=2, samples=6)


def test_it_covers_and_connects_a_still_game(planner, key, shape, still):
    played = play(planner, key, 16, shape, still)
    assert (np.asarray(played.steps.reward[-1]) == 0.0).mean() > 0.9


def test_it_is_ahead_of_the_linked_centroid_rule(planner, key, shape, moving):
    ours, theirs = (
        np.asarray(play(player, key, 48, shape, moving).measures)[0] for player in (planner, Centroid(linked=True))
    )
    assert (ours - theirs).mean() > 0.0


def test_foresight_sees_the_vehicles_that_will_come(key, shape, moving):
    state = jax.tree.map(lambda x: x[0], starts(key, 1, shape, moving))
    foresee, turn = jax.jit(_drive, static_argnums=1), jax.jit(game.step)
    foreseen = np.asarray(foresee(state, 5))
    other = np.asarray(foresee(dataclasses.replace(state, key=jax.random.key(99)), 5))
    assert not np.array_equal(foreseen, other)
    for step in range(5):
        state, _ = turn(state, jax.numpy.array([1, 2, 3]))
        np.testing.assert_array_equal(foreseen[step], state.traffic.position)
