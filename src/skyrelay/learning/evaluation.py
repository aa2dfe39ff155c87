"""How good a policy is: whole unseen episodes, with 95 % intervals over them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Float, Int, PRNGKeyArray

from skyrelay.airspace.maps import OUTLOOK_MAPS, RANGE_MAPS, chosen, normalise
from skyrelay.coordination import game
from skyrelay.coordination.reward import Score
from skyrelay.coordination.settings import Domain, Shape
from skyrelay.core.errors import UsageError
from skyrelay.core.statistics import interval
from skyrelay.learning.networks import Network
from skyrelay.learning.ppo import EACH, Decider, new_games
from skyrelay.policy import Policy

UNSEEN = 2**31
"""Folded into a seed's key for evaluation: no training plays these games."""
MEASURES = ("return", "coverage", "connectivity", "connectivity_neighbor")

Also = Callable[[game.State], Array]
"""What else is measured of a game's state, beside its score."""


@eqx.filter_jit
def greedy_episodes(
    actor: Network, key: PRNGKeyArray, episodes: int, shape: Shape, domain: Domain, decider: Decider = EACH
) -> Float[Array, "4 episodes"]:
    """Play whole episodes, always taking the most valued action, all side by side in one compiled program.

    Returns: of each episode the return, and the means of coverage, connectivity and connectivity_neighbor.
    """

    def play(games: game.State, _: None) -> tuple[game.State, Score]:
        games, transition = jax.vmap(game.step)(games, decider.greedy(actor, games))
        return games, transition.score

    _, scores = jax.lax.scan(play, new_games(key, episodes, shape, domain), None, shape.steps)
    return per_episode(scores)


def unseen_key(seed: int) -> PRNGKeyArray:
    """Of the games that a seed evaluates on; no training plays them."""
    return jax.random.fold_in(jax.random.key(seed), UNSEEN)


def starts(key: PRNGKeyArray, episodes: int, shape: Shape, domain: Domain) -> game.State:
    """Where the episodes of a key begin: the very ones of `greedy_episodes`."""
    games: game.State = jax.jit(new_games, static_argnums=(1, 2, 3))(key, episodes, shape, domain)
    return games


def episodes_of(
    decide: Callable[[npt.NDArray[np.float32]], npt.NDArray[np.int64]],
    games: game.State,
    traces: game.Trace | None = None,
) -> Float[Array, "4 episodes"]:
    """The same for any policy: a function from maps [batch, maps, n, n] to actions [batch], called once a step.

    Args:
        games: the starts of the episodes, a leading axis of games.
        traces: their vehicles where they are replayed (`skyrelay.coordination.replay`).
    """
    return per_episode(_measured(decide, games, traces, None)[0])


def _measured(
    decide: Callable[[npt.NDArray[np.float32]], npt.NDArray[np.int64]],
    games: game.State,
    traces: game.Trace | None,
    also: Also | None,
) -> tuple[Score, Array | None]:
    """Scores [steps, episodes] of the states that the policy's actions led to, and what else is asked of them."""
    shape = games.shape

    @jax.jit
    def look(games: game.State) -> Float[Array, "rows maps n n"]:
        maps = normalise(jax.vmap(game.observe)(games), shape.zoom, shape.maps)
        return jnp.reshape(maps, (-1, *maps.shape[2:]))

    @jax.jit
    def play(games: game.State, actions: Int[Array, " rows"]) -> tuple[game.State, tuple[Score, Array | None]]:
        games, transition = jax.vmap(game.step)(games, actions.reshape(-1, shape.uavs), traces)
        return games, (transition.score, None if also is None else jax.vmap(also)(games))

    rows = []
    for _ in range(shape.steps):
        games, row = play(games, jnp.asarray(decide(np.asarray(look(games)))))
        rows.append(row)
    stacked: tuple[Score, Array | None] = jax.tree.map(lambda *each: jnp.stack(each), *rows)
    return stacked


