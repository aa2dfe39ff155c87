"""Actor and critic: small convolutional networks (Fig. "actor and critic", LeNet-like).

A convolution is written as a matrix times patches: inside `lax.scan` XLA's CPU backend runs its own convolution about
18 times slower. Weights are kept as that matrix; `skyrelay.learning.onnx` exports them as ordinary convolutions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from skyrelay.airspace.flight import ACTIONS
from skyrelay.airspace.maps import OUTLOOK_MAPS, PAPER_MAPS, safe_of
from skyrelay.core.errors import UsageError
from skyrelay.learning import egocentric

KERNEL = 3
PADDING = 1
UNSAFE = 1e4
"""Off the logit of a move that could break a link: it is never taken where another is safe."""


@dataclass(frozen=True)
class Architecture:
    """Convolutions of 3 x 3 cells with padding 1, then fully connected layers; ReLU after each.

    Attributes:
        n: side of the input maps [cells].
        channels: output channels of each convolution.
        strides: of each convolution.
        pools: side and stride of the max-pooling after each convolution, ceiling mode; 1 for none.
        hidden: widths of the fully connected layers.
        maps: names of the input maps: the six, and those of the game's options.
        egocentric: look at the maps from the UAV's place (`skyrelay.learning.egocentric`); without convolutions only.
    """

    n: int
    channels: tuple[int, ...]
    strides: tuple[int, ...]
    pools: tuple[int, ...]
    hidden: tuple[int, ...]
    maps: tuple[str, ...] = PAPER_MAPS
    egocentric: bool = False

    def __post_init__(self) -> None:
        if self.egocentric and self.channels:
            raise UsageError("architecture.egocentric", True, "no convolutions beside it")

    @property
    def features(self) -> int:
        """Numbers that enter the fully connected layers."""
        if self.egocentric:
            return egocentric.width(self.n, self.maps)
        side = self.n
        for stride, pool in zip(self.strides, self.pools, strict=True):
            side = -(-((side + 2 * PADDING - KERNEL) // stride + 1) // pool)
        return side * side * (self.channels[-1] if self.channels else len(self.maps))

    @property
    def parameters(self) -> int:
        """Of the actor, biases included."""
        widths = (len(self.maps), *self.channels)
        convolutions = sum(a * KERNEL**2 * b + b for a, b in pairwise(widths))
        sizes = (self.features, *self.hidden, ACTIONS)
        return convolutions + sum(a * b + b for a, b in pairwise(sizes))


FAST = Architecture(n=9, channels=(), strides=(), pools=(), hidden=(128, 64), egocentric=True)
"""No convolution: on a CPU it learns this game in a fraction of the time (docs/reference/policies.md)."""
GENERALIST = Architecture(n=11, channels=(), strides=(), pools=(), hidden=(256, 128), egocentric=True)
"""Finer maps and a wider net, for games of many scales."""
GENERALIST_CRITIC = replace(GENERALIST, hidden=(128, 64))
PAPER = Architecture(n=19, channels=(32, 64), strides=(1, 1), pools=(2, 1), hidden=(256, 128))
"""Recovered from the paper's figures: 1,692,969 actor parameters."""


class Linear(eqx.Module):
    """x @ weight + bias."""

    weight: Float[Array, "inputs outputs"]
    bias: Float[Array, " outputs"]

    @classmethod
    def new(cls, key: PRNGKeyArray, inputs: int, outputs: int, gain: float) -> Linear:
        """Normal weights that keep the size of what passes (times ``gain``), no bias."""
        return cls(jax.random.normal(key, (inputs, outputs)) * (gain / math.sqrt(inputs)), jnp.zeros(outputs))

    def __call__(self, x: Float[Array, "*batch inputs"]) -> Float[Array, "*batch outputs"]:
        """Apply to the last axis."""
        return x @ self.weight + self.bias


