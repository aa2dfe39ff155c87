"""The networks: the paper's count, convolutions against XLA's own, ONNX against the trained net."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import onnx
import pytest

from skyrelay.airspace.maps import map_names, safe_of
from skyrelay.core.errors import UsageError
from skyrelay.learning import networks
from skyrelay.learning.networks import FAST, GENERALIST, PAPER, Architecture
from skyrelay.learning.onnx import export
from skyrelay.policy import Card, Policy


def count(network):
    return sum(leaf.size for leaf in jax.tree.leaves(eqx.filter(network, eqx.is_array)))


def test_the_papers_network_has_the_papers_parameters():
    assert PAPER.parameters == 1_692_969
    assert count(networks.actor(jax.random.key(0), PAPER)) == 1_692_969
    assert count(networks.critic(jax.random.key(0), PAPER)) == 1_692_969 - 8 * (128 + 1)
    assert count(networks.actor(jax.random.key(0), FAST)) == FAST.parameters


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("n", [5, 8, 11])
def test_convolution_equals_xlas_own(stride, n):
    layer = networks.Linear.new(jax.random.key(1), 6 * 9, 7, 1.0)
    layer = eqx.tree_at(lambda one: one.bias, layer, jnp.arange(7.0))
    x = jax.random.normal(jax.random.key(2), (6, n, n, 3))
    kernel = layer.weight.reshape(3, 3, 6, 7)
    expected = jax.lax.conv_general_dilated(
        jnp.moveaxis(x, 3, 0), kernel, (stride, stride), [(1, 1)] * 2, dimension_numbers=("NCHW", "HWIO", "NCHW")
    )
    expected = jnp.moveaxis(expected + layer.bias[:, None, None], 0, 3)
    np.testing.assert_allclose(networks.convolve(layer, x, stride), expected, rtol=1e-4, atol=1e-4)


def test_pooling_in_ceiling_mode():
    x = jnp.arange(9.0).reshape(1, 3, 3, 1)
    np.testing.assert_array_equal(networks.max_pool(x, 2)[0, :, :, 0], [[4, 5], [7, 8]])


def card(n):
    return Card(
        name="test",
        n=n,
        zoom=2,
        uavs=(2, 3),
        vehicles=(4, 4),
        ratio=(2.0, 2.0),
        uav_step=(0.05, 0.05),
        steps=1,
        seeds=[0],
        preset="tiny",
        command="pytest",
        versions={},
        evaluation=[],
        limits="none",
    )


@pytest.mark.parametrize(
    "architecture",
    [
        PAPER,
        FAST,
        Architecture(n=7, channels=(4, 5), strides=(2, 1), pools=(1, 2), hidden=(6,)),
        Architecture(n=7, channels=(), strides=(), pools=(), hidden=(6,)),
        replace(FAST, maps=map_names(obstacles=True, energy=True)),
        replace(GENERALIST, maps=map_names(obstacles=True, energy=False, tells_range=True)),
        replace(FAST, maps=map_names(obstacles=False, energy=False, outlook=True)),
        replace(PAPER, maps=map_names(obstacles=False, energy=True, outlook=True)),
    ],
    ids=["paper", "fast", "strided", "connected", "options", "range", "outlook", "outlook-paper"],
)
def test_onnx_agrees_with_the_network(architecture):
    network = networks.actor(jax.random.key(4), architecture)
    # The first outputs are nearly equal by design; larger ones make a difference visible.
    network = eqx.tree_at(lambda net: net.layers[-1].weight, network, network.layers[-1].weight * 100)
    about = card(architecture.n).model_copy(update={"maps": architecture.maps})
    content = export(network, about)
    assert content == export(network, about)
    policy = Policy.load(content)
    shape = (64, len(architecture.maps), architecture.n, architecture.n)
    drawn = jax.random.uniform(jax.random.key(5), shape)
    maps, expected = np.asarray(drawn), np.asarray(network(drawn))
    np.testing.assert_allclose(policy.logits(maps), expected, rtol=1e-3, atol=1e-4)
    top = np.sort(expected, axis=1)
    clear = top[:, -1] - top[:, -2] > 1e-3
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(policy.decide(maps)[clear], expected.argmax(axis=1)[clear])


def test_a_guarded_network_takes_safe_moves_only():
    """Whatever it has learned; and where it is told of none, the one that it values most."""
    names = map_names(obstacles=False, energy=False, outlook=True)
    network = networks.actor(jax.random.key(1), replace(FAST, maps=names))
    network = eqx.tree_at(lambda net: net.layers[-1].weight, network, network.layers[-1].weight * 100)
    maps = np.array(jax.random.uniform(jax.random.key(2), (200, len(names), FAST.n, FAST.n)))
    maps[:, -2] = maps[:, -2] > 0.8
    safe = np.asarray(safe_of(jnp.asarray(maps), names)).astype(bool)
    logits = np.asarray(network(jnp.asarray(maps)))
    some = np.asarray(safe.any(axis=1))
    assert 100 < some.sum() < 200
    assert safe[some, logits[some].argmax(axis=1)].all()
    assert (np.asarray(jax.nn.softmax(logits))[~safe & some[:, None]] == 0).all()
    free = networks.Network(jax.random.key(1), network.architecture, 9, 1.0)
    free = eqx.tree_at(lambda net: net.layers, free, network.layers)
    unguarded = np.asarray(free(jnp.asarray(maps)))
    np.testing.assert_array_equal(logits[~some].argmax(axis=1), unguarded[~some].argmax(axis=1))
    assert not networks.critic(jax.random.key(1), replace(FAST, maps=names)).guarded


def test_the_file_is_plain_onnx():
    model = onnx.load_from_string(export(networks.actor(jax.random.key(0), PAPER), card(19)))
    assert [node.op_type for node in model.graph.node] == (
        ["Conv", "Relu", "MaxPool", "Conv", "Relu", "Flatten", "Gemm", "Relu", "Gemm", "Relu", "Gemm"]
    )
    assert sum(int(np.prod(tensor.dims)) for tensor in model.graph.initializer) == 1_692_969


def test_no_convolutions_behind_the_egocentric_view():
    with pytest.raises(UsageError, match=r"architecture.egocentric: is True; expected no convolutions"):
        replace(PAPER, egocentric=True)
