"""A reward and networks of one's own in a training."""

import dataclasses
import json

import jax.numpy as jnp
import pytest

from skyrelay.core.errors import TrainingError
from skyrelay.learning.ppo import OwnReward
from skyrelay.learning.presets import training, with_network
from skyrelay.learning.training import train
from skyrelay.policy import Policy

SMALL = training("fast", (2, 2), (4, 4), steps=2048)


def stay_apart(before, after, score):
    """Of each UAV: how far it is from the zone's middle."""
    return jnp.abs(after.uavs - 0.5).sum(-1)


def test_a_reward_of_ones_own_is_what_is_learned_for(tmp_path):
    own = train(SMALL, tmp_path / "own", evaluation_episodes=4, decider=OwnReward("mine:stay_apart", stay_apart))
    usual = train(SMALL, tmp_path / "usual", evaluation_episodes=4)
    assert own.policy.read_bytes() != usual.policy.read_bytes()  # the same seed, another lesson
    assert json.loads((tmp_path / "own" / "training.json").read_text())["training"]["reward"] == "mine:stay_apart"
    with pytest.raises(TrainingError):  # another reward's checkpoint is another training's
        train(SMALL, tmp_path / "own", resume=True, evaluation_episodes=4)


@pytest.mark.parametrize(
    ("function", "told"),
    [
        (lambda before, after, score: jnp.zeros(3), "of shape"),
        (lambda before, after, score: score.rewards, "AttributeError"),
        (lambda before, after, score: "much", "a reward of each UAV"),
    ],
)
def test_a_reward_that_is_none_is_one_line(tmp_path, function, told):
    with pytest.raises(TrainingError, match=told):
        train(SMALL, tmp_path / "out", decider=OwnReward("mine:wrong", function))


def test_networks_of_ones_own_fly(tmp_path):
    config = with_network(SMALL, "mine:narrow", lambda network: dataclasses.replace(network, hidden=(16,)))
    trained = train(config, tmp_path / "narrow", evaluation_episodes=4)
    assert trained.actor.architecture.hidden == (16,)
    assert Policy.load(str(trained.policy)).card.n == 9


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda network: dataclasses.replace(network, n=7), "the games' own n and maps"),
        (lambda network: None, "an Architecture"),
        (lambda network: network.widths, "AttributeError"),
    ],
)
def test_networks_that_are_none_are_one_line(change, told):
    with pytest.raises(TrainingError, match=told):
        with_network(SMALL, "mine:wrong", change)
