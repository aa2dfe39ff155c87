"""Evaluation: both ways of playing agree, and so do the intervals with their definition."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from skyrelay.core.statistics import interval
from skyrelay.learning import networks
from skyrelay.learning.evaluation import episodes_of, greedy_episodes, policy_episodes, starts, summary
from skyrelay.learning.onnx import export
from skyrelay.learning.training import make_card
from skyrelay.policy import Policy


def test_compiled_and_stepped_play_agree(tiny):
    actor = networks.actor(jax.random.key(1), tiny.hyperparameters.actor)
    key = jax.random.key(2)
    compiled = greedy_episodes(actor, key, 6, tiny.shape, tiny.domain)
    games = starts(key, 6, tiny.shape, tiny.domain)
    stepped = episodes_of(lambda maps: np.asarray(actor(jnp.asarray(maps))).argmax(-1), games)
    np.testing.assert_allclose(compiled, stepped, rtol=1e-5)
    measures = summary(compiled)
    assert set(measures) == {"return", "coverage", "connectivity", "connectivity_neighbor"}
    steps = tiny.shape.steps
    expected = steps * (measures["coverage"]["mean"] + measures["connectivity"]["mean"] - 2)
    assert measures["return"]["mean"] == pytest.approx(expected, rel=1e-4)


def test_interval_is_students():
    values = np.random.default_rng(0).normal(3, 2, 20)
    low, high = stats.t.interval(0.95, 19, loc=values.mean(), scale=stats.sem(values))
    found = interval(values).closed()
    assert (found["mean"], found["low"], found["high"]) == pytest.approx((values.mean(), low, high))
    assert interval([2.0]).closed() == {"mean": 2.0, "low": 2.0, "high": 2.0}


def test_a_policy_is_told_the_range_where_it_wants_to_be(tiny):
    shape = replace(tiny.shape, tells_range=True)
    network = replace(tiny.hyperparameters.actor, maps=shape.maps, channels=(), strides=(), pools=(), egocentric=True)
    actor = networks.actor(jax.random.key(1), network)
    # The first outputs are nearly equal by design; larger ones decide clearly.
    actor = eqx.tree_at(lambda net: net.layers[-1].weight, actor, actor.layers[-1].weight * 100)
    config = replace(tiny, hyperparameters=replace(tiny.hyperparameters, actor=network), shape=shape)
    policy = Policy.load(export(actor, make_card(config, "told", "pytest", [])))
    key = jax.random.key(2)
    expected = greedy_episodes(actor, key, 6, shape, tiny.domain)
    for games in (starts(key, 6, tiny.shape, tiny.domain), starts(key, 6, shape, tiny.domain)):
        np.testing.assert_allclose(policy_episodes(policy, games), expected, rtol=1e-5)
