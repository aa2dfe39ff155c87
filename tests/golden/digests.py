"""The default run's tables as digests, a column each: a change of structure must move none of them.

``python tests/golden/digests.py`` writes ``run.json`` anew after a change of numbers, which says so in its message.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

GOLDEN = Path(__file__).with_name("run.json")
SEEDS = (1, 2, 3)
DIGITS = 3
"""After the point; the last bits of a sum differ between processors."""


def of_column(column: pa.ChunkedArray) -> str:
    """The first half of a SHA-256 over a column's values; numbers with a fraction to `DIGITS`."""
    if pa.types.is_floating(column.type):
        values = np.round(column.to_numpy().astype(np.float64), DIGITS) + 0.0  # no minus zero
        content = values.astype("<f8").tobytes()
    else:
        content = json.dumps(column.to_pylist()).encode()
    return hashlib.sha256(content).hexdigest()[:32]


def of_run(folder: Path) -> dict[str, dict[str, str]]:
    """Table, column, digest; and the number of its rows."""
    result = {}
    for path in sorted(folder.glob("*.parquet")):
        table = pq.read_table(path)
        result[path.stem] = {"rows": str(table.num_rows)} | {
            name: of_column(table[name]) for name in table.column_names
        }
    return result


def main() -> None:
    """Play the default run with each seed and write the digests."""
    golden = {}
    with tempfile.TemporaryDirectory() as place:
        for seed in SEEDS:
            folder = Path(place) / str(seed)
            command = Path(sys.executable).with_name("skyrelay")
            subprocess.run([command, "run", "--seed", str(seed), "--out", folder], check=True)
            golden[str(seed)] = of_run(folder)
    GOLDEN.write_text(json.dumps(golden, indent=1) + "\n")


if __name__ == "__main__":
    main()
