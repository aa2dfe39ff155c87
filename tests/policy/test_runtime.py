"""What a UAV refuses to fly, and the policies that ship with the package."""

from __future__ import annotations

import json

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from skyrelay.airspace.maps import ENERGY_MAPS, PAPER_MAPS
from skyrelay.core.errors import ModelError
from skyrelay.policy import Policy, builtin_policies
from skyrelay.policy.card import CARD_KEY


def content_of(name):
    return Policy.builtin(name).content


@pytest.fixture(scope="module")
def good():
    return onnx.load_from_string(content_of("generalist"))


def altered(model, change):
    copy = onnx.ModelProto()
    copy.CopyFrom(model)
    change(copy)
    return copy.SerializeToString()


def with_card(**changes):
    def change(model):
        entry = next(prop for prop in model.metadata_props if prop.key == CARD_KEY)
        entry.value = json.dumps({**json.loads(entry.value), **changes})

    return change


def without_card(model):
    del model.metadata_props[:]


def wrong_outputs(model):
    last = model.graph.node[-1]
    extra = numpy_helper.from_array(np.zeros((9, 4), np.float32), "cut")
    model.graph.initializer.append(extra)
    last.output[0] = "nine"
    model.graph.node.append(helper.make_node("MatMul", ["nine", "cut"], ["logits"]))
    del model.graph.output[:]
    model.graph.output.append(helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["batch", 4]))


def future_opset(model):
    model.opset_import[0].version = 999


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (without_card, "model card"),
        (with_card(n=9), r"input: is .*expected \[batch, 9, 9, 9\]"),
        (with_card(n=1_000_000), "card: n"),
        (with_card(uavs=[0, 3]), "card: uavs"),
        (with_card(surprise=1), "card: surprise"),
        (with_card(maps=[*PAPER_MAPS, *ENERGY_MAPS]), r"input: is .*expected \[batch, 10, 11, 11\]"),
        (with_card(maps=["local_location"]), "card: maps"),
        (wrong_outputs, r"output.*\[batch, 9\]"),
        (future_opset, "onnxruntime"),
    ],
)
def test_what_does_not_fit_is_refused(good, change, fault):
    with pytest.raises(ModelError, match=fault) as error:
        Policy.load(altered(good, change), "offered.onnx")
    assert str(error.value).startswith("offered.onnx")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"\x80\x04nonsense", b"PK\x03\x04"])
def test_what_is_no_model_is_refused(content):
    with pytest.raises(ModelError):
        Policy.load(content)


def test_every_cut_of_a_file_is_refused(good):
    whole = good.SerializeToString()
    for share in (0.1, 0.5, 0.9, 0.999):
        with pytest.raises(ModelError):
            Policy.load(whole[: int(len(whole) * share)])


def test_a_missing_file(tmp_path):
    with pytest.raises(ModelError, match="readable ONNX file"):
        Policy.load(tmp_path / "none.onnx")
    with pytest.raises(ModelError, match="one of"):
        Policy.builtin("none")


@pytest.mark.parametrize("name", builtin_policies())
def test_a_shipped_policy_says_how_it_was_made_and_decides(name):
    policy = Policy.builtin(name)
    assert policy.card.name == name
    assert policy.card.command.startswith("skyrelay train ")
    assert policy.card.evaluation
    maps = np.random.default_rng(0).uniform(0, 1, (40, len(policy.card.maps), policy.n, policy.n)).astype(np.float32)
    actions = policy.decide(maps)
    assert actions.shape == (40,)
    assert ((actions >= 0) & (actions < 9)).all()
    np.testing.assert_array_equal(actions[:1], policy.decide(maps[:1]))
