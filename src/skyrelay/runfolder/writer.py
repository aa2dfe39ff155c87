"""Rows gathered in memory, then each table and the summary written whole."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from skyrelay.core.files import atomic_path, write_text
from skyrelay.runfolder.folder import SUMMARY
from skyrelay.runfolder.schema import OPTIONAL, SCHEMAS, Summary


class TableWriter:
    """Gathers rows in memory and writes each table whole."""

    def __init__(self) -> None:
        self._batches: dict[str, list[pa.RecordBatch]] = {name: [] for name in SCHEMAS}

    def add(self, table: str, **columns: Sequence[Any] | np.ndarray | float | str | bool) -> None:
        """Append rows; a scalar stands for all of them."""
        schema = SCHEMAS[table]
        lengths = {
            len(value)
            for value in columns.values()
            if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)
        }
        (count,) = lengths or {1}
        arrays = []
        for field in schema:
            value = columns.pop(field.name)
            if isinstance(value, np.ndarray | Sequence) and not isinstance(value, str):
                # A copy: without one Arrow keeps the array that the world goes on to change.
                held = value.copy() if isinstance(value, np.ndarray) else value
                arrays.append(pa.array(held, field.type, from_pandas=False))
            else:
                arrays.append(pa.repeat(pa.scalar(value, field.type), count))
        if columns:
            raise KeyError(f"{table} has no column {', '.join(columns)}")
        self._batches[table].append(pa.RecordBatch.from_arrays(arrays, schema=schema))

    def table(self, name: str) -> pa.Table:
        """What has been gathered of one table."""
        return pa.Table.from_batches(self._batches[name], schema=SCHEMAS[name])

    def columns(self, name: str) -> dict[str, npt.NDArray[Any]]:
        """The same as arrays."""
        table = self.table(name)
        return {column: table[column].to_numpy() for column in table.column_names}

    def write(self, folder: Path) -> None:
        """Write every table as ``<name>.parquet``; an optional one where it has rows."""
        for name in SCHEMAS:
            if name in OPTIONAL and not self._batches[name]:
                continue
            with atomic_path(folder / f"{name}.parquet") as beside:
                # The checksums let the audit tell a damaged page from a changed one.
                pq.write_table(self.table(name), beside, compression="zstd", write_page_checksum=True)


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write ``summary.json``, with the keys of `Summary` in their order.

    Raises:
        pydantic.ValidationError: a key is missing or its value does not fit: a fault of the caller's.
    """
    checked = Summary.model_validate(dict(summary)).model_dump(mode="json")
    write_text(folder / SUMMARY, json.dumps(checked, indent=2) + "\n")
