"""BenchMARL and TorchRL train on the game: in an environment of their own (make test-peers)."""

import csv
import importlib
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("benchmarl", reason="needs BenchMARL: make test-peers")

EXAMPLE = Path(__file__).parents[2] / "examples" / "train_with_benchmarl.py"


@pytest.fixture
def task():
    from skyrelay.coordination.benchmarl import UavCoordinationTask

    return UavCoordinationTask.PAPER.get_task({"uavs": 2, "vehicles": 4, "n": 5, "steps": 8})  # type: ignore[attr-defined]


def make(task, seed):
    return task.get_env_fun(num_envs=2, continuous_actions=False, seed=seed, device="cpu")


def test_torchrls_own_checks_pass(task):
    from torchrl.envs.utils import check_env_specs

    env = make(task, 3)()
    check_env_specs(env)
    assert task.group_map(env) == {"uav": ["uav_0", "uav_1"]}
    assert task.max_steps(env) == 8
    assert task.observation_spec(env)["uav", "observation"].shape == (2, 6, 5, 5)
    assert task.state_spec(env)["state"].shape == (3 * 2 + 4 * 4,)


def test_a_rollout_is_what_the_adapter_plays(task):
    from skyrelay.coordination.pettingzoo import parallel_env

    ours = parallel_env(uavs=2, vehicles=4, n=5, steps=8)
    env = make(task, 3)()
    rollout = env.rollout(20)
    assert rollout.batch_size == (8,)  # the time limit
    assert bool(rollout["next", "truncated"][-1])
    assert not bool(rollout["next", "terminated"].any())
    # The wrapper resets once by its seed, then once more at the rollout's start.
    ours.reset(seed=env.seed)
    observations, _ = ours.reset()
    for step in rollout:
        np.testing.assert_array_equal(step["uav", "observation"].numpy(), np.stack(list(observations.values())))
        actions = dict(zip(ours.agents, step["uav", "action"].tolist(), strict=True))
        observations, rewards, *_ = ours.step(actions)
        np.testing.assert_allclose(step["next", "uav", "reward"].flatten().numpy(), list(rewards.values()))


def test_games_side_by_side_differ_and_a_seed_repeats_them(task):
    first, second = ([env().reset()["state"] for env in [make(task, 3)] * 2] for _ in range(2))
    assert not np.array_equal(first[0], first[1])
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("algorithm", ["ippo", "mappo"])
def test_the_example_trains(algorithm, tmp_path):
    line = f"--algorithm {algorithm} --uavs 2 --vehicles 4 --episode 10 --frames 120 --games 2 --batch 40 --tests 2"
    result = subprocess.run(
        [sys.executable, str(EXAMPLE), *line.split(), "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert "120 steps trained" in result.stdout
    (losses,) = tmp_path.glob("**/train_uav_loss_objective.csv")
    values = [float(row[1]) for row in csv.reader(losses.open())]
    assert len(values) == 3
    assert np.isfinite(values).all()
    (returns,) = tmp_path.glob("**/eval_reward_episode_reward_mean.csv")
    assert all(-20 <= float(row[1]) <= 0 for row in csv.reader(returns.open()))


def test_the_peers_network_sees_what_ours_sees(monkeypatch):
    import torch

    from skyrelay.airspace.maps import PAPER_MAPS
    from skyrelay.learning import egocentric

    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks" / "peers")
    theirs = importlib.import_module("egocentric_mlp")
    maps = np.random.default_rng(0).random((2, 3, 6, 5, 5)).astype(np.float32)
    ours = egocentric.egocentric(jnp.asarray(maps.reshape(6, 6, 5, 5)), PAPER_MAPS)
    seen = theirs.egocentric(torch.from_numpy(maps)).numpy().reshape(6, -1)
    np.testing.assert_allclose(seen, ours, rtol=1e-5, atol=1e-5)
