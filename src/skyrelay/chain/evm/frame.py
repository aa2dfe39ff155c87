"""One call or creation under way, and how it ends."""

from __future__ import annotations

from skyrelay.chain.evm.state import Code, Transaction

STOPPED, REVERTED = -1, -2
"""What a trace returns in place of the next program counter when the frame ends."""


class Halt(Exception):  # noqa: N818  (the yellow paper's term: exceptional halting)
    """The frame ends exceptionally: its gas is spent and its changes are undone."""


class Frame:
    """One call or creation: its gas, memory and surroundings."""

    __slots__ = (
        "address",
        "caller",
        "code",
        "data",
        "depth",
        "gas",
        "mem",
        "originals",
        "output",
        "returned",
        "static",
        "storage",
        "tx",
        "value",
        "warm",
    )

    def __init__(
        self,
        tx: Transaction,
        code: Code,
        *,
        address: int,
        caller: int,
        value: int,
        data: bytes,
        gas: int,
        depth: int,
        static: bool,
    ) -> None:
        self.tx = tx
        self.code = code
        self.address = address
        self.caller = caller
        self.value = value
        self.data = data
        self.gas = gas
        self.depth = depth
        self.static = static
        self.mem = bytearray()
        self.returned = b""
        self.output = b""
        self.storage = tx.state.storage.setdefault(address, {})
        self.warm = tx.warm_slots.setdefault(address, {})
        self.originals = tx.originals.setdefault(address, {})
