"""From a trained network to an ONNX file with its model card inside."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from skyrelay.core.flight import ACTIONS
from skyrelay.learning.networks import KERNEL, PADDING, Linear, Network
from skyrelay.policy.card import CARD_KEY, Card

OPSET = 17


def export(actor: Network, card: Card) -> bytes:
    """The actor as an ONNX model: input ``maps`` [batch, maps, n, n], output ``logits`` [batch, 9].

    The same network gives the same bytes.
    """
    architecture = actor.architecture
    nodes: list[onnx.NodeProto] = []
    weights: list[onnx.TensorProto] = []
    last = "maps"

    def add(operator: str, inputs: list[str], **attributes: Any) -> str:
        output = f"{operator.lower()}_{len(nodes)}"
        nodes.append(helper.make_node(operator, inputs, [output], **attributes))
        return output

    def constant(name: str, value: np.ndarray) -> str:
        weights.append(numpy_helper.from_array(np.ascontiguousarray(value, dtype=np.float32), name))
        return name

    widths = (architecture.maps, *architecture.channels)
    for number, convolution in enumerate(actor.convolutions):
        stride, pool = architecture.strides[number], architecture.pools[number]
        kernel = constant(f"conv_{number}.weight", _kernel(convolution, widths[number]))
        bias = constant(f"conv_{number}.bias", np.asarray(convolution.bias))
        last = add("Conv", [last, kernel, bias], kernel_shape=[KERNEL] * 2, pads=[PADDING] * 4, strides=[stride] * 2)
        last = add("Relu", [last])
        if pool > 1:
            last = add("MaxPool", [last], kernel_shape=[pool] * 2, strides=[pool] * 2, ceil_mode=1)
    last = add("Flatten", [last], axis=1)
    for number, layer in enumerate(actor.layers):
        weight = constant(f"fc_{number}.weight", np.asarray(layer.weight))
        bias = constant(f"fc_{number}.bias", np.asarray(layer.bias))
        last = add("Gemm", [last, weight, bias])
        if number < len(actor.layers) - 1:
            last = add("Relu", [last])
    nodes[-1].output[0] = "logits"

    n = architecture.n
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("maps", TensorProto.FLOAT, ["batch", architecture.maps, n, n])],
        [helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["batch", ACTIONS])],
        weights,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="skyrelay")
    model.ir_version = 9
    helper.set_model_props(model, {CARD_KEY: card.model_dump_json()})
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


def _kernel(convolution: Linear, channels: int) -> np.ndarray:
    """From our matrix [9 x channels, outputs] to ONNX's [outputs, channels, 3, 3]."""
    weight = np.asarray(convolution.weight).reshape(KERNEL, KERNEL, channels, -1)
    return weight.transpose(3, 2, 0, 1)
