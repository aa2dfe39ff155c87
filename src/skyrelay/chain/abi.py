"""The compiled contract: its functions, events and errors, encoded and decoded by its ABI."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.resources import files
from typing import Any

from eth_abi.abi import decode
from eth_abi.encoding import TupleEncoder
from eth_abi.exceptions import DecodingError, EncodingError
from eth_abi.registry import registry
from eth_hash.auto import keccak

from skyrelay.chain.chain import LogEntry
from skyrelay.core.errors import ChainError

_UNDECODABLE = (DecodingError, OverflowError, ValueError)
"""What decoding raises; the second where data announces more than any memory holds."""
_STANDARD_ERRORS = {
    bytes.fromhex("08c379a0"): ("Error", ["string"], ["reason"]),
    bytes.fromhex("4e487b71"): ("Panic", ["uint256"], ["code"]),
}


class ContractError(ChainError):
    """The contract refused a transaction or a question.

    Attributes:
        function: that was called.
        error: name of the contract's error, or why execution halted.
        arguments: of the error.
    """

    def __init__(self, function: str, error: str, arguments: Mapping[str, Any]) -> None:
        self.function = function
        self.error = error
        self.arguments = dict(arguments)
        shown = ", ".join(f"{name}={value}" for name, value in self.arguments.items())
        super().__init__(f"contract: {function}", f"{error}({shown})", "a call that the contract accepts")


_PACKED: dict[str, tuple[tuple[str, int, bool], ...]] = {
    "Terms": (
        ("x", 32, True),
        ("y", 32, True),
        ("payment", 32, False),
        ("demand", 32, False),
        ("uavX", 32, True),
        ("uavY", 32, True),
        ("reputation", 16, False),
    ),
    "Place": (
        ("qov", 64, False),
        ("score", 64, False),
        ("session", 32, False),
        ("index", 16, False),
        ("round", 32, False),
    ),
}
"""The contract's packed words in events, by type: name, bits and sign of each field, from the first bit on."""


@dataclass(frozen=True, slots=True)
class Event:
    """A decoded log of the contract; addresses as text, bytes32 as ``0x`` text."""

    name: str
    args: Mapping[str, Any]
    block: int
    transaction: int
    index: int


class _Codec:
    """Encodes and decodes a list of ABI parameters."""

    def __init__(self, parameters: Sequence[Mapping[str, Any]]) -> None:
        self.parameters = parameters
        self.types = [_type(p) for p in parameters]
        self._encoder = TupleEncoder(  # type: ignore[no-untyped-call]
            encoders=[registry.get_encoder(t) for t in self.types]
        )

    def encode(self, arguments: Sequence[Any]) -> bytes:
        return bytes(self._encoder(arguments))

    def decode(self, data: bytes) -> list[Any]:
        values = decode(self.types, data)
        return [_plain(parameter, value) for parameter, value in zip(self.parameters, values, strict=True)]


class Function:
    """A function of the contract."""

    def __init__(self, entry: Mapping[str, Any]) -> None:
        self.name: str = entry["name"]
        self._inputs = _Codec(entry["inputs"])
        self._outputs = _Codec(entry["outputs"])
        self.selector = keccak(f"{self.name}({','.join(self._inputs.types)})".encode())[:4]

    def encode(self, *arguments: Any) -> bytes:
        """Call data.

        Raises:
            ChainError: an argument does not fit its type.
        """
        try:
            return self.selector + self._inputs.encode(arguments)
        except (EncodingError, TypeError, ValueError) as error:
            raise ChainError(f"contract: {self.name}", arguments, f"arguments that fit {self._inputs.types}") from error

    def decode_output(self, output: bytes) -> list[Any]:
        """Return values.

        Raises:
            ChainError: the output is none of this function.
        """
        try:
            return self._outputs.decode(output)
        except _UNDECODABLE as error:
            raise ChainError(f"contract: {self.name}", output.hex(), f"values of {self._outputs.types}") from error

    def decode_arguments(self, data: bytes) -> dict[str, Any]:
        """The arguments of a call, by name."""
        values = self._inputs.decode(data[4:])
        return {p["name"]: value for p, value in zip(self._inputs.parameters, values, strict=True)}


class _EventType:
    """How one event is logged."""

    def __init__(self, entry: Mapping[str, Any]) -> None:
        self.name: str = entry["name"]
        inputs = entry["inputs"]
        self.topic = keccak(f"{self.name}({','.join(_type(p) for p in inputs)})".encode())
        self._names = [p["name"] for p in inputs]
        self._packed = {p["name"]: _PACKED[p["internalType"]] for p in inputs if p["internalType"] in _PACKED}
        self._indexed = [p for p in inputs if p["indexed"]]
        self._data = _Codec([p for p in inputs if not p["indexed"]])

    def decode(self, entry: LogEntry) -> dict[str, Any]:
        values = {}
        for parameter, topic in zip(self._indexed, entry.topics[1:], strict=True):
            values[parameter["name"]] = _plain(parameter, decode([parameter["type"]], topic)[0])
        for parameter, value in zip(self._data.parameters, self._data.decode(entry.data), strict=True):
            values[parameter["name"]] = value
        ordered: dict[str, Any] = {}
        for name in self._names:
            if name in self._packed:
                ordered |= _unpacked(self._packed[name], values[name])
            else:
                ordered[name] = values[name]
        return ordered


