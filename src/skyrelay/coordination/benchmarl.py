"""The game as a task of BenchMARL, which trains on it with TorchRL; needs ``pip install benchmarl``.

    task = UavCoordinationTask.PAPER.get_task({"uavs": 3, "vehicles": 20})
    Experiment(task, IppoConfig.get_from_yaml(), model, seed=0, config=config).run()

The UAVs are one group, ``uav``; its observation is [N, 6, n, n], and ``state`` is the whole game for a central critic.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
from benchmarl.environments import Task, TaskClass
from torchrl.data import Composite
from torchrl.envs import EnvBase, PettingZooWrapper

from skyrelay.coordination.pettingzoo import parallel_env

GROUP = "uav"


class UavCoordinationClass(TaskClass):  # type: ignore[misc] # the library has no types
    """A task whose configuration is what `skyrelay.coordination.pettingzoo.parallel_env` takes.

    Args:
        name: of the task.
        config: any of uavs, vehicles, n and steps.
    """

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Makes one game at each call, every one with games of its own: the library gives all the same seed."""
        del num_envs, continuous_actions
        numbers = count()

        def make() -> EnvBase:
            own = None
            if seed is not None:
                process = multiprocessing.current_process().name.encode()
                own = int(np.random.SeedSequence([seed, next(numbers), *process]).generate_state(1)[0])
            return PettingZooWrapper(parallel_env(**self.config), return_state=True, seed=own, device=device)

        return make

    def supports_continuous_actions(self) -> bool:
        """Never."""
        return False

    def supports_discrete_actions(self) -> bool:
        """Nine."""
        return True

    def has_render(self, env: EnvBase) -> bool:  # noqa: ARG002, the library's
        """`skyrelay run` shows games."""
        return False

    def max_steps(self, env: EnvBase) -> int:  # noqa: ARG002
        """Of an episode."""
        return parallel_env(**self.config).shape.steps

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """All UAVs, in one group."""
        groups: dict[str, list[str]] = env.group_map
        return groups

    def observation_spec(self, env: EnvBase) -> Composite:
        """The maps of each UAV."""
        return self._of_group(env, "observation")

    def action_spec(self, env: EnvBase) -> Composite:
        """One of nine for each UAV."""
        return env.full_action_spec

    def state_spec(self, env: EnvBase) -> Composite:
        """Of every UAV and vehicle, see `UavCoordination.state`."""
        return Composite({"state": env.observation_spec["state"].clone()})

    def info_spec(self, env: EnvBase) -> None:  # noqa: ARG002
        """Nothing that is there from the reset on."""
        return

    def action_mask_spec(self, env: EnvBase) -> None:  # noqa: ARG002
        """Every action is allowed at any time."""
        return

    @staticmethod
    def env_name() -> str:
        """The library's folder of a task's configuration files."""
        return "skyrelay"

    def _of_group(self, env: EnvBase, key: str) -> Composite:
        group = env.observation_spec[GROUP]
        return Composite({GROUP: Composite({key: group[key].clone()}, shape=group.shape)})


class UavCoordinationTask(Task):  # type: ignore[misc]
    """The library's list of tasks of one kind."""

    PAPER = None
    """The preset ``paper`` (docs/reference/game.md)."""

    @staticmethod
    def associated_class() -> type[UavCoordinationClass]:
        """What makes it."""
        return UavCoordinationClass
