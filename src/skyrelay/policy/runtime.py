"""What flies: loads an ONNX policy, checks it and its card, and decides."""

from __future__ import annotations

import difflib
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnxruntime
from pydantic import ValidationError

from skyrelay.airspace.flight import ACTIONS
from skyrelay.airspace.observation import Observer
from skyrelay.core.errors import ModelError
from skyrelay.core.untrusted import parse_json
from skyrelay.policy.card import CARD_KEY, Card
from skyrelay.policy.trial import require_harmless, trust

MAX_CARD_BYTES = 2**20
MAX_BYTES = 64 * 2**20
"""Larger files are refused before they are parsed."""


class Policy:
    """A trained policy on onnxruntime, one thread.

    Attributes:
        card: the model card from inside the file.
        content: the file's bytes, as they are stored and addressed.
    """

    def __init__(self, content: bytes, place: str) -> None:
        if not 0 < len(content) <= MAX_BYTES:
            raise ModelError(place, f"{len(content)} bytes", f"a policy of 1 to {MAX_BYTES} bytes")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime raises a class of its own for each fault, with no common base
            reason = str(error).splitlines()[0][:160]
            raise ModelError(
                place, None, f"an ONNX model that onnxruntime {onnxruntime.__version__} runs ({reason})"
            ) from error
        self.card = _card(session, place)
        self.content = content
        self._place = place
        self._session = session
        _check(session, self.card, place)
        for batch in (1, 3):
            self.decide(np.zeros((batch, len(self.card.maps), self.card.n, self.card.n), dtype=np.float32))

    @classmethod
    def load(cls, source: str | Path | bytes, place: str | None = None) -> Policy:
        """Read and check a policy.

        Args:
            source: path of an ONNX file, or its bytes.
            place: what an error calls it; the path where left out.
        Raises:
            ModelError: it cannot be read, is no ONNX model, has no valid card, or its input and output do not fit.
        """
        if isinstance(source, bytes):
            return cls._tried(source, place or "policy")
        path = Path(source)
        try:
            with path.open("rb") as file:
                content = file.read(MAX_BYTES + 1)
        except (OSError, ValueError) as error:  # ValueError: a NUL in the name
            reason = error.strerror if isinstance(error, OSError) else error
            raise ModelError(place or path, None, f"a readable ONNX file ({reason})") from error
        return cls._tried(content, place or str(path))

    @classmethod
    def _tried(cls, content: bytes, place: str) -> Policy:
        """Load what another process has loaded and run unharmed."""
        if not 0 < len(content) <= MAX_BYTES:
            raise ModelError(place, f"{len(content)} bytes", f"a policy of 1 to {MAX_BYTES} bytes")
        _trust_own()
        require_harmless(content, place)
        return cls(content, place)

    @classmethod
    def builtin(cls, name: str) -> Policy:
        """A policy that ships with the package.

        Raises:
            ModelError: there is none of that name.
        """
        if name not in builtin_policies():
            raise ModelError("policy", name, f"one of: {', '.join(builtin_policies())}")
        return cls((files("skyrelay.data") / "policies" / f"{name}.onnx").read_bytes(), f"built-in policy {name}")

    @classmethod
    def named(cls, model: str) -> Policy:
        """A file's policy, or where there is no such file the shipped one of that name.

        Raises:
            ModelError: it is neither; a name that nearly fits is suggested.
        """
        shipped = builtin_policies()
        if model in shipped and not Path(model).exists():
            return cls.builtin(model)
        if cls.is_named(model):
            return cls.load(model)
        close = difflib.get_close_matches(model, shipped, n=1)
        known = f"did you mean {close[0]!r}?" if close else f"one of {', '.join(shipped)}"
        raise ModelError("policy", model, f"an ONNX file's path or a shipped policy's name: {known}")

    @staticmethod
    def is_named(model: str) -> bool:
        """Whether it is a shipped policy's name, or can only be a file's path."""
        path = Path(model)
        if model in builtin_policies():
            return True
        if ":" in model and not path.exists():
            return False  # module:attribute
        return bool(path.suffix) or path.name != model or len(model) > 80 or path.exists()

    @property
    def n(self) -> int:
        """Side of the maps it looks at [cells]."""
        return self.card.n

    @property
    def zoom(self) -> int:
        """Of the full maps over n."""
        return self.card.zoom

    @property
    def observer(self) -> Observer:
        """Draws the maps that it looks at."""
        return Observer(self.card.maps, self.card.n, self.card.zoom)

    def logits(self, maps: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """[batch, 9] the network's outputs for maps [batch, maps, n, n]."""
        try:
            result: npt.NDArray[np.float32] = self._session.run(None, {self._session.get_inputs()[0].name: maps})[0]
        except Exception as error:  # as above
            reason = (str(error).splitlines() or [type(error).__name__])[0][:160]
            raise ModelError(self._place, None, f"a network that decides on {list(maps.shape)} ({reason})") from error
        if result.shape != (len(maps), ACTIONS) or not np.isfinite(result).all():
            found = "not a number" if result.shape == (len(maps), ACTIONS) else f"of shape {list(result.shape)}"
            raise ModelError(f"{self._place}: output", found, f"[{len(maps)}, {ACTIONS}] finite values")
        return result

    def decide(self, maps: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The most valued action of each UAV.

        Args:
            maps: [batch, maps, n, n] from its `observer`.
        Returns: [batch] actions 0..8.
        """
        actions: npt.NDArray[np.int64] = self.logits(maps).argmax(axis=1)
        return actions


@lru_cache(maxsize=1)
def _trust_own() -> None:
    """The policies of the package need no trial."""
    for name in builtin_policies():
        trust((files("skyrelay.data") / "policies" / f"{name}.onnx").read_bytes())


def builtin_policies() -> list[str]:
    """Names of the policies inside the package."""
    folder = files("skyrelay.data") / "policies"
    return sorted(Path(item.name).stem for item in folder.iterdir() if item.name.endswith(".onnx"))


def _card(session: onnxruntime.InferenceSession, place: str) -> Card:
    text = session.get_modelmeta().custom_metadata_map.get(CARD_KEY)
    if text is None:
        raise ModelError(place, None, f"a model card in the metadata entry {CARD_KEY!r}")
    try:
        parse_json(text, size=MAX_CARD_BYTES)
    except ValueError as error:
        raise ModelError(f"{place}: card", None, f"JSON ({error})") from None
    try:
        return Card.model_validate_json(text)
    except ValidationError as error:
        raise card_error(error, f"{place}: card") from None


def card_error(error: ValidationError, place: str) -> ModelError:
    """What is wrong with a card: all fields that are missing at once, or else the first that does not fit."""
    lacking = [".".join(map(str, fault["loc"])) for fault in error.errors() if fault["type"] == "missing"]
    if lacking:
        return ModelError(place, f"without {', '.join(lacking)}", "every field of docs/reference/policies.md")
    fault = error.errors()[0]
    key = ".".join(map(str, fault["loc"]))
    return ModelError(f"{place}: {key}", fault["input"], fault["msg"].removeprefix("Input should be "))


def _check(session: onnxruntime.InferenceSession, card: Card, place: str) -> None:
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if len(inputs) != 1 or len(outputs) != 1:
        raise ModelError(place, f"{len(inputs)} and {len(outputs)}", "one input and one output")
    shape, maps = list(inputs[0].shape), len(card.maps)
    if len(shape) != 4 or isinstance(shape[0], int) or shape[1:] != [maps, card.n, card.n]:
        raise ModelError(f"{place}: input", shape, f"[batch, {maps}, {card.n}, {card.n}], as the card says")
    if inputs[0].type != "tensor(float)":
        raise ModelError(f"{place}: input", inputs[0].type, "tensor(float)")
    if len(outputs[0].shape) != 2 or outputs[0].shape[1] != ACTIONS:
        raise ModelError(f"{place}: output", list(outputs[0].shape), f"[batch, {ACTIONS}]")
