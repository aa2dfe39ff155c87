"""Several stores as one: what one of them refuses, the next is asked for."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from skyrelay.core.errors import StoreError, UsageError
from skyrelay.store.cid import Cid
from skyrelay.store.kubo import KuboStore
from skyrelay.store.local import LocalStore
from skyrelay.store.model_store import MAX_IN_MEMORY, ModelStore, StoredModel

T = TypeVar("T")


def open_store(address: str | Path) -> ModelStore:
    """The store at ``address``: a Kubo RPC endpoint for ``http://...`` and ``https://...``, else a folder.

    Raises: StoreError: an address with ``://`` that is no HTTP address.
    """
    return KuboStore(address) if isinstance(address, str) and "://" in address else LocalStore(Path(address))


class FallbackStore:
    """Stores in the order in which they are asked.

    Args:
        stores: at least one.
        notice: told of each refusal that another store made good for, so that nothing fails in silence.
    Raises: UsageError: no store.
    """

    def __init__(self, stores: Sequence[ModelStore], notice: Callable[[StoreError], None]) -> None:
        if not stores:
            raise UsageError("stores", None, "at least one model store")
        self._stores = tuple(stores)
        self._notice = notice

    @property
    def place(self) -> str:
        """The stores' names."""
        return ", ".join(store.place for store in self._stores)

    def put(self, source: Path | bytes) -> Cid:
        """Keep a model in every store.

        Raises: StoreError: a store refused; the others, asked all the same, may hold the model.
        """
        refusals: list[StoreError] = []
        cids = []
        for store in self._stores:
            try:
                cids.append(store.put(source))
            except StoreError as error:
                refusals.append(error)
        if refusals:
            kept = f"kept by {len(cids)} of {len(self._stores)} stores"
            raise StoreError("model", kept, f"every store to keep it ({_reasons(refusals)})")
        return cids[0]

    def get(self, cid: Cid, max_bytes: int = MAX_IN_MEMORY) -> bytes:
        """The model's bytes, from the first store that has them.

        Raises: StoreError: every store refused; each with its reason.
        """
        return self._first(cid, lambda store: store.get(cid, max_bytes))

    def fetch(self, cid: Cid, out: Path) -> int:
        """Write the model to ``out`` from the first store that has it; return its length [bytes].

        Raises: StoreError: every store refused; each with its reason.
        """
        return self._first(cid, lambda store: store.fetch(cid, out))

    def has(self, cid: Cid) -> bool:
        """Whether any store holds the model; one that does not answer counts as one that does not.

        Raises: StoreError: no store answered.
        """
        return any(self._each(lambda store: store.has(cid)))

    def verify(self, cid: Cid) -> int:
        """Read the model from the first store that has it whole; return its length [bytes].

        Raises: StoreError: every store refused; each with its reason.
        """
        return self._first(cid, lambda store: store.verify(cid))

    def pin(self, cid: Cid) -> None:
        """Keep the model in the first store: from what it holds or finds, else from the next stores.

        Raises: StoreError: every store refused; each with its reason.
        """
        first = self._stores[0]

        def keep(store: ModelStore) -> None:
            if store is first:
                store.pin(cid)
            else:
                with tempfile.TemporaryDirectory(prefix="skyrelay-") as folder:
                    store.fetch(cid, copy := Path(folder) / "model")
                    first.put(copy)

        self._first(cid, keep)

    def models(self) -> list[StoredModel]:
        """The models of all stores that answer, by address.

        Raises: StoreError: no store answered.
        """
        return sorted({model for models in self._each(lambda store: store.models()) for model in models})

    def _first(self, cid: Cid, ask: Callable[[ModelStore], T]) -> T:
        refusals: list[StoreError] = []
        for store in self._stores:
            try:
                result = ask(store)
            except StoreError as error:
                refusals.append(error)
                continue
            for refusal in refusals:
                self._notice(refusal)
            return result
        if len(refusals) == 1:
            raise refusals[0]
        told = f"refused by all {len(refusals)} stores"
        raise StoreError(f"model {cid}", told, f"a store that holds it ({_reasons(refusals)})")

    def _each(self, ask: Callable[[ModelStore], T]) -> list[T]:
        refusals: list[StoreError] = []
        results = []
        for store in self._stores:
            try:
                results.append(ask(store))
            except StoreError as error:
                refusals.append(error)
        if not results:
            raise refusals[0]
        for refusal in refusals:
            self._notice(refusal)
        return results


def _reasons(refusals: Sequence[StoreError]) -> str:
    return "; ".join(str(refusal) for refusal in refusals)