class Contract:
    """SkyRelay's compiled contract."""

    def __init__(self, artifact: Mapping[str, Any]) -> None:
        self._artifact = artifact
        self.functions = {e["name"]: Function(e) for e in artifact["abi"] if e["type"] == "function"}
        self._selectors = {f.selector: f for f in self.functions.values()}
        self._events = {e.topic: e for e in map(_EventType, (e for e in artifact["abi"] if e["type"] == "event"))}
        self._errors = dict(_STANDARD_ERRORS)
        for entry in artifact["abi"]:
            if entry["type"] == "error":
                types, names = [_type(p) for p in entry["inputs"]], [p["name"] for p in entry["inputs"]]
                selector = keccak(f"{entry['name']}({','.join(types)})".encode())[:4]
                self._errors[selector] = (entry["name"], types, names)
        constructors = [e["inputs"] for e in artifact["abi"] if e["type"] == "constructor"]
        self._constructor = _Codec(constructors[0] if constructors else [])

    @cached_property
    def bytecode(self) -> bytes:
        """What creates the contract, before the constructor's arguments."""
        return bytes.fromhex(self._artifact["bytecode"].removeprefix("0x"))

    def creation(self, *arguments: Any) -> bytes:
        """What creates the contract with these arguments."""
        return self.bytecode + self._constructor.encode(arguments)

    def creation_arguments(self, data: bytes) -> dict[str, Any] | None:
        """What the constructor is given by an input that creates this contract; None where it creates another."""
        if not data.startswith(self.bytecode):
            return None
        given = data[len(self.bytecode) :]
        try:
            values = decode(self._constructor.types, given)
            if self._constructor.encode(values) != given:
                return None
        except (*_UNDECODABLE, EncodingError):
            return None
        return {p["name"]: value for p, value in zip(self._constructor.parameters, values, strict=True)}

    def function_of(self, data: bytes) -> Function | None:
        """The function that call data is for."""
        return self._selectors.get(data[:4])

    def event(self, entry: LogEntry) -> Event:
        """A decoded log.

        Raises:
            ChainError: the log is none of the contract's events.
        """
        kind = self._events.get(entry.topics[0]) if entry.topics else None
        place = f"block {entry.block}, log {entry.index}"
        if kind is None:
            raise ChainError(place, entry.topics[0].hex() if entry.topics else None, "an event of the contract")
        try:
            return Event(kind.name, kind.decode(entry), entry.block, entry.transaction, entry.index)
        except _UNDECODABLE as error:
            raise ChainError(place, entry.data.hex(), f"the arguments of {kind.name}") from error

    def topic(self, event: str) -> bytes:
        """First topic of an event."""
        return next(topic for topic, kind in self._events.items() if kind.name == event)

    def error(self, function: str, output: bytes, halt: str | None) -> ContractError:
        """The error behind a failed call: its revert data decoded, or why it halted."""
        if halt is not None:
            return ContractError(function, halt, {})
        known = self._errors.get(output[:4])
        if known is None:
            return ContractError(function, f"an unknown error 0x{output.hex()}" if output else "no reason given", {})
        name, types, names = known
        try:
            values = decode(types, output[4:])
        except _UNDECODABLE:
            return ContractError(function, name, {"data": "0x" + output[4:].hex()})
        return ContractError(
            function,
            name,
            {n: _plain({"type": t}, value) for n, t, value in zip(names, types, values, strict=True)},
        )


@lru_cache(maxsize=1)
def contract() -> Contract:
    """The compiled contract that the package carries; its ABI includes the extension's."""
    return _compiled("SkyRelay")


@lru_cache(maxsize=1)
def extension() -> Contract:
    """The compiled extension, which the contract passes calls on to (docs/decisions/0010-contract-two-parts.md)."""
    return _compiled("SkyRelayExtension")


@lru_cache(maxsize=1)
def optimistic_selection() -> Contract:
    """The compiled contract that takes claims of selections (docs/decisions/0081-optimistic-selection.md)."""
    return _compiled("OptimisticSelection")


@lru_cache(maxsize=1)
def payments() -> Contract:
    """The compiled contract for payments, beside SkyRelay."""
    return _compiled("SkyRelayPayments")


@lru_cache(maxsize=1)
def credit() -> Contract:
    """The compiled token of a consortium without money of its own."""
    return _compiled("Credit")


def _compiled(name: str) -> Contract:
    text = (files("skyrelay.chain") / "artifacts" / f"{name}.json").read_text("utf-8")
    return Contract(json.loads(text))


def _type(parameter: Mapping[str, Any]) -> str:
    kind: str = parameter["type"]
    if not kind.startswith("tuple"):
        return kind
    return f"({','.join(_type(p) for p in parameter['components'])}){kind[5:]}"


def _unpacked(fields: Sequence[tuple[str, int, bool]], word: int) -> dict[str, int]:
    values = {}
    for name, bits, signed in fields:
        value = word & ((1 << bits) - 1)
        values[name] = value - (1 << bits) if signed and value >> (bits - 1) else value
        word >>= bits
    return values


def _plain(parameter: Mapping[str, Any], value: Any) -> Any:
    """Tuples as dictionaries, bytes as ``0x`` text."""
    kind: str = parameter["type"]
    if kind.endswith("]"):
        element = {**parameter, "type": kind[: kind.rindex("[")]}
        return [_plain(element, item) for item in value]
    if kind == "tuple":
        return {p["name"]: _plain(p, item) for p, item in zip(parameter["components"], value, strict=True)}
    if isinstance(value, bytes):
        return "0x" + value.hex()
    return value
