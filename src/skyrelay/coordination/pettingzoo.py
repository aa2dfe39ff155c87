"""The game as a PettingZoo ParallelEnv, for libraries that train on that interface."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import pettingzoo
from jaxtyping import Array, Int

from skyrelay.airspace.flight import ACTIONS, STAY
from skyrelay.airspace.maps import normalise, safe_of
from skyrelay.airspace.observation import Observer
from skyrelay.coordination import game
from skyrelay.coordination.reward import Score
from skyrelay.coordination.settings import Domain, Shape, physical
from skyrelay.core.errors import UsageError


def parallel_env(uavs: int = 3, vehicles: int = 20, n: int = 11, steps: int = 100) -> UavCoordination:
    """The preset ``paper`` (docs/reference/game.md) with a fixed team: what most users want."""
    return UavCoordination(Shape(uavs, vehicles, n=n, steps=steps), physical((uavs, uavs), (vehicles, vehicles)))


class UavCoordination(pettingzoo.ParallelEnv[str, npt.NDArray[np.float32], int]):
    """N UAVs keep their own vehicles in range and the team linked.

    Agents are ``uav_0`` ... Observations are maps [maps, n, n], float32, normalised: the
    six, and those of the shape's options; actions 0..8; the reward is Eq. 3
    and the same for all. An episode is truncated after ``shape.steps`` steps and never terminates; in games with
    drop-outs an agent terminates when its UAV leaves.

    A process that has reset or stepped one must not fork: JAX's threads do not survive it, and the child hangs. Start
    workers by ``spawn`` or ``forkserver`` (`multiprocessing.get_context`), each with a game of its own.

    Args:
        shape: compiled sizes.
        domain: games to draw from; its team size is fixed.
        render_mode: ``"rgb_array"``: `render` draws.
    Raises:
        UsageError: the domain's team size varies or is not the shape's.
    """

    metadata: dict[str, Any] = {"name": "skyrelay_coordination_v0", "render_modes": ["rgb_array"]}  # noqa: RUF012, the API's form

    def __init__(self, shape: Shape, domain: Domain, render_mode: str | None = None) -> None:
        if render_mode not in {None, "rgb_array"}:
            raise UsageError("render_mode", render_mode, "None or 'rgb_array'")
        if domain.uavs != (shape.uavs, shape.uavs):
            raise UsageError("domain.uavs", domain.uavs, f"({shape.uavs}, {shape.uavs}), the shape's team size")
        if domain.vehicles[1] > shape.vehicles:
            raise UsageError("domain.vehicles", domain.vehicles, f"at most the shape's {shape.vehicles}")
        self.shape, self.domain = shape, domain
        self.render_mode = render_mode
        self.possible_agents = [f"uav_{number}" for number in range(shape.uavs)]
        self.agents: list[str] = []
        high = Observer(shape.maps, shape.n, shape.zoom).greatest(shape.uavs)
        self._observation_space = gymnasium.spaces.Box(np.zeros_like(high), high, dtype=np.float32)
        self.observation_spaces = {agent: self.observation_space(agent) for agent in self.possible_agents}
        self.action_spaces = {agent: self.action_space(agent) for agent in self.possible_agents}
        self._key: jax.Array | None = None
        self._state: game.State | None = None

    @cache  # noqa: B019, the API wants the same object each time
    def observation_space(self, agent: str) -> gymnasium.spaces.Box:  # noqa: ARG002, the API's
        """The maps of one UAV; each agent has its own space, so that each can be seeded."""
        space = self._observation_space
        return gymnasium.spaces.Box(space.low, space.high, dtype=np.float32)

    @cache  # noqa: B019
    def action_space(self, agent: str) -> gymnasium.spaces.Discrete:  # noqa: ARG002, the API's
        """0 stays; k in 1..8 flies towards 2 pi k / 8."""
        return gymnasium.spaces.Discrete(ACTIONS)

    def reset(
        self,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002, the API's
    ) -> tuple[dict[str, npt.NDArray[np.float32]], dict[str, dict[str, Any]]]:
        """Begin an episode; without a seed, the next one of the sequence that the last seed began."""
        if seed is not None or self._key is None:
            chosen = seed if seed is not None else int(np.random.default_rng().integers(2**31))
            self._key = jax.random.key(chosen)
        self._key, key = jax.random.split(self._key)
        self._state, maps = _reset(key, self.shape, self.domain)
        self.agents = self.possible_agents[:]
        masks = self._masks(maps)
        return self._by_agent(maps), {agent: dict(masks[agent]) for agent in self.agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, npt.NDArray[np.float32]],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """All UAVs move at once.

        Returns: observations, rewards, terminations, truncations and infos (coverage, connectivity,
            connectivity_neighbor; with the outlook, the safe moves as action_mask [9]) by agent.
        Raises:
            UsageError: an agent in play has no action, or one that is not a whole number from 0 to 8.
        """
        if self._state is None or not self.agents:
            raise RuntimeError("call reset() before step(): there is no episode in play")
        row = np.array([_checked(a, actions) if a in self.agents else STAY for a in self.possible_agents], np.int32)
        self._state, told = _step(self._state, jnp.asarray(row))
        # Everything comes over at once: each array by itself waits for the device.
        maps, active, score, truncated = jax.device_get((told[0], self._state.active, *told[1:]))
        over, reward = bool(truncated), float(score.reward)
        measures = {
            "coverage": float(score.coverage),
            "connectivity": float(score.connectivity),
            "connectivity_neighbor": float(score.connectivity_neighbor),
        }
        observations = {agent: seen for agent, seen in self._by_agent(maps).items() if agent in self.agents}
        rewards = dict.fromkeys(self.agents, reward)
        terminations = {a: not active[row] for row, a in enumerate(self.possible_agents) if a in self.agents}
        truncations = dict.fromkeys(self.agents, over)
        masks = self._masks(maps)
        infos: dict[str, dict[str, Any]] = {agent: measures | masks[agent] for agent in self.agents}
        self.agents = [] if over else [agent for agent in self.agents if not terminations[agent]]
        return observations, rewards, terminations, truncations, infos

    def state(self) -> npt.NDArray[np.float32]:
        """The whole game for a centralised critic.

        Returns: [3 N + 4 V] x and y of each UAV and whether it is active; x, y, own UAV's row and presence of each
            vehicle. Positions are in zone sides.
        """
        if self._state is None:
            raise RuntimeError("call reset() before state(): there is no episode in play")
        now = self._state
        uavs = np.column_stack([np.asarray(now.uavs), np.asarray(now.active)])
        vehicles = np.column_stack([np.asarray(x) for x in (now.traffic.position, now.owner, now.present)])
        return np.concatenate([uavs.reshape(-1), vehicles.reshape(-1)]).astype(np.float32)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """The present state as a picture [480, 480, 3], where `render_mode` is ``"rgb_array"``."""
        if self.render_mode is None:
            return None
        if self._state is None:
            raise RuntimeError("call reset() before render(): there is no episode in play")
        from skyrelay.coordination.picture import picture

        return picture(self._state)

    def close(self) -> None:
        """Nothing is held open."""

    def _masks(self, maps: jax.Array | npt.NDArray[np.float32]) -> dict[str, dict[str, Any]]:
        """Of each agent, the moves that the outlook calls safe, under the name that libraries look for."""
        if not self.shape.outlook:
            return {agent: {} for agent in self.possible_agents}
        safe = np.asarray(safe_of(maps, self.shape.maps)).astype(np.int8)
        return {agent: {"action_mask": safe[row]} for row, agent in enumerate(self.possible_agents)}

    def _by_agent(self, maps: jax.Array | npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.float32]]:
        rows = np.asarray(maps)
        return {agent: rows[number] for number, agent in enumerate(self.possible_agents)}


def _checked(agent: str, actions: Mapping[str, Any]) -> int:
    """The compiled game checks nothing: an action that is none would take the UAV out of the zone, for good."""
    action = actions.get(agent)
    whole = isinstance(action, int | np.integer) or (isinstance(action, np.ndarray) and action.dtype.kind in "iu")
    if not whole or isinstance(action, bool) or np.size(action) != 1 or not 0 <= int(action) < ACTIONS:  # type: ignore[arg-type]
        raise UsageError(f"step: action of {agent}", action, f"a whole number from 0 to {ACTIONS - 1}")
    return int(action)  # type: ignore[arg-type]


@partial(jax.jit, static_argnums=(1, 2))
def _reset(key: jax.Array, shape: Shape, domain: Domain) -> tuple[game.State, jax.Array]:
    k_draw, k_reset = jax.random.split(key)
    state = game.reset(k_reset, shape, domain.draw(k_draw))
    return state, normalise(game.observe(state), shape.zoom, shape.maps)


@jax.jit
def _step(state: game.State, actions: Int[Array, " uavs"]) -> tuple[game.State, tuple[jax.Array, Score, jax.Array]]:
    state, transition = game.step(state, actions)
    maps = normalise(transition.observation, state.shape.zoom, state.shape.maps)
    return state, (maps, transition.score, transition.truncated)