class Network(eqx.Module):
    """From a batch of normalised maps to ``outputs`` numbers each: logits of the actions, or a value.

    Where it is ``guarded``, moves that could break a link are out of the question (`skyrelay.airspace.guard`).
    """

    convolutions: list[Linear]
    layers: list[Linear]
    architecture: Architecture = eqx.field(static=True)
    guarded: bool = eqx.field(static=True, default=False)

    def __init__(
        self, key: PRNGKeyArray, architecture: Architecture, outputs: int, gain: float, *, guarded: bool = False
    ) -> None:
        keys = iter(jax.random.split(key, len(architecture.channels) + len(architecture.hidden) + 1))
        widths = (len(architecture.maps), *architecture.channels)
        sizes = (architecture.features, *architecture.hidden)
        relu = math.sqrt(2.0)
        self.convolutions = [Linear.new(next(keys), a * KERNEL**2, b, relu) for a, b in pairwise(widths)]
        self.layers = [Linear.new(next(keys), a, b, relu) for a, b in pairwise(sizes)]
        self.layers.append(Linear.new(next(keys), sizes[-1], outputs, gain))
        self.architecture = architecture
        self.guarded = guarded

    def __call__(self, maps: Float[Array, "batch maps n n"]) -> Float[Array, "batch outputs"]:
        """Apply to a batch of normalised maps."""
        outputs = self.conclude(self.look(maps))
        if self.guarded:
            outputs = outputs - UNSAFE * (1.0 - safe_of(maps, self.architecture.maps))
        return outputs

    def look(self, maps: Float[Array, "batch maps n n"]) -> Float[Array, "batch features"]:
        """What comes before the fully connected layers."""
        batch = maps.shape[0]
        if self.architecture.egocentric:
            return egocentric.egocentric(maps, self.architecture.maps)
        x = maps.reshape(batch, -1)
        if self.convolutions:
            x = x.T.reshape(*maps.shape[1:], batch)
            for convolution, stride, pool in zip(
                self.convolutions, self.architecture.strides, self.architecture.pools, strict=True
            ):
                x = max_pool(jax.nn.relu(convolve(convolution, x, stride)), pool)
            x = x.reshape(-1, batch).T
        return x

    def conclude(self, x: Float[Array, "batch features"]) -> Float[Array, "batch outputs"]:
        """The fully connected layers."""
        for layer in self.layers[:-1]:
            x = jax.nn.relu(layer(x))
        return self.layers[-1](x)


def actor(key: PRNGKeyArray, architecture: Architecture) -> Network:
    """The policy network: logits of the 9 actions, nearly equal at first; guarded where safe moves are told."""
    return Network(key, architecture, ACTIONS, gain=0.01, guarded=OUTLOOK_MAPS[0] in architecture.maps)


def critic(key: PRNGKeyArray, architecture: Architecture) -> Network:
    """The value network: one number."""
    return Network(key, architecture, 1, gain=1.0)


def convolve(
    convolution: Linear, x: Float[Array, "channels n n batch"], stride: int
) -> Float[Array, "outputs m m batch"]:
    """A 3 x 3 convolution with padding 1 as one matrix product over all cells of the batch.

    The batch is the last axis, so that cutting out the nine shifted copies moves long runs of memory.
    """
    channels, n, _, batch = x.shape
    x = jnp.pad(x, ((0, 0), (PADDING, PADDING), (PADDING, PADDING), (0, 0)))
    last = n + 2 * PADDING - KERNEL + 1
    patches = jnp.stack(
        [x[:, i : i + last : stride, j : j + last : stride] for i in range(KERNEL) for j in range(KERNEL)]
    )
    m = patches.shape[2]
    out = convolution.weight.T @ patches.reshape(KERNEL**2 * channels, -1) + convolution.bias[:, None]
    return out.reshape(-1, m, m, batch)


def max_pool(x: Float[Array, "channels n n batch"], size: int) -> Float[Array, "channels m m batch"]:
    """Maxima over blocks of size x size; the last block may be smaller (ceiling mode)."""
    if size == 1:
        return x
    short = -x.shape[1] % size
    x = jnp.pad(x, ((0, 0), (0, short), (0, short), (0, 0)), constant_values=-jnp.inf)
    channels, n, _, batch = x.shape
    return x.reshape(channels, n // size, size, n // size, size, batch).max(axis=(2, 4))