def summary(results: Float[Array, "4 episodes"]) -> dict[str, Any]:
    """Means by name, each with its 95 % interval (Student's t over episodes); of a single episode it is empty.

    Returns: ``{"return": {"mean": ..., "low": ..., "high": ...}, "coverage": ..., ...}``.
    """
    rows = np.asarray(results, np.float64)
    return {name: interval(values).closed() for name, values in zip(MEASURES, rows, strict=True)}


def named(values: Iterable[float] | Float[np.ndarray, 4]) -> dict[str, float]:
    """One episode's measures by their names."""
    return {name: float(value) for name, value in zip(MEASURES, values, strict=True)}


def per_episode(scores: Score) -> Float[Array, "4 episodes"]:
    """From scores [steps, episodes] to one row a measure: return, coverage, connectivity, connectivity_neighbor."""
    means = (scores.coverage, scores.connectivity, scores.connectivity_neighbor)
    return jnp.stack([scores.reward.sum(0), *(measure.mean(0) for measure in means)])


def evaluate_policy(policy: Policy, games: game.State, traces: game.Trace | None = None) -> dict[str, Any]:
    """`summary` of an ONNX policy over whole episodes from these starts (of `starts` or `replayed_games`)."""
    return summary(policy_episodes(policy, games, traces))


def policy_episodes(policy: Policy, games: game.State, traces: game.Trace | None = None) -> Float[Array, "4 episodes"]:
    """The same, episode by episode, so that two policies can be compared on the same games."""
    return per_episode(policy_scores(policy, games, traces))


def flight(policy: Policy, games: game.State, traces: game.Trace | None = None) -> Iterator[game.State]:
    """The states of the first game as a policy flies it, the start first."""
    wants = set(policy.card.maps)
    shape = replace(games.shape, tells_range=set(RANGE_MAPS) <= wants, outlook=set(OUTLOOK_MAPS) <= wants)
    state: game.State = replace(jax.tree.map(lambda leaf: leaf[0], games), shape=shape)
    trace = None if traces is None else game.Trace(*(leaf[0] for leaf in traces))

    @jax.jit
    def look(state: game.State) -> Float[Array, "uavs maps n n"]:
        maps: Float[Array, "uavs maps n n"] = normalise(game.observe(state), shape.zoom, shape.maps)
        return maps

    @jax.jit
    def step(state: game.State, actions: Int[Array, " uavs"]) -> game.State:
        return game.step(state, actions, trace)[0]

    yield state
    for _ in range(shape.steps):
        actions = policy.decide(chosen(np.asarray(look(state)), shape.maps, policy.card.maps))
        state = step(state, jnp.asarray(actions))
        yield state


def policy_scores(policy: Policy, games: game.State, traces: game.Trace | None = None) -> Score:
    """The same, step by step: scores [steps, episodes]."""
    return flown([policy], games, traces)[0]


def flown(
    policies: Sequence[Policy], games: game.State, traces: game.Trace | None = None, also: Also | None = None
) -> tuple[Score, Array | None]:
    """Scores [steps, episodes] of whole episodes, and ``also`` [steps, episodes, ...] of the same states.

    A policy does not see maps that it was not trained on; maps that it wants and the games lack are empty, but for the
    range and the outlook, which a UAV always knows.

    Args:
        policies: each flies an equal share of the games, in their order; all look at the same maps.
    Raises:
        UsageError: they do not, or the games cannot be shared out.
    """
    policy, count = policies[0], len(policies)
    for other in policies[1:]:
        if (other.card.maps, other.n, other.zoom) != (policy.card.maps, policy.n, policy.zoom):
            raise UsageError(f"policy {other.card.name}", "other maps", f"those of {policy.card.name}")
    if games.time.shape[0] % count:
        raise UsageError("policies", count, f"a number that {games.time.shape[0]} games can be shared out to")
    wants = set(policy.card.maps)
    shape = replace(games.shape, tells_range=set(RANGE_MAPS) <= wants, outlook=set(OUTLOOK_MAPS) <= wants)
    games = replace(games, shape=shape)

    def decide(maps: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        seen = np.split(chosen(maps, shape.maps, policy.card.maps), count)
        return np.concatenate([one.decide(part) for one, part in zip(policies, seen, strict=True)])

    return _measured(decide, games, traces, also)
