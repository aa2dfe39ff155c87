"""Proximal policy optimisation with parameters shared by all UAVs (Algorithm "PPO- and CLDE-based MDRL").

Reads from top to bottom: what is set (`Hyperparameters`), what is learned (`Learner`), how experience is collected
(`collect`), what is optimised (`loss`), and one turn of it all (`update`). Each function is pure; `update` is compiled
once and called until the steps are spent. `skyrelay.learning.training` adds a leading axis of seeds by `jax.vmap`.

Who decides is left to a `Decider`: every UAV for itself (`EACH`, the paper's method), or one network for the whole team
(`skyrelay.baselines.centralized`).
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt

from skyrelay.airspace.flight import unit_moves
from skyrelay.airspace.maps import PAPER_MAPS, normalise
from skyrelay.coordination import game
from skyrelay.coordination.reward import Score
from skyrelay.coordination.settings import Domain, Shape
from skyrelay.core import plugins
from skyrelay.core.errors import TrainingError
from skyrelay.learning.gae import advantages
from skyrelay.learning.networks import Architecture, Network
from skyrelay.learning.networks import actor as new_actor
from skyrelay.learning.networks import critic as new_critic

SYMMETRIES = 8


@dataclass(frozen=True)
class Hyperparameters:
    """Of the algorithm (Table "Hyperparameters used for PPO training").

    Attributes:
        actor, critic: the networks.
        games: played side by side.
        horizon: steps of each game between two updates, at most an episode's length.
        epochs: passes over the collected experience.
        minibatches: pieces of each pass.
        learning_rate: of Adam; falls linearly to 0 over the training where ``anneal``.
        gamma: discount factor.
        decay: lambda of GAE.
        clip: of the probability ratio.
        entropy: weight of the entropy bonus.
        value: weight of the critic's loss.
        max_gradient: largest norm of the gradient.
        own_credit: learn from what each UAV answers for itself (`Score.credit`), not from the team's reward: the other
            UAVs' coverage is noise that its action hardly changes. Tests and evaluation always use the reward of Eq. 3.
        even_credit: with own credit, vehicles count as shares of the UAV's own, not of all. Where games are of many
            sizes, advantages in large teams are else small beside those in small ones, and drown in the entropy bonus.
        link_margin: with own credit, links count only where they are so many steps of a UAV shorter than the range. A
            team that learns at random moves finds its links cut at random, and gives them up for its vehicles where
            the zone is wide; and the greedy policy moves further in a step than the one that explores.
        shaping: share of the training over which gamma Phi(s') - Phi(s) is added to the reward, its weight falling from
            1 to 0; Phi is `skyrelay.coordination.reward.potential`. 0 for never.
        symmetries: optimise on experience that is turned and mirrored at random.
        critic_rate: learning rate of the critic where it has its own, falling likewise.
        time_limit_ends: nothing is expected after an episode's last step, as if the game were over then.
        per_agent: advantages are normalised for each place in the team, over all that was collected; else in each
            minibatch.
    """

    actor: Architecture
    critic: Architecture
    games: int
    horizon: int
    epochs: int
    minibatches: int
    learning_rate: float
    anneal: bool
    gamma: float = 0.99
    decay: float = 0.95
    clip: float = 0.2
    entropy: float = 0.01
    value: float = 0.5
    max_gradient: float = 0.5
    own_credit: bool = False
    even_credit: bool = False
    link_margin: float = 0.0
    shaping: float = 0.0
    symmetries: bool = False
    critic_rate: float | None = None
    time_limit_ends: bool = False
    per_agent: bool = False

    @property
    def steps_per_update(self) -> int:
        """Steps of a team, over all games, between two updates."""
        return self.games * self.horizon


class Learner(eqx.Module):
    """All that changes while learning; a checkpoint holds exactly this.

    Attributes:
        actor, critic: the networks.
        optimizer: state of Adam.
        games: the games in play, one row each.
        key: of the randomness to come.
        updates: done so far.
    """

    actor: Network
    critic: Network
    optimizer: optax.OptState
    games: game.State
    key: PRNGKeyArray
    updates: Int[Array, ""]


class Experience(NamedTuple):
    """What one decision leaves behind; rows are [horizon, games, decisions] or any flattening of it.

    Attributes:
        maps: observation, as levels; of a UAV, or of all UAVs of a team that decides as one.
        action: taken.
        log_probability: of the action when it was taken.
        value: what the critic expected.
        advantage: what GAE makes of the rewards that followed.
        active: false for a row that holds no UAV, which counts for nothing.
    """

    maps: UInt[Array, "*rows maps n n"]
    action: Int[Array, "*rows"]
    log_probability: Float[Array, "*rows"]
    value: Float[Array, "*rows"]
    advantage: Float[Array, "*rows"]
    active: Bool[Array, "*rows"]


class Decider(abc.ABC):
    """Who decides in a team, and what for. It has no state: the networks are the learner's.

    A team takes ``decisions`` at a step: one for each UAV, or one for all.
    """

    @abc.abstractmethod
    def begin(
        self, key: PRNGKeyArray, config: Hyperparameters, shape: Shape, domain: Domain, total_updates: int
    ) -> Learner:
        """New networks and new games."""

    @abc.abstractmethod
    def sees(self, maps: UInt[Array, "games uavs maps n n"]) -> UInt[Array, "games decisions *seen"]:
        """The maps that each decision is made on."""

    @abc.abstractmethod
    def look(self, network: Network, seen: Float[Array, "games decisions *seen"]) -> Float[Array, "games decisions m"]:
        """What a network makes of normalised maps."""

    @abc.abstractmethod
    def act(self, choice: Int[Array, "*rows"]) -> Int[Array, "*rows own"]:
        """The action of each UAV that a choice decides for."""

    @abc.abstractmethod
    def choice(self, actions: Int[Array, "*rows own"]) -> Int[Array, "*rows"]:
        """The choice that stands for these actions: `act` backwards."""

    @abc.abstractmethod
    def reward(
        self,
        games: game.State,
        moved: game.State,
        score: Score,
        config: Hyperparameters,
        shaping: float | Float[Array, ""],
    ) -> Float[Array, "games decisions"]:
        """What a step was worth to each decision.

        Args:
            games, moved: before and after it, a leading axis of games.
            score: of ``moved``.
            shaping: weight of the shaping.
        """

    @abc.abstractmethod
    def active(self, games: game.State) -> Bool[Array, "games decisions"]:
        """Whether each decision is a UAV's at all."""

    def greedy(self, network: Network, games: game.State) -> Int[Array, "games uavs"]:
        """The most valued actions."""
        shape = games.shape
        seen = normalise(self.sees(jax.vmap(game.observe)(games)), shape.zoom, shape.maps)
        return self.actions(jnp.argmax(self.look(network, seen), -1))

    def actions(self, choice: Int[Array, "games decisions"]) -> Int[Array, "games uavs"]:
        """Of the whole team."""
        return self.act(choice).reshape(choice.shape[0], -1)


@dataclass(frozen=True)
class Each(Decider):
    """Every UAV decides for itself, all with the same networks."""

    def begin(
        self, key: PRNGKeyArray, config: Hyperparameters, shape: Shape, domain: Domain, total_updates: int
    ) -> Learner:
        """As `skyrelay.learning.ppo.begin`."""
        return begin(key, config, shape, domain, total_updates)

    def sees(self, maps: UInt[Array, "games uavs maps n n"]) -> UInt[Array, "games uavs maps n n"]:
        """Its own."""
        return maps

    def look(self, network: Network, seen: Float[Array, "games uavs maps n n"]) -> Float[Array, "games uavs m"]:
        """UAV by UAV."""
        return jax.vmap(network)(seen)

    def act(self, choice: Int[Array, "*rows"]) -> Int[Array, "*rows 1"]:
        """The choice is the action."""
        return choice[..., None]

    def choice(self, actions: Int[Array, "*rows 1"]) -> Int[Array, "*rows"]:
        """The same backwards."""
        return actions[..., 0]

    def reward(
        self,
        games: game.State,
        moved: game.State,
        score: Score,
        config: Hyperparameters,
        shaping: float | Float[Array, ""],
    ) -> Float[Array, "games uavs"]:
        """The team's reward, or the UAV's own credit where it is asked for."""
        uavs = games.shape.uavs
        reward = jnp.broadcast_to(score.reward[:, None], games.active.shape)
        if config.own_credit:
            reward = score.credit
            if config.even_credit:
                own = jnp.sum(moved.served_by[:, None] == jnp.arange(uavs)[:, None], axis=-1)
                of_own = jnp.sum(moved.present, axis=-1, keepdims=True) / jnp.maximum(own, 1)
                reward = reward + (1.0 - of_own) * score.missed
            if config.link_margin:
                safe, linked = (jax.vmap(partial(game.linked, margin=m))(moved) for m in (config.link_margin, 0.0))
                reward = reward + (safe - linked)
        if config.shaping:
            reward = reward + shaping * potential_change(games, moved, config)
        return reward

    def active(self, games: game.State) -> Bool[Array, "games uavs"]:
        """A row may hold no UAV, and a UAV may leave."""
        return games.active


EACH = Each()


@dataclass(frozen=True)
class OwnReward(Each):
    """Every UAV decides for itself, for a reward of one's own; tests and evaluation stay with Eq. 3.

    Attributes:
        name: of the reward, in the record of the training.
        function: from the games before and after a step (a leading axis of games) and the score after it to the reward
            of each UAV [games, uavs], or of each team [games]; traced by JAX.
    """

    name: str
    function: Callable[[game.State, game.State, Score], Array]

    def reward(
        self,
        games: game.State,
        moved: game.State,
        score: Score,
        config: Hyperparameters,
        shaping: float | Float[Array, ""],
    ) -> Float[Array, "games uavs"]:
        """What the function says, and the shaping where the preset has it.

        Raises:
            TrainingError: the function raises, or answers with another shape.
        """
        place = f"reward {self.name}"
        try:
            reward = jnp.asarray(self.function(games, moved, score), jnp.float32)
        except Exception as error:  # own code may raise anything
            raise TrainingError(place, None, f"a reward of each UAV ({plugins.fault(error)})") from error
        count = games.active.shape
        if reward.shape not in {count, count[:1]}:
            raise TrainingError(place, f"of shape {reward.shape}", f"{count}, or {count[:1]} for whole teams")
        reward = jnp.broadcast_to(reward if reward.ndim == 2 else reward[:, None], count)
        return reward + shaping * potential_change(games, moved, config) if config.shaping else reward


def potential_change(games: game.State, moved: game.State, config: Hyperparameters) -> Float[Array, "games uavs"]:
    """Gamma Phi(s') - Phi(s) of each UAV."""
    return config.gamma * jax.vmap(game.potential)(moved) - jax.vmap(game.potential)(games)


def optimizer(config: Hyperparameters, total_updates: int) -> optax.GradientTransformation:
    """Adam with a bound on the gradient's norm."""
    turns = total_updates * config.epochs * config.minibatches

    def adam(rate: float) -> optax.GradientTransformation:
        return optax.adam(optax.linear_schedule(rate, 0.0, turns) if config.anneal else rate, eps=1e-5)

    both = adam(config.learning_rate)
    if config.critic_rate is not None:
        both = optax.partition({"actor": both, "critic": adam(config.critic_rate)}, ("actor", "critic"))
    return optax.chain(optax.clip_by_global_norm(config.max_gradient), both)


def begin(key: PRNGKeyArray, config: Hyperparameters, shape: Shape, domain: Domain, total_updates: int) -> Learner:
    """New networks and new games; the games' clocks differ, so that they do not all reset at once."""
    k_actor, k_critic, k_games, k_clock, key = jax.random.split(key, 5)
    actor, critic = new_actor(k_actor, config.actor), new_critic(k_critic, config.critic)
    games = new_games(k_games, config.games, shape, domain)
    clocks = jax.random.randint(k_clock, (config.games,), 0, shape.steps)
    games = eqx.tree_at(lambda g: g.time, games, clocks)
    state = optimizer(config, total_updates).init(eqx.filter((actor, critic), eqx.is_array))
    return Learner(actor, critic, state, games, key, jnp.int32(0))


def new_games(key: PRNGKeyArray, count: int, shape: Shape, domain: Domain) -> game.State:
    """``count`` games with parameters of their own."""

    def one(key: PRNGKeyArray) -> game.State:
        k_draw, k_reset = jax.random.split(key)
        return game.reset(k_reset, shape, domain.draw(k_draw))

    return jax.vmap(one)(jax.random.split(key, count))


def collect(
    learner: Learner,
    config: Hyperparameters,
    domain: Domain,
    shaping: float | Float[Array, ""] = 0.0,
    decider: Decider = EACH,
) -> tuple[Learner, Experience, Score]:
    """Play ``horizon`` steps of every game with the present policy.

    Returns: the learner with its games moved on, experience [horizon, games, decisions], and scores [horizon, games].
    """
    shape = learner.games.shape
    k_reset, k_play, key = jax.random.split(learner.key, 3)
    # A game reaches its time limit at most once in a horizon: one new game for each is enough, made beforehand.
    fresh = new_games(k_reset, config.games, shape, domain)

    def look(network: Network, seen: Array) -> Array:
        return decider.look(network, normalise(seen, shape.zoom, shape.maps))

    def play(carry: tuple[game.State, game.State], key: PRNGKeyArray) -> tuple[tuple[game.State, game.State], Any]:
        games, last = carry
        seen = decider.sees(jax.vmap(game.observe)(games))
        log_probabilities = jax.nn.log_softmax(look(learner.actor, seen))
        choice = jax.random.categorical(key, log_probabilities)
        log_probability = jnp.take_along_axis(log_probabilities, choice[..., None], -1)[..., 0]
        value = look(learner.critic, seen)[..., 0]
        moved, transition = jax.vmap(game.step)(games, decider.actions(choice))
        reward = decider.reward(games, moved, transition.score, config, shaping)
        over = transition.truncated
        last = game.row_where(over, moved, last)
        active, stays = decider.active(games), decider.active(moved)
        row = (seen, choice, log_probability, value, active, stays, reward, transition.score, over)
        return (game.row_where(over, fresh, moved), last), row

    (games, last), rows = jax.lax.scan(play, (learner.games, learner.games), jax.random.split(k_play, config.horizon))
    seen, choice, log_probability, value, active, stays, reward, score, over = rows

    # The value of the state that each step led to: the next row's, or the last state's of a game that was cut short.
    value_now, value_last = (
        look(learner.critic, decider.sees(jax.vmap(game.observe)(state)))[..., 0] for state in (games, last)
    )
    next_value = jnp.where(over[..., None], value_last, jnp.concatenate([value[1:], value_now[None]]))
    # A UAV that has left expects nothing more.
    next_value = jnp.where(stays, next_value, 0.0)
    if config.time_limit_ends:
        next_value = jnp.where(over[..., None], 0.0, next_value)
    stop = over[..., None] | ~stays
    advantage = advantages(reward, value, next_value, stop, config.gamma, config.decay)

    learner = eqx.tree_at(lambda state: (state.games, state.key), learner, (games, key))
    return learner, Experience(seen, choice, log_probability, value, advantage, active), score


def loss(
    networks: tuple[Network, Network],
    batch: Experience,
    config: Hyperparameters,
    zoom: int,
    names: tuple[str, ...] = PAPER_MAPS,
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """The clipped surrogate objective, the critic's squared error, and the entropy bonus (Schulman et al. 2017, Eq. 9).

    Args:
        batch: rows of experience, [rows].
        zoom, names: of its maps.
    Returns: the loss, and its parts by name.
    """
    actor, critic = networks
    maps = normalise(batch.maps, zoom, names)
    log_probabilities = jax.nn.log_softmax(actor(maps))
    log_probability = jnp.take_along_axis(log_probabilities, batch.action[:, None], -1)[:, 0]
    value = critic(maps)[:, 0]

    weight = batch.active / jnp.maximum(jnp.sum(batch.active), 1)

    def mean(x: Array) -> Array:
        return jnp.sum(weight * x)

    advantage = batch.advantage
    if not config.per_agent:
        centred = batch.advantage - mean(batch.advantage)
        advantage = centred / (jnp.sqrt(mean(centred**2)) + 1e-8)

    ratio = jnp.exp(log_probability - batch.log_probability)
    clipped = jnp.clip(ratio, 1.0 - config.clip, 1.0 + config.clip)
    policy_loss = -mean(jnp.minimum(ratio * advantage, clipped * advantage))
    value_loss = 0.5 * mean((value - (batch.value + batch.advantage)) ** 2)
    entropy = -mean(jnp.sum(jnp.exp(log_probabilities) * log_probabilities, -1))

    total = policy_loss + config.value * value_loss - config.entropy * entropy
    parts = {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "kl": mean(ratio - 1.0 - jnp.log(ratio)),
        "clipped": mean((jnp.abs(ratio - 1.0) > config.clip).astype(jnp.float32)),
    }
    return total, parts


def update(
    learner: Learner, config: Hyperparameters, domain: Domain, total_updates: int, decider: Decider = EACH
) -> tuple[Learner, dict[str, Float[Array, ""]]]:
    """Collect experience once, then optimise on it ``epochs`` times in ``minibatches`` pieces.

    Returns: the learner, and means of the scores and of the loss's parts by name.
    """
    shaping = jnp.clip(1.0 - learner.updates / max(config.shaping * total_updates, 1.0), 0.0, 1.0)
    learner, experience, score = collect(learner, config, domain, shaping, decider)
    if config.per_agent:
        experience = normalised_by_agent(experience)
    shape = learner.games.shape
    adam = optimizer(config, total_updates)
    rows: Experience = jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:]), experience)
    objective = partial(loss, config=config, zoom=shape.zoom, names=shape.maps)
    count = rows.action.shape[0]
    size = count // config.minibatches

    arrays, static = eqx.partition((learner.actor, learner.critic), eqx.is_array)

    def optimise(carry: Any, piece: tuple[Int[Array, " size"], Int[Array, ""]]) -> tuple[Any, dict[str, Array]]:
        chosen, side = piece
        arrays, state = carry
        batch = jax.tree.map(lambda x: x[chosen], rows)
        if config.symmetries:
            batch = turned(batch, side, decider)
        networks = eqx.combine(arrays, static)
        gradient, parts = eqx.filter_grad(objective, has_aux=True)(networks, batch)
        steps, state = adam.update(gradient, state, arrays)
        return (eqx.apply_updates(arrays, steps), state), parts

    k_shuffle, k_side, key = jax.random.split(learner.key, 3)
    orders = jax.vmap(lambda k: jax.random.permutation(k, count))(jax.random.split(k_shuffle, config.epochs))
    if domain.mean_uavs < shape.uavs:
        # Many rows are empty: a pass takes as many as hold a UAV on average.
        size = math.ceil(count * domain.mean_uavs / shape.uavs) // config.minibatches
        orders = jax.vmap(lambda order: dealt(order, rows.active, config.minibatches, size).reshape(-1))(orders)
    pieces = orders[:, : size * config.minibatches].reshape(-1, size)
    sides = jax.random.randint(k_side, pieces.shape[:1], 0, SYMMETRIES)
    (arrays, state), parts = jax.lax.scan(optimise, (arrays, learner.optimizer), (pieces, sides))

    actor, critic = eqx.combine(arrays, static)
    metrics = {name: jnp.mean(value) for name, value in parts.items()}
    # Of the team's scores; what each UAV answers for has a third axis.
    metrics |= {name: jnp.mean(value) for name, value in score._asdict().items() if value.ndim == 2}
    return Learner(actor, critic, state, learner.games, key, learner.updates + 1), metrics


