"""A network from elsewhere becomes a policy: its model card goes into the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import onnx
from pydantic import ValidationError

from skyrelay.airspace.maps import map_names
from skyrelay.core.errors import ModelError
from skyrelay.policy.card import CARD_KEY, Card
from skyrelay.policy.graph import check_graph
from skyrelay.policy.runtime import MAX_BYTES, Policy, card_error

OPTIONS = ("obstacles", "energy", "range", "outlook")
"""Of games, each of which adds maps to the six."""


def shape_of(content: bytes, place: str) -> tuple[int, int]:
    """How many maps a network looks at, and their side [cells].

    Raises:
        ModelError: it is no ONNX model that a policy can be, or its input is not [batch, maps, n, n].
    """
    if not 0 < len(content) <= MAX_BYTES:
        raise ModelError(place, f"{len(content)} bytes", f"a network of 1 to {MAX_BYTES} bytes")
    check_graph(content, place)
    inputs = onnx.load_from_string(content).graph.input
    sides = [dimension.dim_value for dimension in inputs[0].type.tensor_type.shape.dim] if len(inputs) == 1 else []
    if len(sides) != 4 or sides[0] or sides[2] != sides[3]:
        raise ModelError(f"{place}: input", sides, "one input [batch, maps, n, n] with an open batch")
    return sides[1], sides[2]


def maps_of(options: Sequence[str], count: int) -> tuple[str, ...]:
    """Names of the maps of games with some options.

    Raises:
        ModelError: there is no such option, or they are not as many as the network looks at.
    """
    for option in options:
        if option not in OPTIONS:
            raise ModelError("--maps", option, f"some of: {', '.join(OPTIONS)}")
    names = map_names(
        obstacles="obstacles" in options,
        energy="energy" in options,
        tells_range="range" in options,
        outlook="outlook" in options,
    )
    if len(names) != count:
        told = f"{len(names)} maps ({', '.join(names)})"
        raise ModelError("--maps", told, f"the {count} that the network looks at: name its options of {OPTIONS}")
    return names


def wrap(content: bytes, fields: Mapping[str, Any], place: str) -> bytes:
    """The network with its card inside, tried as every policy is.

    Args:
        fields: of the `Card`; ``n`` is the network's, and what tells only of a training here may be left out.
    Raises:
        ModelError: naming all fields that are missing, or the first that does not fit; or the network is no policy.
    """
    _, side = shape_of(content, place)
    own = {"preset": "own", "command": "skyrelay models wrap", "seeds": [], "evaluation": []}
    made = own | {"versions": {"onnx": version("onnx")}} | dict(fields) | {"n": side}
    try:
        card = Card.model_validate(made)
    except ValidationError as error:
        raise card_error(error, f"{place}: card") from None
    model = onnx.load_from_string(content)
    kept = [entry for entry in model.metadata_props if entry.key != CARD_KEY]
    del model.metadata_props[:]
    model.metadata_props.extend(kept)
    model.metadata_props.add(key=CARD_KEY, value=card.model_dump_json())
    wrapped: bytes = model.SerializeToString()
    Policy.load(wrapped, place)
    return wrapped
