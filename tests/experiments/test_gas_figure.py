"""The cost table: every function of the paper's is there, and the verdict follows the dearest case."""

import csv

from skyrelay.experiments.claims import CLAIMS
from skyrelay.experiments.figures import reproduce
from skyrelay.experiments.gas import _finding


def test_every_row_of_the_papers_table_is_measured(tmp_path):
    rendered = reproduce("gas", "smoke", tmp_path / "gas")
    assert {finding.claim for finding in rendered.findings} == {c.key for c in CLAIMS if c.key.startswith("gas.")}
    assert {path.name for path in rendered.files} == {"claims.json", "gas.csv", "gas.pdf", "gas.png"}
    (deployment,) = [finding for finding in rendered.findings if finding.claim == "gas.deployment"]
    assert "extension" in deployment.measured
    with (tmp_path / "gas" / "gas.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if row["ratio"]:
            assert abs(float(row["ratio"]) - int(row["gas"]) / int(row["paper"])) < 1e-4
    assert {row["case"] for row in rows if row["kind"] == "curve"} == {"20 UAVs", "1 UAV", "pieces of 60"}


def test_the_dearest_case_decides():
    cases = [{"gas": 90, "paper": 100}, {"gas": 101, "paper": 100}]
    assert _finding("registerUAV", cases[:1], {}).verdict == "holds"
    assert _finding("registerUAV", cases, {}).verdict == "does not hold"
