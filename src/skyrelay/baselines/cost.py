"""What a network weighs: its parameters, and the floating-point operations of one decision."""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
import jax

from skyrelay.baselines.centralized import joint_actor
from skyrelay.learning import egocentric
from skyrelay.learning.networks import KERNEL, PADDING, Architecture, Network
from skyrelay.learning.networks import actor as new_actor


@dataclass(frozen=True)
class Cost:
    """Of an actor.

    Attributes:
        parameters: weights and biases.
        operations: of one decision, a multiplication and an addition counted apart; activations and pooling left out.
    """

    parameters: int
    operations: int


def decentralized_cost(architecture: Architecture) -> Cost:
    """Of the network that every UAV carries, whatever the team's size."""
    return _cost(eqx.filter_eval_shape(new_actor, jax.random.key(0), architecture))


def centralized_cost(architecture: Architecture, uavs: int) -> Cost:
    """Of the network that decides for a team; no weight is allocated for it."""
    return _cost(eqx.filter_eval_shape(joint_actor, jax.random.key(0), architecture, uavs), looks=uavs)


def _cost(network: Network, looks: int = 1) -> Cost:
    """From the shapes of the weights: a layer uses each of them once, a convolution once in every cell.

    Args:
        looks: how many UAVs' maps are looked at.
    """
    architecture = network.architecture
    operations, side = 0, architecture.n
    if architecture.egocentric:
        operations += looks * egocentric.operations(architecture.n, architecture.maps)
    for layer, stride, pool in zip(network.convolutions, architecture.strides, architecture.pools, strict=True):
        side = (side + 2 * PADDING - KERNEL) // stride + 1
        operations += 2 * layer.weight.size * side**2
        side = -(-side // pool)
    operations += sum(2 * layer.weight.size for layer in network.layers)
    arrays = jax.tree.leaves(eqx.filter(network, lambda leaf: hasattr(leaf, "shape")))
    return Cost(sum(leaf.size for leaf in arrays), operations)
