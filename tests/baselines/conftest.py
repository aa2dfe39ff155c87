"""Games that are small enough to compile in seconds."""

import jax
import pytest

from skyrelay.coordination.settings import Domain, Shape


@pytest.fixture
def key():
    return jax.random.key(11)


@pytest.fixture(scope="session")
def shape():
    return Shape(uavs=3, vehicles=6, n=5, steps=30)


@pytest.fixture(scope="session")
def still():
    """Vehicles that never move: what a rule achieves in the end is known."""
    return Domain((3, 3), (6, 6), speed_ratio=(0.0, 0.0))


@pytest.fixture(scope="session")
def moving():
    return Domain((3, 3), (6, 6))
