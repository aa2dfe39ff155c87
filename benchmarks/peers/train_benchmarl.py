"""Time that BenchMARL's IPPO (PyTorch) needs to the paper's level on SkyRelay's PettingZoo game.

Run by benchmarks/training.py in the peers' environment. The networks are those of the preset ``fast`` on the paper's
maps, and so are the batch, the epochs and the discounts; the reward is Eq. 3's. Greedy tests play the same unseen games
as ours, by the compiled evaluation, and their time does not count.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import torch
from benchmarl.algorithms import IppoConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from egocentric_mlp import EgocentricMlpConfig
from tensordict import TensorDict
from torch import nn
from torchrl.envs import ExplorationType, set_exploration_type

from skyrelay.coordination.benchmarl import GROUP, UavCoordinationTask
from skyrelay.coordination.pettingzoo import parallel_env
from skyrelay.learning.evaluation import UNSEEN, episodes_of, starts
from skyrelay.learning.presets import training


class ReachedError(Exception):
    """The level is reached, or the time is up."""


class GreedyTests(Callback):  # type: ignore[misc] # the library has no types
    """A greedy test after every few updates; ends the training at the level or the limit."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__()
        self.options = options
        self.rows: list[dict[str, float]] = []
        self.seconds = 0.0
        self.resumed = time.perf_counter()

    def on_train_end(self, training_td: TensorDict, group: str) -> None:  # noqa: ARG002, the library's
        """Test, off the clock."""
        self.seconds += time.perf_counter() - self.resumed
        frames = self.experiment.total_frames
        late = self.seconds > self.options.limit
        if late or (frames // self.options.batch) % self.options.every == 0:
            self.rows.append({"steps": frames, "seconds": self.seconds, "return": self.test()})
            print(json.dumps(self.rows[-1]), flush=True)
            if late or self.rows[-1]["return"] > self.options.level:
                raise ReachedError
        self.resumed = time.perf_counter()

    def test(self) -> float:
        """Mean return of the greedy policy over unseen episodes."""
        options = self.options
        config = training("fast", (options.uavs,) * 2, (options.vehicles,) * 2, seed=options.seed, paper_maps=True)
        shape, policy = config.shape, self.experiment.group_policies[GROUP]

        def decide(maps: np.ndarray) -> np.ndarray:
            teams = torch.from_numpy(np.array(maps)).reshape(-1, shape.uavs, *maps.shape[1:])
            with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
                decided: Any = policy(TensorDict({GROUP: {"observation": teams}}, batch_size=[len(teams)]))
            actions: np.ndarray = decided[GROUP, "action"].reshape(-1).numpy()
            return actions

        key = jax.random.fold_in(jax.random.key(config.seed), UNSEEN - 1)
        return float(np.mean(episodes_of(decide, starts(key, options.episodes, shape, config.domain))[0]))


def main() -> None:
    """Train until the level or the limit; write the tests as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the library's logs and tests.json")
    parser.add_argument("--uavs", type=int, default=3)
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--games", type=int, default=128)
    parser.add_argument("--batch", type=int, default=2048)
    parser.add_argument("--entropy", type=float, default=0.01)
    parser.add_argument("--every", type=int, default=2, help="updates between two tests")
    parser.add_argument("--episodes", type=int, default=200, help="of a test")
    parser.add_argument("--level", type=float, default=-5.0)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds of training")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    preset = training("fast", (options.uavs,) * 2, (options.vehicles,) * 2, paper_maps=True).hyperparameters
    config = ExperimentConfig.get_from_yaml()
    config.loggers, config.create_json, config.evaluation, config.render = [], False, False, False
    config.save_folder = options.out
    config.max_n_frames = 10_000_000
    config.on_policy_n_envs_per_worker = options.games
    config.on_policy_collected_frames_per_batch = options.batch
    config.on_policy_minibatch_size = options.batch // preset.minibatches
    config.on_policy_n_minibatch_iters = preset.epochs
    config.lr, config.gamma, config.clip_grad_val = preset.learning_rate, preset.gamma, preset.max_gradient
    algorithm = IppoConfig.get_from_yaml()
    algorithm.lmbda, algorithm.clip_epsilon, algorithm.critic_coef = preset.decay, preset.clip, preset.value
    algorithm.entropy_coef = options.entropy
    widths = list(preset.actor.hidden)
    network = EgocentricMlpConfig(num_cells=widths, layer_class=nn.Linear, activation_class=nn.ReLU)
    game = {"uavs": options.uavs, "vehicles": options.vehicles, "n": preset.actor.n}
    tests = GreedyTests(options)
    task: Any = UavCoordinationTask.PAPER
    experiment = Experiment(
        task.get_task(game),
        algorithm,
        network,
        options.seed,
        config,
        callbacks=[tests],
    )
    compiled = parallel_env(**game)  # as compilation does not count for ours
    compiled.reset(seed=0)
    compiled.step(dict.fromkeys(compiled.agents, 0))
    try:
        tests.resumed = time.perf_counter()
        experiment.run()
    except ReachedError:
        pass
    (options.out / "tests.json").write_text(json.dumps(tests.rows))


if __name__ == "__main__":
    main()