def normalised_by_agent(experience: Experience) -> Experience:
    """The same with advantages of mean 0 and deviation 1 for each place in the team [horizon, games, decisions].

    What the critic is to expect, value and advantage together, stays.
    """
    active, advantage = experience.active, experience.advantage
    centred = advantage - jnp.mean(advantage, (0, 1), where=active)
    normalised = jnp.where(active, centred / (jnp.sqrt(jnp.mean(centred**2, (0, 1), where=active)) + 1e-8), 0.0)
    return experience._replace(advantage=normalised, value=experience.value + advantage - normalised)


def dealt(
    order: Int[Array, " rows"], active: Bool[Array, " rows"], pieces: int, size: int
) -> Int[Array, "pieces size"]:
    """Rows in this order, those with a UAV first, dealt out one by one to the pieces; what is over is left out."""
    order = order[jnp.argsort(~active[order], stable=True)]
    return order[: pieces * size].reshape(size, pieces).T


def turned(batch: Experience, side: Int[Array, ""], decider: Decider = EACH) -> Experience:
    """The same experience in a zone that is turned or mirrored (one of the square's 8 symmetries).

    The game has no preferred direction, so what was a good action stays one: each decision teaches eight.
    """
    n = batch.maps.shape[-1]
    cells, actions = (jnp.asarray(table)[side] for table in _symmetry_tables(n))
    maps = batch.maps.reshape(*batch.maps.shape[:-2], n * n)[..., cells].reshape(batch.maps.shape)
    return batch._replace(maps=maps, action=decider.choice(actions[decider.act(batch.action)]))


@cache
def _symmetry_tables(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Of each symmetry: [8, n n] which cell each cell's content comes from, and [8, 9] what each action becomes."""
    grid = np.arange(n * n).reshape(n, n)
    moves = np.asarray(unit_moves())
    cells, actions = [], []
    for side in range(SYMMETRIES):
        mirror, turns = divmod(side, 4)
        turned = np.rot90(grid[:, ::-1] if mirror else grid, turns)
        cells.append(turned.reshape(-1))
        headings = moves * (-1, 1) if mirror else moves
        # Rows are y upwards, so np.rot90 of the array is a quarter turn clockwise in the zone.
        for _ in range(turns):
            headings = np.stack([headings[:, 1], -headings[:, 0]], axis=1)
        actions.append([int(np.argmin(((moves - heading) ** 2).sum(1))) for heading in headings])
    return np.array(cells), np.array(actions)
