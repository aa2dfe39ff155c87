"""Many games as a vectorised environment of Stable-Baselines3; needs ``pip install stable-baselines3``.

    envs = UavSb3(skyrelay.make_vec("paper", games=32, uavs=3, vehicles=20))
    PPO("MlpPolicy", envs).learn(100_000)

One policy flies all UAVs: each UAV of each game is an environment of its own, with the reward of its team.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env import VecEnv

from skyrelay.coordination.vector import UavVector

MEASURES = ("coverage", "connectivity", "connectivity_neighbor")


class UavSb3(VecEnv):  # type: ignore[misc] # the library is not there where types are checked
    """The rows of a `UavVector`.

    At the end of an episode each row's ``infos`` have the last observation (``terminal_observation``), and say that
    time was up (``TimeLimit.truncated``): the games have no end of their own.

    Args:
        envs: the games.
    """

    def __init__(self, envs: UavVector) -> None:
        self.envs = envs
        self._actions: npt.NDArray[np.integer[Any]] | None = None
        self.render_mode: str | None = None
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> npt.NDArray[np.float32]:
        """[rows, maps, n, n] the first observations; `seed` begins a sequence of games, each reset takes the next."""
        observations, _ = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        return observations.copy()  # JAX's memory is not to be written to, and PyTorch shares what it is given

    def step_async(self, actions: npt.NDArray[np.integer[Any]]) -> None:
        """Take the actions of the next step, [rows] of 0 to 8."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Play it: observations, rewards, whether the episode is over [rows], infos by row.

        Raises:
            UsageError: the actions are none of the game's.
        """
        if self._actions is None:
            raise RuntimeError("call step_async() before step_wait(): there are no actions")
        observations, rewards, _, over, told = self.envs.step(self._actions)
        self._actions = None
        infos: list[dict[str, Any]] = [
            {name: float(told[name][row]) for name in MEASURES} for row in range(self.num_envs)
        ]
        for row in np.flatnonzero(over).tolist():
            infos[row] |= {"terminal_observation": told["final_obs"][row], "TimeLimit.truncated": True}
        return observations.copy(), rewards.astype(np.float32), over, infos

    def close(self) -> None:
        """Nothing is held open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the games, for each row asked for; all rows have the same."""
        return [getattr(self.envs, attr_name)] * len(self._rows(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Rows share one compiled program, so that none can differ."""
        raise NotImplementedError(f"{attr_name}={value} for rows {indices}: all rows are the same games")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Rows have no methods of their own."""
        raise NotImplementedError(f"{method_name}{args}{kwargs} of rows {indices}: a row is a UAV, not an environment")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No row is wrapped in anything."""
        del wrapper_class
        return [False] * len(self._rows(indices))

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """None: draw a game by ``skyrelay.make(..., render_mode="rgb_array")``."""
        return [None] * self.num_envs

    def _rows(self, indices: Any) -> Sequence[int]:
        rows: Sequence[int] = list(self._get_indices(indices))
        return rows
