"""The audit from Python: a run whose table is changed by one digit afterwards is found out, with the place.

python examples/audit_as_library.py --out out/audited
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

import skyrelay as sr
from skyrelay.audit import audit_folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/audited"))
    parser.add_argument("--steps", type=int, default=40)
    arguments = parser.parse_args()
    settings = {"fleet.uavs": 18, "coordination.steps": arguments.steps}
    sr.run("bologna", out=arguments.out, settings=settings, force=True)
    report = audit_folder(arguments.out)
    print(f"as it was played: {len(report.differences)} differences")

    path = arguments.out / "proposals.parquet"
    table = pq.read_table(path)
    marks = table["qou"].to_pylist()
    marks[0] += 1.0
    pq.write_table(table.set_column(table.schema.get_field_index("qou"), "qou", pa.array(marks)), path)
    differences = audit_folder(arguments.out).differences
    print(f"with one QoU changed: {len(differences)} differences")
    for difference in differences[:3]:
        print(" ", difference)


if __name__ == "__main__":
    main()
