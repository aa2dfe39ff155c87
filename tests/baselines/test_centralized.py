import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.baselines import centralized
from skyrelay.baselines.centralized import Central
from skyrelay.baselines.cost import centralized_cost, decentralized_cost
from skyrelay.baselines.player import Learned, play
from skyrelay.coordination.settings import Domain, Shape
from skyrelay.core.errors import UsageError
from skyrelay.learning import ppo
from skyrelay.learning.networks import FAST, PAPER, Architecture, actor
from skyrelay.learning.ppo import Hyperparameters

TINY = Architecture(5, (), (), (), (16,))
CONVOLUTIONAL = Architecture(5, (4,), (1,), (2,), (8,))
CONFIG = Hyperparameters(TINY, TINY, games=8, horizon=10, epochs=2, minibatches=2, learning_rate=1e-2, anneal=False)
SHAPE, DOMAIN = Shape(2, 4, n=5, steps=20), Domain((2, 2), (4, 4))


@eqx.filter_jit
def begun(key, config):
    return Central(2).begin(key, config, SHAPE, DOMAIN, 3)


@eqx.filter_jit
def collected(learner, config):
    return ppo.collect(learner, config, DOMAIN, decider=Central(2))[1]


@eqx.filter_jit
def loss(learner, rows, config):
    return ppo.loss((learner.actor, learner.critic), rows, config, SHAPE.zoom)


def test_separate_gives_the_digits_of_a_combination():
    joint = jnp.arange(9**3)
    actions = np.asarray(centralized.separate(joint, 3))
    assert len(np.unique(actions, axis=0)) == 9**3
    assert actions.min() == 0
    assert actions.max() == 8
    np.testing.assert_array_equal(actions @ np.array([1, 9, 81]), joint)
    np.testing.assert_array_equal(centralized.join(jnp.asarray(actions)), joint)


def test_a_turned_team_is_turned_uav_by_uav(key):
    """Turning the team's decision is turning each UAV's: the same as the decentralised experience, side by side."""
    maps = jax.random.randint(key, (5, 2, 6, 5, 5), 0, 9).astype(jnp.uint8)
    joint = jax.random.randint(key, (5,), 0, 81)
    blank = jnp.zeros(5)
    team = ppo.Experience(maps, joint, blank, blank, blank, blank == 0.0)
    for side in range(ppo.SYMMETRIES):
        whole = ppo.turned(team, jnp.int32(side), Central(2))
        for uav in range(2):
            own = team._replace(maps=maps[:, uav], action=centralized.separate(joint, 2)[:, uav])
            expected = ppo.turned(own, jnp.int32(side))
            np.testing.assert_array_equal(whole.maps[:, uav], expected.maps)
            np.testing.assert_array_equal(centralized.separate(whole.action, 2)[:, uav], expected.action)


@pytest.mark.parametrize("architecture", [TINY, CONVOLUTIONAL])
def test_the_joint_network_sees_every_uav(architecture, key):
    network = centralized.joint_actor(key, architecture, 3)
    maps = jax.random.uniform(key, (2, 3, 6, 5, 5))
    logits = network(maps)
    assert logits.shape == (2, 9**3)
    for uav in range(3):
        assert not np.allclose(network(maps.at[:, uav].set(0.0)), logits)
    # Each team of a batch is decided for by itself.
    np.testing.assert_allclose(network(maps[1:])[0], logits[1], atol=1e-6)


def test_experience_is_scored_by_the_network_that_made_it(key):
    """Before anything is optimised the ratio of probabilities is 1 and nothing is clipped."""
    learner = begun(key, CONFIG)
    learner = eqx.tree_at(lambda state: state.actor.layers[-1].weight, learner, learner.actor.layers[-1].weight * 100.0)
    experience = collected(learner, CONFIG)
    rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:]), experience)
    assert rows.maps.shape == (80, 2, 6, 5, 5)
    assert int(rows.action.max()) > 9
    _, parts = loss(learner, rows, CONFIG)
    assert float(parts["kl"]) == pytest.approx(0.0, abs=1e-5)
    assert float(parts["clipped"]) == 0.0


def test_an_update_makes_better_actions_likelier(key):
    config = dataclasses.replace(CONFIG, entropy=0.0, epochs=8)
    learner = begun(key, config)
    experience = collected(learner, config)
    rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:]), experience)
    before, _ = loss(learner, rows, config)
    later, metrics = jax.jit(lambda: eqx.filter(ppo.update(learner, config, DOMAIN, 3, Central(2)), eqx.is_array))()
    learned = eqx.combine(later, learner)
    after, _ = loss(learned, rows, config)
    assert float(after) < float(before)
    assert all(np.isfinite(value) for value in metrics.values())
    assert int(later.updates) == 1


def test_a_joint_network_plays(key):
    player = Learned(actor=centralized.joint_actor(key, TINY, 2), decider=Central(2))
    played = play(player, key, 4, SHAPE, DOMAIN)
    assert np.asarray(played.measures).shape == (4, 4)


@pytest.mark.parametrize("uavs", [(2, 3), (6, 6)])
def test_teams_of_many_sizes_or_too_many_outputs_are_refused(uavs, key):
    with pytest.raises(UsageError, match="team size"):
        Central(uavs[1]).begin(key, CONFIG, Shape(uavs[1], 4, n=5), Domain(uavs, (4, 4)), 3)


def test_costs_are_those_of_the_paper_where_they_can_be():
    assert decentralized_cost(PAPER).parameters == 1_692_969
    assert [centralized_cost(PAPER, uavs).parameters // 10_000 for uavs in (2, 5)] == [170, 931]


@pytest.mark.parametrize("architecture", [FAST, PAPER, CONVOLUTIONAL])
def test_operations_agree_with_the_compiler(architecture, key):
    """XLA counts activations and pooling too: a few per cent more."""
    network = actor(key, architecture)
    maps = jnp.zeros((1, 6, architecture.n, architecture.n))
    analysis = jax.jit(lambda maps: network(maps)).lower(maps).compile().cost_analysis()
    cost = decentralized_cost(architecture)
    assert cost.operations <= analysis["flops"] <= 1.15 * cost.operations
    assert cost.parameters == sum(leaf.size for leaf in jax.tree.leaves(eqx.filter(network, eqx.is_array)))
