"""The audit from Python: a run whose table is changed by one digit afterwards is found out, with the place.

python examples/audit_as_library.py --out out/audited
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from skyrelay.audit import audit_folder
from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.report import write_figures, write_report
from skyrelay.runfolder import new_run_folder
from skyrelay.simulation import play


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/audited"))
    parser.add_argument("--steps", type=int, default=40)
    arguments = parser.parse_args()
    scenario = load_scenario("bologna", ["fleet.uavs=18", f"coordination.steps={arguments.steps}"])
    with new_run_folder(arguments.out, replace=True) as folder:
        play(scenario, folder, Silent(), lambda run: (write_figures(run), write_report(run)))
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
