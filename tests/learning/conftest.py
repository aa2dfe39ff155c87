"""A training small enough to compile and run in seconds."""

from __future__ import annotations

import pytest

from skyrelay.coordination.settings import Shape, physical
from skyrelay.learning.networks import Architecture
from skyrelay.learning.ppo import Hyperparameters
from skyrelay.learning.presets import Training


@pytest.fixture(scope="session")
def tiny() -> Training:
    """Two UAVs, four vehicles, maps of 5 x 5, four updates."""
    network = Architecture(n=5, channels=(4,), strides=(1,), pools=(2,), hidden=(8,))
    hyperparameters = Hyperparameters(
        actor=network,
        critic=network,
        games=4,
        horizon=5,
        epochs=2,
        minibatches=2,
        learning_rate=1e-3,
        anneal=True,
        own_credit=True,
        shaping=0.5,
        symmetries=True,
    )
    shape, domain = Shape(2, 4, n=5, steps=8), physical((1, 2), (4, 4))
    return Training("tiny", hyperparameters, shape, domain, steps=80, seed=3, test_every=40, test_episodes=3)
