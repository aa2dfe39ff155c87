"""Centralised PPO: one agent sees the maps of all UAVs and chooses one of 9^N joint actions.

The paper's comparison (Fig. "Comparison between the proposed MDRL and the benchmark"), by the very loop of
`skyrelay.learning.ppo` with another `Decider`. Two things differ: the first layer takes the maps of every UAV, and the
last one has an output for each combination of actions.
"""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt

from skyrelay.airspace.flight import ACTIONS
from skyrelay.coordination import game
from skyrelay.coordination.reward import Score
from skyrelay.coordination.settings import Domain, Shape
from skyrelay.core.errors import UsageError
from skyrelay.learning import ppo
from skyrelay.learning.networks import KERNEL, Architecture, Linear, Network
from skyrelay.learning.ppo import Decider, Hyperparameters, Learner

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

    def __call__(self, maps: Float[Array, "batch uavs maps n n"]) -> Float[Array, "batch outputs"]:
        """Logits of the combinations, or a value, for each team of the batch."""
        batch, uavs, channels, n, _ = maps.shape
        if self.convolutions:
            return super().__call__(maps.reshape(batch, uavs * channels, n, n))
        return self.conclude(self.look(maps.reshape(batch * uavs, channels, n, n)).reshape(batch, -1))


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


@dataclass(frozen=True)
class Central(Decider):
    """One choice for the whole team of ``uavs``, on the maps of all."""

    uavs: int

    def begin(
        self, key: PRNGKeyArray, config: Hyperparameters, shape: Shape, domain: Domain, total_updates: int
    ) -> Learner:
        """As `ppo.begin`, with the networks of a team.

        Raises:
            UsageError: the team's size varies, or is too large for 9^N outputs.
        """
        uavs = self.uavs
        if domain.uavs != (uavs, uavs) or shape.uavs != uavs or uavs > LARGEST_TEAM:
            raise UsageError("centralised training: uavs", domain.uavs, f"one team size of at most {LARGEST_TEAM}")
        k_actor, k_critic, key = jax.random.split(key, 3)
        learner = ppo.begin(key, config, shape, domain, total_updates)
        networks = joint_actor(k_actor, config.actor, uavs), joint_critic(k_critic, config.critic, uavs)
        state = ppo.optimizer(config, total_updates).init(eqx.filter(networks, eqx.is_array))
        return Learner(*networks, state, learner.games, learner.key, learner.updates)

    def sees(self, maps: UInt[Array, "games uavs maps n n"]) -> UInt[Array, "games 1 uavs maps n n"]:
        """Those of all."""
        return maps[:, None]

    def look(self, network: Network, seen: Float[Array, "games 1 uavs maps n n"]) -> Float[Array, "games 1 m"]:
        """Team by team."""
        return network(seen[:, 0])[:, None]

    def act(self, choice: Int[Array, "*rows"]) -> Int[Array, "*rows uavs"]:
        """The digits of the combination."""
        return separate(choice, self.uavs)

    def choice(self, actions: Int[Array, "*rows uavs"]) -> Int[Array, "*rows"]:
        """The number of the combination."""
        return join(actions)

    def reward(
        self,
        games: game.State,
        moved: game.State,
        score: Score,
        config: Hyperparameters,
        shaping: float | Float[Array, ""],
    ) -> Float[Array, "games 1"]:
        """The team's: there is no credit of a single UAV, and the shaping is the mean of the UAVs'."""
        reward = score.reward
        if config.shaping:
            reward = reward + shaping * ppo.potential_change(games, moved, config).mean(-1)
        return reward[:, None]

    def active(self, games: game.State) -> Bool[Array, "games 1"]:
        """Always."""
        return jnp.ones((games.time.shape[0], 1), bool)
