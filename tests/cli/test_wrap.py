"""A network from elsewhere becomes a policy that flies."""

import json

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from skyrelay.core.errors import ModelError
from skyrelay.policy import Policy
from skyrelay.policy.card import CARD_KEY
from skyrelay.policy.wrap import wrap

OPTIONS = ["--name", "mine", "--uavs", "2-4", "--vehicles", "5-20", "--ratio", "2", "--uav-step", "0.05"]
OPTIONS += ["--steps", "1000", "--limits", "open ground"]


def network(maps=6, n=7, outputs=9):
    """Flatten and one layer, as any library exports it."""
    weight = numpy_helper.from_array(np.eye(maps * n * n, outputs, dtype=np.float32), "weight")
    graph = helper.make_graph(
        [
            helper.make_node("Flatten", ["maps"], ["flat"], axis=1),
            helper.make_node("MatMul", ["flat", "weight"], ["logits"]),
        ],
        "net",
        [helper.make_tensor_value_info("maps", TensorProto.FLOAT, ["batch", maps, n, n])],
        [helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["batch", outputs])],
        [weight],
    )
    opsets = [helper.make_opsetid("", 17)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=8).SerializeToString()


@pytest.fixture
def net(tmp_path):
    path = tmp_path / "net.onnx"
    path.write_bytes(network())
    return path


def test_a_wrapped_network_is_a_policy(net, tmp_path, skyrelay):
    out = tmp_path / "policy.onnx"
    ended = skyrelay("models", "wrap", net, "--out", out, *OPTIONS, "--json")
    assert ended.status == 0
    assert json.loads(ended.out)["file"] == str(out)
    policy = Policy.load(out)
    assert (policy.card.name, policy.card.uavs, policy.n) == ("mine", (2, 4), 7)
    assert policy.decide(np.zeros((2, 6, 7, 7), np.float32)).tolist() == [0, 0]
    assert skyrelay("models", "wrap", net, "--out", out, *OPTIONS).status == 2  # it is there


def test_all_that_is_missing_is_named_at_once(net, tmp_path, skyrelay):
    ended = skyrelay("models", "wrap", net, "--out", tmp_path / "policy.onnx", "--name", "mine", "--uavs", "3")
    assert ended.status == 2
    assert "without --vehicles, --ratio, --uav-step, --steps, --limits" in ended.err
    assert not (tmp_path / "policy.onnx").exists()


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (network(maps=8), "the 8 that the network looks at"),
        (network(outputs=8), "[batch, 9]"),
        (b"no network", "net.onnx"),
        (b"", "1 to"),
    ],
)
def test_a_network_that_is_no_policy(tmp_path, skyrelay, content, told):
    (tmp_path / "net.onnx").write_bytes(content)
    ended = skyrelay("models", "wrap", tmp_path / "net.onnx", "--out", tmp_path / "policy.onnx", *OPTIONS)
    assert ended.status == 2
    assert told in ended.err
    assert not (tmp_path / "policy.onnx").exists()


def test_a_card_without_fields_names_them_all():
    with pytest.raises(ModelError, match="without zoom, uavs, vehicles, ratio, uav_step, steps, limits"):
        wrap(network(), {"name": "mine"}, "net")
    model = onnx.ModelProto.FromString(network())
    model.metadata_props.add(key=CARD_KEY, value='{"name": "mine", "n": 7}')
    with pytest.raises(ModelError, match="without zoom, uavs, vehicles"):
        Policy.load(model.SerializeToString())
