"""From a trained network to an ONNX file with its model card inside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from skyrelay.airspace.flight import ACTIONS
from skyrelay.airspace.maps import (
    GLOBAL_LOCATION,
    LOCAL_LOCATION,
    MAPS,
    OUTLOOK_MAPS,
    RANGE_MAPS,
    cell_of_move,
)
from skyrelay.learning.egocentric import (
    LEAST_RANGE,
    MARKS,
    PLACE_SCALE,
    ahead,
    marks,
    moved,
    near,
    offsets,
    same_everywhere,
    tells_range,
)
from skyrelay.learning.networks import KERNEL, PADDING, UNSAFE, Architecture, Linear, Network
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

    def constant(name: str, value: np.ndarray, dtype: type = np.float32) -> str:
        weights.append(numpy_helper.from_array(np.asarray(value, dtype=dtype, order="C"), name))
        return name

    if architecture.egocentric:
        last = _egocentric(add, constant, architecture)
    widths = (len(architecture.maps), *architecture.channels)
    for number, convolution in enumerate(actor.convolutions):
        stride, pool = architecture.strides[number], architecture.pools[number]
        kernel = constant(f"conv_{number}.weight", _kernel(convolution, widths[number]))
        bias = constant(f"conv_{number}.bias", np.asarray(convolution.bias))
        last = add("Conv", [last, kernel, bias], kernel_shape=[KERNEL] * 2, pads=[PADDING] * 4, strides=[stride] * 2)
        last = add("Relu", [last])
        if pool > 1:
            last = add("MaxPool", [last], kernel_shape=[pool] * 2, strides=[pool] * 2, ceil_mode=1)
    if not architecture.egocentric:
        last = add("Flatten", [last], axis=1)
    for number, layer in enumerate(actor.layers):
        weight = constant(f"fc_{number}.weight", np.asarray(layer.weight))
        bias = constant(f"fc_{number}.bias", np.asarray(layer.bias))
        last = add("Gemm", [last, weight, bias])
        if number < len(actor.layers) - 1:
            last = add("Relu", [last])
    if actor.guarded:
        last = _guarded(add, constant, architecture, last)
    nodes[-1].output[0] = "logits"

    n = architecture.n
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("maps", TensorProto.FLOAT, ["batch", len(architecture.maps), n, n])],
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


def _egocentric(add: Callable[..., str], constant: Callable[..., str], architecture: Architecture) -> str:
    """The nodes of `skyrelay.learning.egocentric.egocentric`; returns the name of what they make."""
    n, names = architecture.n, architecture.maps

    def indices(name: str, numbers: Any) -> str:
        return constant(name, np.asarray(numbers), np.int64)

    place_scale = constant("place_scale", np.array(PLACE_SCALE / MAPS["local_location"].scale))
    location_scale = constant("location_scale", np.array(MAPS["local_location"].scale))
    columns, rows, one = indices("columns", [1]), indices("rows", [2]), indices("one", [1])

    def place(name: str, number: int) -> list[str]:
        location = add("Gather", ["maps", indices(name, number)], axis=1)
        return [add("ReduceSum", [location, axis], keepdims=0) for axis in (columns, rows)]

    def move(name: str, numbers: list[int], places: list[str], shift: Callable[[str], str]) -> str:
        # [batch, 1, side, n]: the same for each map.
        across, along = (add("Unsqueeze", [shift(add("Div", [own, location_scale])), one]) for own in places)
        seen = add("Gather", ["maps", indices(name, numbers)], axis=1)
        seen = add("MatMul", [add("MatMul", [along, seen]), add("Transpose", [across], perm=[0, 1, 3, 2])])
        return add("Flatten", [seen], axis=1)

    own = place("own", GLOBAL_LOCATION)
    parts = [add("Mul", [share, place_scale]) for share in own]
    if tells_range(names):
        parts.append(move("moved", moved(names), own, _shift_in_ranges(add, constant, architecture)))
    else:
        parts.append(move("moved", moved(names), own, _shift_in_cells(add, constant, n, "moved")))
    if near(names):
        place_in_window = place("own_in_window", LOCAL_LOCATION)
        parts.append(move("near", near(names), place_in_window, _shift_in_cells(add, constant, n, "near")))
    for number in ahead(names):
        cells = add("Flatten", [add("Gather", ["maps", indices("ahead", [number])], axis=1)], axis=1)
        here = add("Gather", [cells, indices("middle_cell", [n * n // 2])], axis=1)
        parts += [add("Sub", [cells, here]), here]
    if numbers := same_everywhere(names):
        same = add("Gather", ["maps", indices("same", numbers)], axis=1)
        corner = [indices("corner_from", [0, 0]), indices("corner_to", [1, 1]), indices("corner_axes", [2, 3])]
        parts.append(add("Flatten", [add("Slice", [same, *corner])], axis=1))
    return add("Concat", parts, axis=1)


def _guarded(add: Callable[..., str], constant: Callable[..., str], architecture: Architecture, logits: str) -> str:
    """`UNSAFE` off the logits of the moves that are not safe."""
    number = constant("safe_moves", np.array([architecture.maps.index(OUTLOOK_MAPS[0])]), np.int64)
    cells = add("Flatten", [add("Gather", ["maps", number], axis=1)], axis=1)
    safe = add("Gather", [cells, constant("cell_of_move", cell_of_move(architecture.n), np.int64)], axis=1)
    unsafe = add("Sub", [constant("safe", np.array(MAPS["safe_moves"].scale)), safe])
    return add("Sub", [logits, add("Mul", [unsafe, constant("unsafe", np.array(UNSAFE / MAPS["safe_moves"].scale))])])


def _shift_in_cells(add: Callable[..., str], constant: Callable[..., str], n: int, name: str) -> Callable[[str], str]:
    """From shares of the own place [batch, n] to [batch, 2 n - 1, n]: which column comes to which offset."""
    table = constant(f"{name}_offsets", offsets(n), np.int64)
    padding = constant(f"{name}_one_after", np.array([0, 0, 0, 1]), np.int64)

    def shift(share: str) -> str:
        return add("Gather", [add("Pad", [share, padding]), table], axis=1)

    return shift


def _shift_in_ranges(
    add: Callable[..., str], constant: Callable[..., str], architecture: Architecture
) -> Callable[[str], str]:
    """From shares of the own place [batch, n] to [batch, marks, n]: which column comes to which mark."""
    n, number = architecture.n, architecture.maps.index(RANGE_MAPS[0])
    ends = [
        constant(f"range_{end}", np.array(cell), np.int64)
        for end, cell in (("from", [number, 0, 0]), ("to", [number + 1, 1, 1]))
    ]
    reach = add("Slice", ["maps", *ends, constant("range_axes", np.array([1, 2, 3]), np.int64)])
    # [batch, 1]
    reach = add("Flatten", [add("Div", [reach, constant("range_scale", np.array(MAPS["own_range"].scale))])], axis=1)
    reach = add("Max", [reach, constant("least_range", np.array(LEAST_RANGE))])
    unit = add("Mul", [reach, constant("cells_a_side", np.array(n))])
    cells = constant("cells", np.arange(n)[:, None])
    row_of_cells = constant("row_of_cells", np.arange(n)[None])
    nearest, farthest = constant("nearest", np.array(-MARKS[-1])), constant("farthest", np.array(MARKS[-1]))
    at, before, after = marks()
    ups = [constant("marks_before", before), constant("to_mark", at - before)]
    downs = [constant("marks_after", after), constant("from_mark", after - at)]
    middle = constant("middle", np.array([1]), np.int64)

    def shift(share: str) -> str:
        away = add("Div", [add("Sub", [row_of_cells, add("MatMul", [share, cells])]), unit])
        away = add("Unsqueeze", [add("Clip", [away, nearest, farthest]), middle])
        up = add("Div", [add("Sub", [away, ups[0]]), ups[1]])
        down = add("Div", [add("Sub", [downs[0], away]), downs[1]])
        return add("Relu", [add("Min", [up, down])])

    return shift
