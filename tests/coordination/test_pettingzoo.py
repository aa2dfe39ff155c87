"""PettingZoo's conformance tests, ours, and ours against environments that break the rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from skyrelay.coordination.pettingzoo import UavCoordination, parallel_env
from skyrelay.coordination.settings import Domain, Shape, physical
from skyrelay.coordination.testing import check_parallel_env
from skyrelay.core.errors import UsageError


def small() -> UavCoordination:
    return parallel_env(uavs=3, vehicles=6, n=5, steps=12)


def test_parallel_api():
    parallel_api_test(small(), num_cycles=40)


def test_parallel_seed():
    parallel_seed_test(small, num_cycles=20)


def test_ours():
    assert check_parallel_env(small, episodes=3) == 36


@pytest.mark.parametrize("action", [-1, 9, 1.7, 1.0, float("nan"), True, None, "1", np.array([1, 2]), np.float32(3)])
def test_an_action_that_is_none_is_refused_and_nobody_has_moved(action):
    env = small()
    env.reset(seed=0)
    before = env.state()
    with pytest.raises(UsageError, match=r"step: action of uav_1.* expected a whole number from 0 to 8"):
        env.step({"uav_0": 3, "uav_1": action, "uav_2": 0})
    np.testing.assert_array_equal(env.state(), before)


def test_an_agent_without_an_action_is_named():
    env = small()
    env.reset(seed=0)
    with pytest.raises(UsageError, match="action of uav_2"):
        env.step({"uav_0": 3, "uav_1": 0})


def test_whole_numbers_of_any_kind_are_actions():
    positions = []
    for action in (2, np.int64(2), np.uint8(2), np.array(2)):
        env = small()
        env.reset(seed=0)
        env.step(dict.fromkeys(env.agents, action))
        positions.append(env.state())
    np.testing.assert_array_equal(positions[1:], [positions[0]] * 3)


def test_a_domain_of_many_scales_conforms():
    domain = Domain((2, 2), (1, 6), ratio=(1.5, 3.0), uav_step=(0.02, 0.1), halt=(0.0, 0.5), go=(0.1, 1.0))
    shape = Shape(2, 6, n=5, steps=8, mobility="mixed")
    assert check_parallel_env(lambda: UavCoordination(shape, domain), episodes=3) == 24


def test_the_outlook_is_an_action_mask():
    """A team that keeps to it comes together, and then stays linked."""
    shape, domain = Shape(4, 6, n=5, steps=80, outlook=True), replace(physical((4, 4), (6, 6)), ratio=(3.0, 3.0))
    env, random = UavCoordination(shape, domain), np.random.default_rng(1)
    assert check_parallel_env(lambda: UavCoordination(replace(shape, steps=8), domain), episodes=2) == 16
    assert "action_mask" not in small().reset(seed=0)[1]["uav_0"]
    _, infos = env.reset(seed=0)
    linked = []
    while env.agents:
        for agent in env.agents:
            mask = infos[agent]["action_mask"]
            assert mask.dtype == np.int8
            assert mask.shape == (env.action_space(agent).n,)
        actions = {agent: int(random.choice(np.flatnonzero(infos[agent]["action_mask"]))) for agent in env.agents}
        observations, _, _, _, infos = env.step(actions)
        linked.append(infos["uav_0"]["connectivity"])
        assert all(env.observation_space(agent).contains(maps) for agent, maps in observations.items())
    assert linked == sorted(linked)
    assert linked[0] == 0.0
    assert linked[-1] == 1.0


def test_agents_whose_uav_leaves_terminate():
    shape = Shape(3, 6, n=5, steps=12, drop_outs=True)
    domain = replace(physical((3, 3), (6, 6)), drop_out=(0.2, 0.2))
    assert check_parallel_env(lambda: UavCoordination(shape, domain), episodes=3) == 36
    env = UavCoordination(shape, domain)
    env.reset(seed=1)
    left = {}
    while env.agents:
        _, _, terminations, truncations, _ = env.step(dict.fromkeys(env.agents, 0))
        left |= {agent: truncations[agent] for agent, over in terminations.items() if over}
    assert 0 < len(left) < 3  # the last one stays


class Unseeded(UavCoordination):
    """Random from the second step on: the library's own seed test does not notice."""

    def step(self, actions):
        observations, *rest = super().step(actions)
        if int(self._state.time) > 2:
            noise = np.random.default_rng().uniform(0, 0.1)
            observations = {agent: maps * np.float32(1 - noise) for agent, maps in observations.items()}
        return observations, *rest


class OutOfSpace(UavCoordination):
    def step(self, actions):
        observations, *rest = super().step(actions)
        return {agent: maps - np.float32(1) for agent, maps in observations.items()}, *rest


class Undead(UavCoordination):
    def step(self, actions):
        result = super().step(actions)
        self.agents = self.possible_agents[:]
        return result


@pytest.mark.parametrize(
    ("broken", "fault"), [(Unseeded, "two results"), (OutOfSpace, "outside its space"), (Undead, "over is True")]
)
def test_ours_finds_faults(broken, fault):
    def make():
        good = small()
        return broken(good.shape, good.domain)

    with pytest.raises(AssertionError, match=fault):
        check_parallel_env(make)


def test_one_team_size():
    with pytest.raises(UsageError, match="team size"):
        UavCoordination(Shape(4, 5), Domain((2, 4), (5, 5)))


def test_state_has_every_position():
    env = small()
    env.reset(seed=3)
    state = env.state()
    assert state.shape == (3 * 3 + 4 * 6,)
    uavs = state[:9].reshape(3, 3)
    assert (uavs[:, 2] == 1).all()
    assert ((uavs[:, :2] >= 0) & (uavs[:, :2] <= 1)).all()
    assert env.state().dtype == np.float32
