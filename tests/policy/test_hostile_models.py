"""Files that are no networks: refused in one line, in bounded time and memory, before this process loads them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from skyrelay.core.errors import ModelError
from skyrelay.policy import Policy, trial
from skyrelay.policy.graph import check_graph
from skyrelay.policy.trial import require_harmless

Change = Callable[[onnx.ModelProto], None]


@pytest.fixture(scope="module")
def good() -> bytes:
    return Policy.builtin("generalist").content


def altered(content: bytes, change: Change) -> bytes:
    model = onnx.load_from_string(content)
    change(model)
    return bytes(model.SerializeToString())


def before_the_output(*nodes: onnx.NodeProto, weights: dict[str, Any] | None = None) -> Change:
    """Nodes between the network's output, now ``told``, and ``logits``."""

    def change(model: onnx.ModelProto) -> None:
        name = model.graph.output[0].name
        model.graph.node[-1].output[0] = "told"
        for node in nodes:
            for place, output in enumerate(node.output):
                if output == "logits":
                    node.output[place] = name
        model.graph.node.extend(nodes)
        for key, value in (weights or {}).items():
            model.graph.initializer.append(numpy_helper.from_array(np.asarray(value), key))

    return change


def a_loop() -> Change:
    """Two to the sixty turns."""
    body = helper.make_graph(
        [helper.make_node("Identity", ["going"], ["on"]), helper.make_node("Identity", ["value"], ["same"])],
        "body",
        [
            helper.make_tensor_value_info("turn", TensorProto.INT64, []),
            helper.make_tensor_value_info("going", TensorProto.BOOL, []),
            helper.make_tensor_value_info("value", TensorProto.FLOAT, None),
        ],
        [
            helper.make_tensor_value_info("on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("same", TensorProto.FLOAT, None),
        ],
    )
    loop = helper.make_node("Loop", ["turns", "yes", "told"], ["logits"], body=body)
    return before_the_output(loop, weights={"turns": np.int64(2**60), "yes": np.bool_(True)})


def an_if() -> Change:
    def branch(name: str) -> onnx.GraphProto:
        node = helper.make_node("Identity", ["told"], [name])
        return helper.make_graph([node], name, [], [helper.make_tensor_value_info(name, TensorProto.FLOAT, None)])

    node = helper.make_node("If", ["yes"], ["logits"], then_branch=branch("a"), else_branch=branch("b"))
    return before_the_output(node, weights={"yes": np.bool_(True)})


def a_graph_in_an_allowed_operator() -> Change:
    node = helper.make_node("Identity", ["told"], ["logits"])
    node.attribute.append(helper.make_attribute("body", helper.make_graph([], "inner", [], [])))
    return before_the_output(node)


def memory(size: list[int]) -> Change:
    """A few bytes that ask for gigabytes."""
    nodes = [
        helper.make_node("ConstantOfShape", ["size"], ["huge"]),
        helper.make_node("ReduceSum", ["huge"], ["sum"], keepdims=0),
        helper.make_node("Add", ["told", "sum"], ["logits"]),
    ]
    return before_the_output(*nodes, weights={"size": np.array(size, np.int64)})


def doubling() -> Change:
    nodes = [helper.make_node("Concat", [f"d{i}" if i else "told"] * 2, [f"d{i + 1}"], axis=1) for i in range(34)]
    nodes.append(helper.make_node("ReduceSum", ["d34"], ["sum"], keepdims=0))
    return before_the_output(*nodes, helper.make_node("Add", ["told", "sum"], ["logits"]))


def outer_product() -> Change:
    """Small for one observation, a square for many."""
    nodes = [
        helper.make_node("Tile", ["told", "often"], ["wide"]),
        helper.make_node("Reshape", ["wide", "column"], ["tall"]),
        helper.make_node("Reshape", ["wide", "row"], ["flat"]),
        helper.make_node("MatMul", ["tall", "flat"], ["square"]),
        helper.make_node("ReduceSum", ["square"], ["sum"], keepdims=0),
        helper.make_node("Add", ["told", "sum"], ["logits"]),
    ]
    weights = {
        "often": np.array([1, 200], np.int64),
        "column": np.array([-1, 1], np.int64),
        "row": np.array([1, -1], np.int64),
    }
    return before_the_output(*nodes, weights=weights)


def unknown_size() -> Change:
    nodes = [
        helper.make_node("ReduceMax", ["told"], ["most"], keepdims=0),
        helper.make_node("Cast", ["most"], ["whole"], to=TensorProto.INT64),
        helper.make_node("Reshape", ["whole", "one"], ["size"]),
        helper.make_node("ConstantOfShape", ["size"], ["any"]),
        helper.make_node("ReduceSum", ["any"], ["sum"], keepdims=0),
        helper.make_node("Add", ["told", "sum"], ["logits"]),
    ]
    return before_the_output(*nodes, weights={"one": np.array([1], np.int64)})


def weight_of(value: float) -> Change:
    def change(model: onnx.ModelProto) -> None:
        for tensor in model.graph.initializer:
            if tensor.data_type == TensorProto.FLOAT:
                values = numpy_helper.to_array(tensor).copy()
                values.flat[0] = value
                tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))

    return change


