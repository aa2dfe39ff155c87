"""What every model store does, wherever its bytes lie."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from skyrelay.store.cid import Cid

MAX_MODEL_BYTES = 1 << 30
"""No model is larger than this [bytes]: a store that keeps sending is cut off here."""


MAX_IN_MEMORY = 64 << 20
"""What `ModelStore.get` hands out at most where the caller names no other limit [bytes]."""


@dataclass(frozen=True, order=True, slots=True)
class StoredModel:
    """One model that a store keeps.

    Attributes:
        cid: its address.
        size: its length [bytes].
    """

    cid: Cid
    size: int


@runtime_checkable
class ModelStore(Protocol):
    """Models by content address. Whatever comes back has been hashed again; a store cannot answer with another file.

    Every method raises StoreError, which names the store, what it answered, and what to do.
    """

    @property
    def place(self) -> str:
        """The store's name in messages: a folder or an address."""

    def put(self, source: Path | bytes) -> Cid:
        """Keep a model and return its address; to keep it twice is to keep it once."""

    def get(self, cid: Cid, max_bytes: int = MAX_IN_MEMORY) -> bytes:
        """The model's bytes, checked against ``cid``; a longer model is refused before it is in memory."""

    def fetch(self, cid: Cid, out: Path) -> int:
        """Write the checked model to ``out``, whole or not at all; return its length [bytes]. Memory is bounded."""

    def has(self, cid: Cid) -> bool:
        """Whether the store holds every block of the model (their content is not read: `verify` does)."""

    def verify(self, cid: Cid) -> int:
        """Read the whole model, hash it again, and return its length [bytes]."""

    def pin(self, cid: Cid) -> None:
        """Keep the model: it is whole here, and stays."""

    def models(self) -> list[StoredModel]:
        """The models kept, by address."""
