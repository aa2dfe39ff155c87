"""A planner that knows the true state: an upper reference for what decentralised policies could reach.

At every step it looks ``horizon`` steps ahead. It samples futures of the vehicles from the game's own model, lays a
straight flight for each UAV to a target, and looks for the targets with the most expected reward (Eq. 3) along the
way: first among common patterns (all keep their targets; all draw together by some share), then UAV after UAV among
sampled points (coordinate ascent). The first move is settled last, action by action, so that a link at the edge of
its range is not lost to the rounding of a heading.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from skyrelay.airspace.flight import STAY, move
from skyrelay.baselines.centroid import connected
from skyrelay.baselines.player import Memory, Player, choices, owned, squared, team_centre, towards
from skyrelay.coordination import game

SHRINK = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of the way from the middle of its own vehicles to the middle of the team, tried for all UAVs at once."""
SPREAD = (0.02, 0.1, 0.3)
"""Standard deviations of the points sampled about a target [zone sides]."""


class Planner(Player):
    """Receding-horizon planning on the true state.

    Attributes:
        horizon: steps looked ahead.
        futures: samples of the vehicles' motion that the expected coverage is taken over.
        samples: points tried for each UAV in a sweep.
        sweeps: over the team.
        foresight: know how the vehicles will drive, which no real team can: what perfect prediction would add.
    """

    horizon: int = eqx.field(default=12, static=True)
    futures: int = eqx.field(default=4, static=True)
    samples: int = eqx.field(default=18, static=True)
    sweeps: int = eqx.field(default=1, static=True)
    foresight: bool = eqx.field(default=False, static=True)

    def begin(self, key: PRNGKeyArray, state: game.State) -> tuple[game.State, Memory]:
        """The first targets are where the UAVs are."""
        return state, (key, state.uavs)

    def act(self, state: game.State, memory: Memory) -> tuple[Int[Array, " uavs"], Memory]:
        """Improve the targets, then choose the first move."""
        key, targets = memory
        key, k_future, k_sample = jax.random.split(key, 3)
        keys = state.key[None] if self.foresight else jax.random.split(k_future, self.futures)
        vehicles = jax.vmap(lambda k: _drive(dataclasses.replace(state, key=k), self.horizon))(keys)

        def worth(first: Float[Array, "uavs 2"], targets: Float[Array, "uavs 2"]) -> Float[Array, ""]:
            return _reward(state, _flight(state, first, targets, self.horizon), vehicles)

        def of_targets(targets: Float[Array, "uavs 2"]) -> Float[Array, ""]:
            return worth(_after(state, towards(state, targets)), targets)

        targets = _best(of_targets, jnp.concatenate([targets[None], _patterns(state)]))
        scale = jnp.resize(jnp.asarray(SPREAD), (self.samples,))[:, None]
        spread = scale * jax.random.normal(k_sample, (self.sweeps * state.shape.uavs, self.samples, 2))

        def improve(turn: Int[Array, ""], targets: Float[Array, "uavs 2"]) -> Float[Array, "uavs 2"]:
            uav = turn % state.shape.uavs
            sampled = jnp.clip(targets[uav] + spread[turn], 0.0, 1.0)
            points = jnp.concatenate([targets[uav][None], state.uavs[uav][None], sampled])
            return _best(of_targets, _with_row(targets, uav, points))

        targets = jax.lax.fori_loop(0, self.sweeps * state.shape.uavs, improve, targets)
        options = choices(state)

        def settle(uav: Int[Array, ""], first: Float[Array, "uavs 2"]) -> Float[Array, "uavs 2"]:
            return _best(lambda first: worth(first, targets), _with_row(first, uav, options[:, uav]))

        first = jax.lax.fori_loop(0, state.shape.uavs, settle, _after(state, towards(state, targets)))
        return towards(state, first), (key, targets)


def _drive(state: game.State, horizon: int) -> Float[Array, "horizon vehicles 2"]:
    """Where the vehicles would be in each of the next steps, by the game's own model."""
    stay = jnp.full(state.shape.uavs, STAY)

    def step(state: game.State, _: None) -> tuple[game.State, Array]:
        state, _transition = game.step(state, stay)
        return state, state.traffic.position

    return jax.lax.scan(step, state, None, horizon)[1]


def _flight(
    state: game.State, first: Float[Array, "uavs 2"], targets: Float[Array, "uavs 2"], horizon: int
) -> Float[Array, "horizon uavs 2"]:
    """Positions at each step: the first one given, then straight to the targets."""
    way = targets - first
    distance = jnp.sqrt(squared(way))
    flown = jnp.arange(horizon)[:, None] * state.parameters.uav_step
    share = jnp.minimum(flown / jnp.maximum(distance, 1e-6), 1.0)
    return first + share[..., None] * way


def _reward(
    state: game.State, uavs: Float[Array, "horizon uavs 2"], vehicles: Float[Array, "futures horizon vehicles 2"]
) -> Float[Array, ""]:
    """Sum over the horizon of coverage (mean over futures) + connectivity."""
    near = squared(uavs[:, state.owner] - vehicles) <= state.parameters.reach**2
    covered = jnp.mean(near, axis=(0, 1), dtype=jnp.float32) * uavs.shape[0]
    share = jnp.sum(covered * state.present) / jnp.maximum(jnp.sum(state.present), 1)
    return share + jnp.sum(connected(state, uavs))


def _patterns(state: game.State) -> Float[Array, "patterns uavs 2"]:
    """Targets of the whole team: from the middle of one's own vehicles to all at one point."""
    own, place = owned(state)[..., None], state.traffic.position[None]
    low, high = jnp.min(place, 1, where=own, initial=1.0), jnp.max(place, 1, where=own, initial=0.0)
    middle = jnp.where(own.any(1), 0.5 * (low + high), state.uavs)
    return jnp.stack([middle + share * (team_centre(state) - middle) for share in SHRINK])


def _with_row(
    team: Float[Array, "uavs 2"], uav: Int[Array, ""], points: Float[Array, "points 2"]
) -> Float[Array, "points uavs 2"]:
    """The team once for each point, with one UAV there."""
    return jnp.broadcast_to(team, (len(points), *team.shape)).at[:, uav].set(points)


def _after(state: game.State, actions: Int[Array, " uavs"]) -> Float[Array, "uavs 2"]:
    """Where the actions lead."""
    uavs: Float[Array, "uavs 2"] = move(state.uavs, actions, state.parameters.uav_step)
    return uavs


def _best(worth: Callable[[Array], Array], candidates: Float[Array, "candidates uavs 2"]) -> Float[Array, "uavs 2"]:
    """The candidate worth most; the first of equals."""
    return candidates[jnp.argmax(jax.vmap(worth)(candidates))]
