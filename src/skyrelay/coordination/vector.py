"""Many games side by side as one Gymnasium vector environment, for libraries that train one policy for all UAVs."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import jax
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Int

from skyrelay.airspace.flight import ACTIONS
from skyrelay.airspace.maps import normalise
from skyrelay.airspace.observation import Observer
from skyrelay.coordination import game
from skyrelay.coordination.reward import Score
from skyrelay.coordination.settings import Domain, Shape
from skyrelay.core.errors import UsageError

Maps = npt.NDArray[np.float32]


class UavVector(gymnasium.vector.VectorEnv):
    """Each UAV of each game is an environment of its own: the rows are game by game, UAV by UAV.

    Observations are the UAV's maps [maps, n, n], actions 0 to 8, and the reward is its team's (Eq. 3). All games have
    one clock: at its end every row is truncated, the next episodes have begun in the observations returned, and what
    the last ones ended with is in ``infos["final_obs"]`` (Gymnasium's ``SAME_STEP``). Nothing terminates.

    Args:
        shape: compiled sizes.
        domain: games to draw from; its team size is fixed.
        games: side by side.
    Raises:
        UsageError: the team's size varies or UAVs drop out, or there is no game.
    """

    def __init__(self, shape: Shape, domain: Domain, games: int) -> None:
        if domain.uavs != (shape.uavs, shape.uavs):
            raise UsageError("domain.uavs", domain.uavs, f"({shape.uavs}, {shape.uavs})")
        if shape.drop_outs:
            raise UsageError("games", "some in which UAVs drop out", "games that keep all their UAVs, as paper's do")
        if not 1 <= games <= 65_536:
            raise UsageError("games", games, "1 to 65,536")
        self.shape, self.domain, self.games = shape, domain, games
        self.num_envs = games * shape.uavs
        self.metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}
        high = Observer(shape.maps, shape.n, shape.zoom).greatest(shape.uavs)
        self.single_observation_space = gymnasium.spaces.Box(np.zeros_like(high), high, dtype=np.float32)
        self.single_action_space = gymnasium.spaces.Discrete(ACTIONS)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, self.num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, self.num_envs)
        self._key: jax.Array | None = None
        self._state: game.State | None = None

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002, the API's
    ) -> tuple[Maps, dict[str, Any]]:
        """Begin new episodes; without a seed, the next ones of the sequence that the last seed began.

        Raises:
            UsageError: seeds for single rows: the games are drawn from one.
        """
        if isinstance(seed, list):
            raise UsageError("reset: seed", seed, "one number for all rows")
        if seed is not None or self._key is None:
            self._key = jax.random.key(seed if seed is not None else int(np.random.default_rng().integers(2**31)))
        return self._begin(), {}

    def step(
        self, actions: npt.NDArray[np.integer[Any]]
    ) -> tuple[Maps, npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """All UAVs of all games move at once.

        Returns: observations, rewards, terminations, truncations [rows], and infos (coverage, connectivity,
            connectivity_neighbor [rows]).
        Raises:
            UsageError: not one whole number from 0 to 8 for each row.
        """
        if self._state is None:
            raise RuntimeError("call reset() before step(): there is no episode in play")
        chosen = np.asarray(actions)
        whole = chosen.shape == (self.num_envs,) and chosen.dtype.kind in "iu"
        if not whole or not ((chosen >= 0) & (chosen < ACTIONS)).all():
            raise UsageError("step: actions", f"{chosen.dtype} of shape {chosen.shape}", f"[{self.num_envs}] of 0 to 8")
        self._state, told = _step(self._state, chosen.astype(np.int32).reshape(self.games, -1))
        maps, score, truncated = jax.device_get(told)
        infos = {
            name: np.repeat(getattr(score, name), self.shape.uavs)
            for name in ("coverage", "connectivity", "connectivity_neighbor")
        }
        over = np.repeat(truncated, self.shape.uavs)
        rewards = np.repeat(score.reward, self.shape.uavs).astype(np.float64)
        seen: Maps = maps.reshape(self.num_envs, *maps.shape[2:])
        if over.any():
            infos["final_obs"] = seen
            seen = self._begin()
        return seen, rewards, np.zeros(self.num_envs, bool), over, infos

    def close_extras(self, **_: Any) -> None:
        """Nothing is held open."""

    def _begin(self) -> Maps:
        assert self._key is not None  # noqa: S101 (`reset` has made it)
        self._key, key = jax.random.split(self._key)
        self._state, maps = _reset(jax.random.split(key, self.games), self.shape, self.domain)
        rows: Maps = np.asarray(maps).reshape(self.num_envs, *maps.shape[2:])
        return rows


@partial(jax.jit, static_argnums=(1, 2))
def _reset(keys: jax.Array, shape: Shape, domain: Domain) -> tuple[game.State, jax.Array]:
    def one(key: jax.Array) -> game.State:
        k_draw, k_reset = jax.random.split(key)
        return game.reset(k_reset, shape, domain.draw(k_draw))

    states = jax.vmap(one)(keys)
    return states, normalise(jax.vmap(game.observe)(states), shape.zoom, shape.maps)


@jax.jit
def _step(
    states: game.State, actions: Int[Array, "games uavs"]
) -> tuple[game.State, tuple[jax.Array, Score, jax.Array]]:
    states, told = jax.vmap(game.step)(states, actions)
    return states, (normalise(told.observation, states.shape.zoom, states.shape.maps), told.score, told.truncated)
