"""A network of your own as a policy: here nine rows of weights written by hand, exported with its card, and flown.

It reads two of the maps that look ahead: where a move breaks no link it goes where most own vehicles would be in range.

python examples/own_onnx.py --out out/own-onnx
"""

from __future__ import annotations

import argparse
import importlib.metadata
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

import skyrelay as sr
from skyrelay.airspace.flight import unit_moves
from skyrelay.airspace.maps import OUTLOOK_MAPS, map_names
from skyrelay.policy.card import CARD_KEY, Card

N = 9  # side of a map
MAPS = map_names(obstacles=False, energy=False, outlook=True)


def weights() -> np.ndarray:
    """[maps x N x N, 9]: each move's logit is its cell of "cover nearby", and a lot for a safe move."""
    safe, cover = (MAPS.index(name) for name in OUTLOOK_MAPS)
    matrix = np.zeros((len(MAPS), N, N, 9), dtype=np.float32)
    for action, (east, north) in enumerate(np.rint(unit_moves(np)).astype(int)):
        row, column = N // 2 + north, N // 2 + east
        matrix[cover, row, column, action] = 1.0
        matrix[safe, row, column, action] = 1000.0
    matrix[cover, N // 2, N // 2, 0] += 1e-3  # of equals, stay
    return matrix.reshape(-1, 9)


def network() -> bytes:
    """The file: input `maps`, output `logits`, and the card among its metadata."""
    graph = helper.make_graph(
        [
            helper.make_node("Flatten", ["maps"], ["flat"], axis=1),
            helper.make_node("Gemm", ["flat", "weights"], ["logits"]),
        ],
        "by-hand",
        [helper.make_tensor_value_info("maps", TensorProto.FLOAT, ["batch", len(MAPS), N, N])],
        [helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["batch", 9])],
        [numpy_helper.from_array(weights(), "weights")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 9
    card = Card(
        name="by-hand",
        n=N,
        maps=MAPS,
        zoom=2,
        uavs=(1, 16),
        vehicles=(1, 255),
        ratio=(1.5, 3.0),
        uav_step=(0.01, 0.2),
        steps=1,
        seeds=[0],
        preset="none",
        command="python examples/own_onnx.py",
        versions={"onnx": importlib.metadata.version("onnx")},
        evaluation=[],
        limits="Looks one move ahead.",
    )
    helper.set_model_props(model, {CARD_KEY: card.model_dump_json()})
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/own-onnx"))
    parser.add_argument("--steps", type=int, default=100, help="of the run")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "by-hand.onnx"
    file.write_bytes(network())
    print(f"{sr.Policy.load(file).card.name}: checked, {file.stat().st_size:,} bytes")
    for policy in (str(file), "generalist"):
        folder = arguments.out / Path(policy).stem
        settings = {"coordination.steps": arguments.steps}
        summary = sr.run("bologna", out=folder, policy=policy, settings=settings, force=True).summary
        print(f"{folder.name}: coverage {summary.coverage:.3f}, connectivity {summary.connectivity:.3f}")


if __name__ == "__main__":
    main()
