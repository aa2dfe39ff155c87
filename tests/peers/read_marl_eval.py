"""marl-eval's own reader takes the kept suite's export, and rliable's figures are ours (make test-peers).

In an environment of its own, which has these two packages and NumPy and SciPy alone.
"""

import json
from pathlib import Path

from marl_eval.utils.data_processing_utils import create_matrices_for_rliable, data_process_pipeline
from marl_eval.utils.diagnose_data_errors import DiagnoseData
from rliable import metrics

KEPT = Path(__file__).parents[2] / "results" / "suite-all-v1"
DIGITS = 1e-4
"""The export is rounded to six digits."""


def main() -> None:
    """Check, and say so."""
    told = json.loads((KEPT / "standings.json").read_text())
    exported = json.loads((KEPT / "marl-eval.json").read_text())
    (environment,) = exported
    for fault, valid in DiagnoseData(exported).check_data()[environment].items():
        assert valid, fault
    processed = data_process_pipeline(exported, ["return"])
    scores = create_matrices_for_rliable(processed, environment, ["return"])[0]["mean_score"]
    pair = 1 / told["runs"] ** 2  # rounding makes ties, each of which is half a pair of a task's runs
    checked = 0
    for method in told["methods"]:
        if not method["complete"]:
            continue
        own = scores[method["name"]]
        assert own.shape == (told["runs"], len(told["tasks"]))
        assert abs(metrics.aggregate_iqm(own) - method["iqm"]["mean"]) < DIGITS
        assert abs(metrics.aggregate_optimality_gap(own) - method["optimality_gap"]["mean"]) < DIGITS
        if "improvement" in method:
            theirs = metrics.probability_of_improvement(own, scores[told["reference"]])
            assert abs(theirs - method["improvement"]["mean"]) < pair
        checked += 1
    assert checked > 5
    print(f"marl-eval and rliable agree on {checked} methods")


if __name__ == "__main__":
    main()
