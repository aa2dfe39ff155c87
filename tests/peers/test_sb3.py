"""Stable-Baselines3 trains on the game: in an environment of its own (make test-peers)."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="needs Stable-Baselines3: make test-peers")


@pytest.fixture
def envs():
    import skyrelay as sr
    from skyrelay.coordination.sb3 import UavSb3

    return UavSb3(sr.make_vec("paper", games=3, uavs=2, vehicles=4))


def test_a_policy_learns(envs):
    from stable_baselines3 import PPO

    model = PPO("MlpPolicy", envs, n_steps=120, batch_size=90, n_epochs=1, seed=1)
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(720)
    assert model.num_timesteps == 720
    assert any((old != new).any() for old, new in zip(before, model.policy.parameters(), strict=True))
    actions, _ = model.predict(envs.reset(), deterministic=True)
    assert actions.shape == (6,)


def test_rows_play_what_the_games_play(envs):
    import skyrelay as sr

    plain = sr.make_vec("paper", games=3, uavs=2, vehicles=4)
    envs.seed(5)
    seen, (expected, _) = envs.reset(), plain.reset(seed=5)
    np.testing.assert_array_equal(seen, expected)
    rng = np.random.default_rng(1)
    for step in range(1, 102):
        actions = rng.integers(0, 9, 6)
        seen, rewards, over, infos = envs.step(actions)
        expected, wanted, _, truncated, told = plain.step(actions)
        np.testing.assert_array_equal(seen, expected)
        np.testing.assert_allclose(rewards, wanted, rtol=1e-6)
        np.testing.assert_array_equal(over, truncated)
        assert over.all() == (step == 100)
        assert all(("terminal_observation" in info) == (step == 100) for info in infos)
        if step == 100:
            np.testing.assert_array_equal(infos[4]["terminal_observation"], told["final_obs"][4])
            assert infos[4]["TimeLimit.truncated"]


def test_what_rows_cannot_do_is_said(envs):
    from skyrelay.core.errors import UsageError

    envs.reset()
    with pytest.raises(UsageError, match="step: actions"):
        envs.step(np.full(6, 9))
    with pytest.raises(NotImplementedError, match="all rows are the same games"):
        envs.set_attr("games", 4)
    assert envs.get_attr("games", [0, 2]) == [3, 3]
    assert envs.env_is_wrapped(object) == [False] * 6
