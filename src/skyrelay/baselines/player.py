"""One interface for whatever moves a team, and the episodes it plays.

A player sees the whole state of one game, so that a rule of its own UAVs, a planner that knows the truth and a network
that only looks at its maps are all played by the same loop. `play` plays the very episodes of
`skyrelay.learning.evaluation.greedy_episodes` for the same key: results can be compared episode by episode.
"""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skyrelay.airspace.flight import ACTIONS, move
from skyrelay.coordination import game
from skyrelay.coordination.reward import Score
from skyrelay.coordination.settings import Domain, Shape
from skyrelay.learning.evaluation import Also, per_episode
from skyrelay.learning.networks import Network
from skyrelay.learning.ppo import EACH, Decider, new_games

Memory = Any
"""What a player keeps between two steps of a game: any pytree of arrays, or None."""


class Player(eqx.Module):
    """Moves the team of one game; pure, so that `jax.vmap` plays many.

    Attributes:
        period: steps between two calls of `plan`; 0 for none.
    """

    period: int = eqx.field(default=0, static=True)

    def begin(self, key: PRNGKeyArray, state: game.State) -> tuple[game.State, Memory]:
        """Before the first step: the state to start from (placement may put its UAVs elsewhere), the first memory."""
        return state, key

    def plan(self, state: game.State, memory: Memory) -> Memory:  # noqa: ARG002 (the default plans nothing)
        """What is too dear for every step: the memory with a new plan in it."""
        return memory

    @abc.abstractmethod
    def act(self, state: game.State, memory: Memory) -> tuple[Int[Array, " uavs"], Memory]:
        """The action of each UAV, and the next memory."""


class Static(Player):
    """Every UAV hovers where it starts: over its vehicles as they were when they were selected."""

    def act(self, state: game.State, memory: Memory) -> tuple[Int[Array, " uavs"], Memory]:
        """Stay."""
        return jnp.zeros(state.shape.uavs, jnp.int32), memory


class Random(Player):
    """Every UAV takes one of the nine actions at random."""

    def act(self, state: game.State, memory: Memory) -> tuple[Int[Array, " uavs"], Memory]:
        """Any action."""
        key, now = jax.random.split(memory)
        return jax.random.randint(now, (state.shape.uavs,), 0, ACTIONS), key


class Learned(Player):
    """A trained network: whoever decides takes the most valued choice."""

    actor: Network = eqx.field(kw_only=True)
    decider: Decider = eqx.field(default=EACH, static=True, kw_only=True)

    def act(self, state: game.State, memory: Memory) -> tuple[Int[Array, " uavs"], Memory]:
        """The greedy actions."""
        alone: game.State = jax.tree.map(lambda leaf: leaf[None], state)
        return self.decider.greedy(self.actor, alone)[0], memory


class Episodes(NamedTuple):
    """Scores of whole episodes, time first.

    Attributes:
        start: scores of the state that each episode starts from, which counts for nothing.
        steps: scores of the states that the team's actions led to.
        also: what else was asked of those states.
    """

    start: Score
    steps: Score
    also: Array | None = None

    @property
    def measures(self) -> Float[Array, "4 episodes"]:
        """Return, coverage, connectivity, connectivity_neighbor: what `skyrelay.learning.evaluation.summary` takes."""
        return per_episode(self.steps)

    def first(self, holds: Bool[Array, "states episodes"]) -> Float[Array, " episodes"]:
        """The first step at which something holds, 0 for the start; NaN where it never does."""
        return jnp.where(holds.any(0), jnp.argmax(holds, 0), jnp.nan)

    def joined(self, name: str) -> Float[Array, "states episodes"]:
        """One measure of the start and of all steps."""
        return jnp.concatenate([getattr(self.start, name)[None], getattr(self.steps, name)])


def play(player: Player, key: PRNGKeyArray, episodes: int, shape: Shape, domain: Domain) -> Episodes:
    """Play whole episodes side by side, compiled.

    Args:
        key: decides the episodes; the player's own randomness is apart from it.
        episodes: how many; each draws its numbers from ``domain``.
    """
    return play_from(player, key, _new_games(key, episodes, shape, domain))


def play_from(
    player: Player,
    key: PRNGKeyArray,
    games: game.State,
    traces: game.Trace | None = None,
    also: Also | None = None,
) -> Episodes:
    """The same from given starts, with replayed vehicles where there are ``traces``; ``also`` of each state led to."""
    return _played(player, jax.random.fold_in(key, 1), games, traces, also)


RUN_ONCE = {"xla_backend_optimization_level": 0}
"""For what is compiled to run once: five times as fast to compile, and slower to run by less than that."""

_new_games = jax.jit(new_games, static_argnums=(1, 2, 3), compiler_options=RUN_ONCE)
"""By itself, so that it is compiled once for all players."""


@eqx.filter_jit
def _played(
    player: Player, key: PRNGKeyArray, games: game.State, traces: game.Trace | None, also: Also | None
) -> Episodes:
    games, memory = jax.vmap(player.begin)(jax.random.split(key, games.time.shape[0]), games)
    start = jax.vmap(game.measure)(games)

    def turn(carry: tuple[game.State, Memory], time: Int[Array, ""]) -> tuple[tuple[game.State, Memory], Any]:
        games, memory = carry
        if player.period:
            # All games share the clock, so that this stays a branch: inside vmap both sides would be computed.
            due = (time > 0) & (time % player.period == 0)
            memory = jax.lax.cond(due, jax.vmap(player.plan), lambda _, kept: kept, games, memory)
        actions, memory = jax.vmap(player.act)(games, memory)
        games, transition = jax.vmap(game.step)(games, actions, traces)
        return (games, memory), (transition.score, None if also is None else jax.vmap(also)(games))

    _, (steps, further) = jax.lax.scan(turn, (games, memory), jnp.arange(games.shape.steps))
    return Episodes(start, steps, further)


def choices(state: game.State) -> Float[Array, "9 uavs 2"]:
    """Where each of the nine actions would take each UAV."""
    uavs = jnp.broadcast_to(state.uavs, (ACTIONS, *state.uavs.shape))
    actions = jnp.broadcast_to(jnp.arange(ACTIONS)[:, None], uavs.shape[:2])
    moved: Float[Array, "9 uavs 2"] = move(uavs, actions, state.parameters.uav_step)
    return moved


def towards(state: game.State, targets: Float[Array, "uavs 2"]) -> Int[Array, " uavs"]:
    """The action that brings each UAV nearest to its target; staying wins a tie."""
    return jnp.argmin(squared(choices(state) - targets), axis=0)


def squared(vectors: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Squared length."""
    return jnp.sum(vectors * vectors, -1)


def owned(state: game.State) -> Bool[Array, "uavs vehicles"]:
    """Which vehicles each UAV serves."""
    return state.served_by == jnp.arange(state.shape.uavs)[:, None]


def team_centre(state: game.State) -> Float[Array, " 2"]:
    """Mean position of the active UAVs."""
    centre: Float[Array, " 2"] = jnp.mean(state.uavs, axis=0, where=state.active[:, None])
    return centre
