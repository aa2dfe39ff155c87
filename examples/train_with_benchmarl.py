"""Train a team with BenchMARL, a PyTorch library, on SkyRelay's game.

pip install ".[peers]"
python examples/train_with_benchmarl.py --algorithm mappo --frames 60000 --out out/benchmarl
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarl.algorithms import IppoConfig, MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from torch import nn

from skyrelay.coordination.benchmarl import UavCoordinationTask

ALGORITHMS = {"ippo": IppoConfig, "mappo": MappoConfig}


def experiment(options: argparse.Namespace) -> Experiment:
    """PPO with parameters shared by all UAVs; under mappo the critic sees the whole game."""
    task = UavCoordinationTask.PAPER.get_task(  # type: ignore[attr-defined]
        {"uavs": options.uavs, "vehicles": options.vehicles, "n": 9, "steps": options.episode}
    )
    config = ExperimentConfig.get_from_yaml()
    config.loggers = ["csv"]
    config.save_folder = options.out
    config.max_n_frames = options.frames
    config.on_policy_n_envs_per_worker = options.games
    config.on_policy_collected_frames_per_batch = options.batch
    config.on_policy_minibatch_size = max(options.batch // 4, 1)
    config.on_policy_n_minibatch_iters = 4
    config.lr, config.gamma, config.clip_grad_val = 1e-3, 0.95, 0.5
    config.evaluation_interval = options.batch * max(options.frames // options.batch // 4, 1)
    config.evaluation_episodes = options.tests
    config.render = False

    algorithm = ALGORITHMS[options.algorithm].get_from_yaml()
    algorithm.entropy_coef = 0.01
    # The actor reads six maps of 9 x 9 cells; the critic of mappo reads the state, one row of numbers.
    actor = MlpConfig(num_cells=[128, 64], layer_class=nn.Linear, activation_class=nn.ReLU, num_feature_dims=3)
    critic = MlpConfig(
        num_cells=[128, 64],
        layer_class=nn.Linear,
        activation_class=nn.ReLU,
        num_feature_dims=1 if options.algorithm == "mappo" else 3,
    )
    return Experiment(task, algorithm, actor, seed=options.seed, config=config, critic_model_config=critic)


def main(arguments: list[str] | None = None) -> None:
    """Train, then print the return of the last greedy test."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/benchmarl"), help="folder for curves")
    parser.add_argument("--algorithm", choices=ALGORITHMS, default="ippo")
    parser.add_argument("--uavs", type=int, default=3)
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--episode", type=int, default=100, help="steps of an episode")
    parser.add_argument("--frames", type=int, default=200_000, help="steps of a team, in all")
    parser.add_argument("--games", type=int, default=10, help="played side by side")
    parser.add_argument("--batch", type=int, default=2_000, help="steps between two updates")
    parser.add_argument("--tests", type=int, default=10, help="episodes of a greedy test")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    run = experiment(options)
    run.run()
    print(f"{run.total_frames} steps trained, curves in {run.folder_name}")


if __name__ == "__main__":
    main()
