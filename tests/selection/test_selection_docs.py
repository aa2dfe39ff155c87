"""What the pages on selection say is what the code and the kept results say."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/reference/selection.md").read_text()
RESULTS = ROOT / "results/selection-paper"


def test_the_examples_run():
    scope = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(code, scope)  # noqa: S102  # the page's own examples
    vehicles, uavs, settings = scope["vehicles"], scope["uavs"], scope["scenario"].selection
    own = scope["best_first"](vehicles, uavs, settings)
    loads = np.bincount(own[own >= 0], weights=vehicles.demand[own >= 0], minlength=len(uavs))
    assert (own >= 0).any()
    assert (loads <= uavs.bandwidth).all()


def test_the_verdicts_are_those_of_the_kept_results():
    found = json.loads((RESULTS / "claims.json").read_text())
    measured = {(f["claim"], f["setting"].split(",")[0].removeprefix("candidates: ")): f["verdict"] for f in found}
    rows = re.findall(r"^\| `(selection\.[\w-]+)`[^|]*\| ([\w ]+) \| ([\w ]+) \|$", PAGE, re.MULTILINE)
    stated = {
        (claim, rule): verdict for claim, *both in rows for rule, verdict in zip(("range", "zone"), both, strict=True)
    }
    assert stated == measured


def test_the_blocking_pairs_are_those_of_the_kept_results():
    with (RESULTS / "summary.csv").open() as file:
        mean = {
            (row["method"], row["uavs"]): float(row["mean"])
            for row in csv.DictReader(file)
            if (row["candidates"], row["metric"]) == ("zone", "blocking_pairs")
        }
    text = (ROOT / "docs/explanation/stability.md").read_text()
    rows = re.findall(r"^\| ([\w ,()-]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", text, re.MULTILINE)
    assert len(rows) == len({method for method, _ in mean})
    for method, *values in rows:
        for uavs, value in zip(("20", "80", "160"), values, strict=True):
            assert float(value) == pytest.approx(mean[method, uavs], abs=0.006)
