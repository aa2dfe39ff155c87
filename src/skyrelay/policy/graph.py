"""What an ONNX file may contain, looked at before any runtime sees it.

A graph is a program: loops need not end, and a few bytes can ask for more memory than there is. A policy needs neither,
so a file is refused unless its operators are on a list, none holds a graph of its own, every weight is a number and
lies in the file, and every value's size is known beforehand and small.
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
import onnx
from onnx import AttributeProto, TensorProto, numpy_helper, shape_inference

from skyrelay.core.errors import ModelError

MAX_NODES = 2_000
MAX_OPSETS = 16
MAX_ELEMENTS = 4 << 20
"""Of one value, for one observation."""
MAX_ALL_ELEMENTS = 32 << 20
"""Of all values together, for one observation."""

MANY = 64
"""Observations at a time for which sizes are worked out again: none may grow faster than their number."""

_NAMES = """
    Abs Add And ArgMax ArgMin AveragePool BatchNormalization Cast Ceil Clip Concat Constant
    ConstantOfShape Conv Cos Div Elu Equal Erf Exp Expand Flatten Floor Gather GatherElements Gelu Gemm
    GlobalAveragePool GlobalMaxPool Greater GreaterOrEqual GroupNormalization HardSigmoid HardSwish
    Identity InstanceNormalization LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax MatMul
    Max MaxPool Mean Min Mish Mod Mul Neg Not Or PRelu Pad Pow Reciprocal ReduceL2 ReduceMax ReduceMean
    ReduceMin ReduceProd ReduceSum Relu Reshape Round Selu Shape Sigmoid Sign Sin Slice Softmax Softplus
    Softsign Split Sqrt Squeeze Sub Sum Tanh Tile Transpose Unsqueeze Where Xor
"""
OPERATORS = frozenset(_NAMES.split())


def check_graph(content: bytes, place: str) -> None:
    """Refuse what is no plain network.

    Raises:
        ModelError: naming what was found.
    """
    try:
        model = onnx.ModelProto.FromString(content)
    except Exception as error:  # protobuf's errors have no base of their own
        raise ModelError(place, None, "an ONNX file (its protobuf cannot be read)") from error
    if len(model.opset_import) > MAX_OPSETS:
        raise ModelError(place, f"{len(model.opset_import):,} sets of operators", f"at most {MAX_OPSETS}")
    if model.functions or model.training_info or any(one.domain not in ("", "ai.onnx") for one in model.opset_import):
        raise ModelError(place, "functions or operators of its own", "ONNX's standard operators alone")
    graph = model.graph
    if len(graph.node) > MAX_NODES or graph.sparse_initializer:
        raise ModelError(place, f"{len(graph.node)} nodes", f"at most {MAX_NODES} nodes and no sparse weights")
    for tensor in graph.initializer:
        _check_tensor(tensor, place)
    for node in graph.node:
        if node.domain not in ("", "ai.onnx") or node.op_type not in OPERATORS:
            raise ModelError(
                f"{place}: operator", node.op_type, f"one of the {len(OPERATORS)} that networks are made of"
            )
        for attribute in node.attribute:
            if attribute.type in _GRAPHS or attribute.HasField("g") or attribute.graphs or attribute.sparse_tensors:
                raise ModelError(f"{place}: operator", node.op_type, "one without a graph inside")
            for tensor in [attribute.t] if attribute.HasField("t") else attribute.tensors:
                _check_tensor(tensor, place)
    _check_sizes(model, place)


_GRAPHS = (AttributeProto.GRAPH, AttributeProto.GRAPHS, AttributeProto.SPARSE_TENSOR, AttributeProto.SPARSE_TENSORS)


def _check_tensor(tensor: TensorProto, place: str) -> None:
    name = f"{place}: weight {tensor.name[:40]}"
    if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
        raise ModelError(name, "in another file", "weights in the file itself")
    if any(size < 0 for size in tensor.dims) or prod(tensor.dims) > 16 * MAX_ELEMENTS:
        raise ModelError(name, list(tensor.dims), "a size that fits the file")
    try:
        values: Any = numpy_helper.to_array(tensor)
    except Exception as error:
        raise ModelError(name, list(tensor.dims), "as many values as its size says") from error
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise ModelError(name, "not a number, or infinite", "finite numbers")


def _check_sizes(model: onnx.ModelProto, place: str) -> None:
    """Every value's size, worked out from the input's: for one observation, and for many at once."""
    batches = [
        dimensions[0]
        for dimensions in (entry.type.tensor_type.shape.dim for entry in model.graph.input)
        if dimensions and not dimensions[0].HasField("dim_value")
    ]
    del model.graph.value_info[:]  # what the file says of its inner values is not asked
    for entry in model.graph.output:
        entry.type.tensor_type.ClearField("shape")
    for batch in (1, MANY):
        for dimension in batches:
            dimension.dim_value = batch
        _check_inferred(model, place, batch)


def _check_inferred(model: onnx.ModelProto, place: str, batch: int) -> None:
    try:
        inferred = shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
    except Exception as error:
        reason = " ".join(str(error).split())[:160]
        raise ModelError(place, None, f"an ONNX model that onnxruntime runs ({reason})") from error
    sizes = {}
    for entry in (*inferred.graph.input, *inferred.graph.value_info, *inferred.graph.output):
        kind = entry.type.tensor_type
        known = kind.HasField("shape") and all(dim.HasField("dim_value") for dim in kind.shape.dim)
        sizes[entry.name] = prod(dim.dim_value for dim in kind.shape.dim) if known else None
    for node in inferred.graph.node:
        for name in filter(None, node.output):
            size = sizes.get(name)
            if size is None or not 0 <= size <= MAX_ELEMENTS * batch:
                found = "a size that is not known beforehand" if size is None else f"{size:,} values"
                raise ModelError(
                    f"{place}: {node.op_type} {name[:40]}", found, f"at most {MAX_ELEMENTS * batch:,} values"
                )
    total = sum(size or 0 for size in sizes.values())
    if total > MAX_ALL_ELEMENTS * batch:
        raise ModelError(
            place, f"{total:,} values", f"at most {MAX_ALL_ELEMENTS * batch:,} in all, for {batch} at a time"
        )