def outside(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def own_function(model: onnx.ModelProto) -> None:
    model.opset_import.append(helper.make_opsetid("mine", 1))
    inner = helper.make_node("Relu", ["x"], ["y"])
    model.functions.append(helper.make_function("mine", "F", ["x"], ["y"], [inner], [helper.make_opsetid("", 17)]))


def wrong_size(model: onnx.ModelProto) -> None:
    model.graph.initializer[0].dims[:] = [2**31, 2**31]


def a_million_nodes(model: onnx.ModelProto) -> None:
    model.graph.node.extend(helper.make_node("Relu", ["told"], [f"r{i}"]) for i in range(5_000))


ATTACKS = {
    "loop": (a_loop(), "operator: is 'Loop'"),
    "if": (an_if(), "operator: is 'If'"),
    "graph in an operator": (a_graph_in_an_allowed_operator(), "without a graph inside"),
    "memory": (memory([2**20, 2**12]), r"ConstantOfShape huge: is '4,294,967,296 values'"),
    "negative memory": (memory([-(2**20), -(2**12)]), "values|ONNX model"),
    "doubling": (doubling(), "Concat"),
    "outer product": (outer_product(), "MatMul square"),
    "unknown size": (unknown_size(), "not known beforehand"),
    "NaN": (weight_of(float("nan")), "finite numbers"),
    "infinity": (weight_of(float("inf")), "finite numbers"),
    "external": (outside, "weights in the file itself"),
    "function": (own_function, "standard operators"),
    "wrong size": (wrong_size, "a size that fits the file"),
    "nodes": (a_million_nodes, "nodes"),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_graph_that_is_no_plain_network_is_refused(good: bytes, attack: str) -> None:
    change, told = ATTACKS[attack]
    with pytest.raises(ModelError, match=told) as refused:
        check_graph(altered(good, change), "offered.onnx")
    assert str(refused.value).startswith("offered.onnx")
    assert "\n" not in str(refused.value)


def test_the_shipped_policies_are_plain_networks() -> None:
    for name in ("generalist", "obstacles", "energy"):
        check_graph(Policy.builtin(name).content, name)


def test_another_process_meets_it_first(good: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = []
    monkeypatch.setattr("onnxruntime.InferenceSession", lambda *_, **__: loaded.append(1))
    with pytest.raises(ModelError, match=r"offered\.onnx: operator: is 'Loop'"):
        Policy.load(altered(good, a_loop()), "offered.onnx")
    assert not loaded


def test_a_process_that_ends_is_told(good: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    trial.end()
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(ModelError, match="a process that tried it ended with status 1"):
        require_harmless(good + b"\0", "offered.onnx")


def test_a_network_that_fails_on_more_than_one_is_refused(good: bytes) -> None:
    one_only = before_the_output(
        helper.make_node("Reshape", ["told", "size"], ["logits"]), weights={"size": np.array([1, 9], np.int64)}
    )
    with pytest.raises(ModelError, match="offered"):
        Policy.load(altered(good, one_only), "offered")


def test_what_is_not_a_number_is_no_decision(good: bytes) -> None:
    nodes = [helper.make_node("Sub", ["told", "big"], ["less"]), helper.make_node("Log", ["less"], ["logits"])]
    root = before_the_output(*nodes, weights={"big": np.float32(1e6)})
    with pytest.raises(ModelError, match=r"offered: output: is 'not a number'"):
        Policy.load(altered(good, root), "offered")


def test_a_policy_that_fails_later_is_told_in_one_line() -> None:
    policy = Policy.builtin("generalist")
    with pytest.raises(ModelError, match="built-in policy generalist") as refused:
        policy.decide(np.full((1, len(policy.card.maps), policy.n, policy.n + 1), 0, dtype=np.float32))
    assert "\n" not in str(refused.value)
    with pytest.raises(ModelError, match="not a number"):
        policy.decide(np.full((1, len(policy.card.maps), policy.n, policy.n), np.nan, dtype=np.float32))


def test_a_policy_that_takes_too_long_to_decide_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """It loads, and ends: but a UAV has a step's time."""
    trial.require_prompt(Policy.builtin("generalist"))
    monkeypatch.setattr(trial, "DECISION", 0.0)
    with pytest.raises(ModelError, match="processor time"):
        trial.require_prompt(Policy.builtin("generalist"))


def test_a_policy_that_fails_on_other_maps_than_empty_ones_is_refused(good: bytes) -> None:
    nodes = [
        helper.make_node("ReduceMax", [onnx.ModelProto.FromString(good).graph.input[0].name], ["most"], keepdims=0),
        helper.make_node("Mul", ["most", "big"], ["huge"]),
        helper.make_node("Exp", ["huge"], ["endless"]),
        helper.make_node("Add", ["told", "endless"], ["logits"]),
    ]
    with pytest.raises(ModelError, match="not a number"):
        Policy.load(altered(good, before_the_output(*nodes, weights={"big": np.float32(1e4)})), "offered")


def test_nothing_is_imported_from_the_folder_that_one_stands_in(
    good: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "onnx.py").write_text(f"open({str(tmp_path / 'owned')!r}, 'w').close()")
    monkeypatch.chdir(tmp_path)
    trial.end()
    require_harmless(altered(good, lambda model: setattr(model, "doc_string", "another")), "offered")
    assert not (tmp_path / "owned").exists()
