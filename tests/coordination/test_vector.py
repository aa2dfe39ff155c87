"""Many games as one Gymnasium vector environment: the same games as one by one."""

import gymnasium
import numpy as np
import pytest

import skyrelay as sr
from skyrelay.core.errors import UsageError

OPTIONS = {"uavs": 2, "vehicles": 4, "steps": 6, "n": 5}


@pytest.fixture
def envs():
    return sr.make_vec("paper", games=3, **OPTIONS)


def test_it_is_what_gymnasium_expects(envs):
    assert isinstance(envs, gymnasium.vector.VectorEnv)
    observations, infos = envs.reset(seed=1)
    assert envs.num_envs == 6
    assert observations in envs.observation_space
    assert infos == {}
    observations, rewards, terminated, truncated, infos = envs.step(envs.action_space.sample())
    assert observations in envs.observation_space
    assert rewards.shape == terminated.shape == truncated.shape == infos["coverage"].shape == (6,)
    assert not terminated.any()
    assert np.array_equal(rewards[::2], rewards[1::2])  # a team has one reward


def test_episodes_follow_each_other_and_a_seed_gives_the_same(envs):
    def played():
        rows = [envs.reset(seed=4)[0]]
        for number in range(13):
            observations, rewards, _, truncated, infos = envs.step(np.full(6, number % 9))
            assert truncated.all() == ((number + 1) % 6 == 0) == ("final_obs" in infos)
            if truncated.any():
                assert not np.array_equal(infos["final_obs"], observations)
            rows += [observations, rewards]
        return rows

    assert all(np.array_equal(one, other) for one, other in zip(played(), played(), strict=True))


@pytest.mark.parametrize(
    "actions", [np.full(6, 9), np.full(6, -1), np.full(6, 1.0), np.zeros(5, int), np.zeros((3, 2), int)]
)
@pytest.mark.usefixtures("unchecked")
def test_actions_that_are_none_are_refused(envs, actions):
    before = envs.reset(seed=1)[0]
    with pytest.raises(UsageError, match="of 0 to 8"):
        envs.step(actions)
    assert np.array_equal(envs.reset(seed=1)[0], before)


def test_what_does_not_fit_is_refused(envs):
    with pytest.raises(RuntimeError, match="call reset"):
        envs.step(np.zeros(6, int))
    with pytest.raises(UsageError, match="one number for all rows"):
        envs.reset(seed=[1, 2])
    with pytest.raises(UsageError, match="UAVs drop out"):
        sr.make_vec("varied", games=2, **OPTIONS)
    with pytest.raises(UsageError, match="1 to 65,536"):
        sr.make_vec("paper", games=0, **OPTIONS)
