"""Centralised PPO: one agent sees the maps of all UAVs and chooses one of 9^N joint actions.

The paper's comparison (Fig. "Comparison between the proposed MDRL and the benchmark"), with the networks, the loss and
the games of `skyrelay.learning.ppo`. Two things differ: the first layer takes the six maps of every UAV, and the last
one has an output for each combination of actions.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt8

from skyrelay.airspace.flight import ACTIONS
from skyrelay.airspace.maps import normalise
from skyrelay.baselines.player import Memory, Player
from skyrelay.coordination import game
from skyrelay.coordination.reward import Score
from skyrelay.coordination.settings import Domain, Shape
from skyrelay.core.errors import UsageError
from skyrelay.learning import ppo
from skyrelay.learning.gae import advantages
from skyrelay.learning.networks import KERNEL, Architecture, Linear, Network
from skyrelay.learning.ppo import Experience, Hyperparameters, Learner

LARGEST_TEAM = 5
"""9^6 outputs are half a million; the paper stops at 5 UAVs, too."""


class JointNetwork(Network):
    """A `Network` over the maps of a whole team."""

    def __init__(self, key: PRNGKeyArray, architecture: Architecture, uavs: int, outputs: int, gain: float) -> None:
        k_first, key = jax.random.split(key)
        super().__init__(key, architecture, outputs, gain)
        # The first layer sees the maps of all UAVs instead of one's six.
        layers = self.convolutions or self.layers
        inputs = uavs * (len(architecture.maps) * KERNEL**2 if self.convolutions else architecture.features)
        layers[0] = Linear.new(k_first, inputs, layers[0].bias.shape[0], 2.0**0.5)

    def __call__(self, maps: Float[Array, "batch uavs 6 n n"]) -> Float[Array, "batch outputs"]:
        """Logits of the combinations, or a value, for each team of the batch."""
        batch, uavs, channels, n, _ = maps.shape
        if self.convolutions:
            return super().__call__(maps.reshape(batch, uavs * channels, n, n))
        return self.conclude(self.look(maps.reshape(batch * uavs, channels, n, n)).reshape(batch, -1))


class Centralized(Player):
    """A trained joint network: the whole team takes the most valued combination of actions."""

    actor: JointNetwork = eqx.field(kw_only=True)

    def act(self, state: game.State, memory: Memory) -> tuple[Int[Array, " uavs"], Memory]:
        """The greedy combination."""
        maps = normalise(game.observe(state), state.shape.zoom, state.shape.maps)
        return separate(jnp.argmax(self.actor(maps[None]), -1)[0], state.shape.uavs), memory


def joint_actor(key: PRNGKeyArray, architecture: Architecture, uavs: int) -> JointNetwork:
    """The policy network of a team: logits of the 9^N combinations."""
    return JointNetwork(key, architecture, uavs, ACTIONS**uavs, gain=0.01)


def joint_critic(key: PRNGKeyArray, architecture: Architecture, uavs: int) -> JointNetwork:
    """The value network of a team."""
    return JointNetwork(key, architecture, uavs, 1, gain=1.0)


def separate(joint: Int[Array, "*batch"], uavs: int) -> Int[Array, "*batch uavs"]:
    """Each UAV's action from the number of a combination: its digits to the base 9, the first UAV's last."""
    return joint[..., None] // ACTIONS ** jnp.arange(uavs) % ACTIONS


def join(actions: Int[Array, "*batch uavs"]) -> Int[Array, "*batch"]:
    """The number of a combination from each UAV's action."""
    return jnp.sum(actions * ACTIONS ** jnp.arange(actions.shape[-1]), -1)


def turned(batch: Experience, side: Int[Array, ""]) -> Experience:
    """As `ppo.turned`: all maps and actions of a team in the same turned or mirrored zone."""
    apart = ppo.turned(batch._replace(action=separate(batch.action, batch.maps.shape[-4])), side)
    return apart._replace(action=join(apart.action))


def begin(key: PRNGKeyArray, config: Hyperparameters, shape: Shape, domain: Domain, total_updates: int) -> Learner:
    """As `ppo.begin`, with the networks of a team.

    Raises:
        UsageError: the team's size varies, or is too large for 9^N outputs.
    """
    uavs = shape.uavs
    if domain.uavs != (uavs, uavs) or uavs > LARGEST_TEAM:
        raise UsageError("centralised training: uavs", domain.uavs, f"one team size of at most {LARGEST_TEAM}")
    k_actor, k_critic, key = jax.random.split(key, 3)
    learner = ppo.begin(key, config, shape, domain, total_updates)
    networks = joint_actor(k_actor, config.actor, uavs), joint_critic(k_critic, config.critic, uavs)
    state = ppo.optimizer(config, total_updates).init(eqx.filter(networks, eqx.is_array))
    return Learner(*networks, state, learner.games, learner.key, learner.updates)


