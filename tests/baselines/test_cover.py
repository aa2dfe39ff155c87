"""The rule of each UAV alone: what it knows, its links, what it gains."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.baselines.centroid import Centroid
from skyrelay.baselines.cover import Cover
from skyrelay.baselines.player import play
from skyrelay.coordination import game
from skyrelay.coordination.settings import Shape, physical
from skyrelay.learning.evaluation import starts


def test_links_once_made_hold(key):
    """Both ends of a link stay within half a range of its middle."""
    for ratio in (2.0, 3.0):
        domain = replace(physical((4, 4), (12, 12)), ratio=(ratio, ratio))
        played = play(Cover(), key, 40, Shape(4, 12), domain)
        connectivity = np.asarray(played.joined("connectivity"))
        kept = connectivity[1:][connectivity[:-1] == 1.0]
        assert kept.mean() == 1.0
        assert connectivity[-1].mean() > 0.95


def test_it_decides_for_each_uav_alone():
    """The vehicles of the others do not matter to it, only where the others are."""
    domain = physical((3, 3), (9, 9))
    state = jax.tree.map(lambda x: x[0], starts(jax.random.key(4), 1, Shape(3, 9), domain))
    act = jax.jit(lambda state: Cover().act(state, None)[0])
    action = act(state)
    for uav in range(3):
        others = state.owner != uav
        elsewhere = jnp.where(others[:, None], 1.0 - state.traffic.position, state.traffic.position)
        changed = replace(state, traffic=state.traffic._replace(position=elsewhere))
        assert act(changed)[uav] == action[uav]


def test_it_goes_where_more_of_its_vehicles_are():
    """Three to the west and one far to the east: the centroid would lose all of them."""
    domain = replace(physical((1, 1), (4, 4)), ratio=(5.0, 5.0))
    state = jax.tree.map(lambda x: x[0], starts(jax.random.key(1), 1, Shape(1, 4), domain))
    vehicles = jnp.array([[0.3, 0.5], [0.3, 0.52], [0.3, 0.48], [0.9, 0.5]])
    state = replace(state, uavs=jnp.array([[0.55, 0.5]]), traffic=state.traffic._replace(position=vehicles))
    turn = jax.jit(lambda state: game.step(state, Cover().act(state, None)[0])[0])
    for _ in range(5):
        state = replace(turn(state), traffic=state.traffic)
    assert float(game.measure(state).coverage) == pytest.approx(0.75)


def test_better_than_the_centroid_rule(key):
    domain = physical((3, 3), (20, 20))
    ours, theirs = (play(rule, key, 40, Shape(3, 20), domain).measures[0] for rule in (Cover(), Centroid(linked=True)))
    assert float(ours.mean()) > float(theirs.mean()) + 1.0