def collect(
    learner: Learner, config: Hyperparameters, domain: Domain, shaping: float | Array = 0.0
) -> tuple[Learner, Experience, Score]:
    """As `ppo.collect`; the experience is [horizon, games]: a decision is the whole team's, and so is its reward.

    There is no credit of a single UAV; the shaping is the mean of the UAVs'.
    """
    shape = learner.games.shape
    k_reset, k_play, key = jax.random.split(learner.key, 3)
    fresh = ppo.new_games(k_reset, config.games, shape, domain)

    def look(network: Network, maps: UInt8[Array, "games uavs 6 n n"]) -> Array:
        return network(normalise(maps, shape.zoom, shape.maps))

    def play(
        carry: tuple[game.State, game.State], key: PRNGKeyArray
    ) -> tuple[tuple[game.State, game.State], tuple[Any, ...]]:
        games, last = carry
        maps = jax.vmap(game.observe)(games)
        log_probabilities = jax.nn.log_softmax(look(learner.actor, maps))
        joint = jax.random.categorical(key, log_probabilities)
        log_probability = jnp.take_along_axis(log_probabilities, joint[:, None], -1)[:, 0]
        value = look(learner.critic, maps)[:, 0]
        moved, transition = jax.vmap(game.step)(games, separate(joint, shape.uavs))
        reward, over = transition.score.reward, transition.truncated
        if config.shaping:
            change = config.gamma * jax.vmap(game.potential)(moved) - jax.vmap(game.potential)(games)
            reward = reward + shaping * change.mean(-1)
        row = (maps, joint, log_probability, value, reward, transition.score, over)
        return (_where(over, fresh, moved), _where(over, moved, last)), row

    (games, last), rows = jax.lax.scan(play, (learner.games, learner.games), jax.random.split(k_play, config.horizon))
    maps, joint, log_probability, value, reward, score, over = rows
    value_now, value_last = (look(learner.critic, jax.vmap(game.observe)(state))[:, 0] for state in (games, last))
    next_value = jnp.where(over, value_last, jnp.concatenate([value[1:], value_now[None]]))
    advantage = advantages(reward, value, next_value, over, config.gamma, config.decay)
    experience = Experience(maps, joint, log_probability, value, advantage, jnp.ones_like(over))
    return dataclasses.replace(learner, games=games, key=key), experience, score


def update(
    learner: Learner, config: Hyperparameters, domain: Domain, total_updates: int
) -> tuple[Learner, dict[str, Float[Array, ""]]]:
    """As `ppo.update`, with the same loss and optimizer."""
    shaping = jnp.clip(1.0 - learner.updates / max(config.shaping * total_updates, 1.0), 0.0, 1.0)
    learner, experience, score = collect(learner, config, domain, shaping)
    adam = ppo.optimizer(config, total_updates)
    rows: Experience = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), experience)
    count = rows.action.shape[0]
    size = count // config.minibatches
    arrays, static = eqx.partition((learner.actor, learner.critic), eqx.is_array)
    loss = partial(ppo.loss, config=config, zoom=learner.games.shape.zoom)

    def optimise(carry: tuple[Any, Any], piece: tuple[Array, Array]) -> tuple[tuple[Any, Any], dict[str, Array]]:
        arrays, state = carry
        chosen, side = piece
        batch = jax.tree.map(lambda x: x[chosen], rows)
        if config.symmetries:
            batch = turned(batch, side)
        gradient, parts = eqx.filter_grad(loss, has_aux=True)(eqx.combine(arrays, static), batch)
        steps, state = adam.update(gradient, state, arrays)
        return (eqx.apply_updates(arrays, steps), state), parts

    k_shuffle, k_side, key = jax.random.split(learner.key, 3)
    orders = jax.vmap(lambda k: jax.random.permutation(k, count))(jax.random.split(k_shuffle, config.epochs))
    pieces = orders[:, : size * config.minibatches].reshape(-1, size)
    sides = jax.random.randint(k_side, pieces.shape[:1], 0, ppo.SYMMETRIES)
    (arrays, state), parts = jax.lax.scan(optimise, (arrays, learner.optimizer), (pieces, sides))
    actor, critic = eqx.combine(arrays, static)
    metrics = {name: jnp.mean(value) for name, value in (*parts.items(), *score._asdict().items())}
    return Learner(actor, critic, state, learner.games, key, learner.updates + 1), metrics


def _where(mask: Array, yes: game.State, no: game.State) -> game.State:
    """Row by row, one game or the other."""

    def choose(a: Array, b: Array) -> Array:
        return jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - 1)), a, b)

    chosen: game.State = jax.tree.map(choose, yes, no)
    return chosen
