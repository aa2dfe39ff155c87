"""Gas: no row above the paper, and no change that nobody explained."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path

import pytest

from skyrelay.chain.embedded.gas import PAPER_GAS, GasReport, differences, measure

SNAPSHOT = Path(__file__).parents[2] / "contracts" / "gas-snapshot.json"


@pytest.fixture(scope="module")
def report() -> GasReport:
    return measure()


def test_gas_is_what_the_snapshot_says(report):
    """A change that is meant writes it anew: skyrelay chain gas --json > contracts/gas-snapshot.json."""
    assert differences(report.as_json(), json.loads(SNAPSHOT.read_text())) == []


def test_no_row_is_above_the_papers(report):
    rows = [row for row in report.rows if row.paper is not None]
    assert {row.function for row in rows} == set(PAPER_GAS)
    assert [row for row in rows if row.gas > row.paper] == []


def test_pieces_of_an_allocation_are_bounded(report):
    for point in report.curve:
        assert point.pieces / point.calls < 800_000


def test_a_signed_period_costs_less_than_half_of_one_by_transactions(report):
    rows = {(row.function, row.case): row.gas for row in report.rows}
    alone = (
        rows["updateVehicleInfo", "after a period with a proposal"]
        + rows["submitVehSelection", "from the third period on"]
    )
    (batch,) = [point for point in report.batches if point.vehicles == 200]
    (curve,) = [point for point in report.curve if point.proposals == 200]
    assert 2 * (batch.signed + batch.allocated) < alone + curve.spread // 200


def test_the_page_of_the_contract_shows_the_snapshot():
    page = (Path(__file__).parents[2] / "docs" / "reference" / "contract.md").read_text()
    for row in json.loads(SNAPSHOT.read_text())["rows"]:
        if row["paper"] is not None:
            line = f"| {row['function']} | {row['case']} | {row['paper']:,} | {row['gas']:,} | {row['ratio']:.2f} |"
            assert line in page.splitlines()


def test_a_difference_is_named(report):
    changed = deepcopy(report.as_json())
    changed["rows"][0]["gas"] += 1
    changed["allocate_zone"].pop()
    lines = differences(changed, report.as_json())
    assert len(lines) == 2
    assert lines[0].startswith("rows deployment")
    assert lines[1].startswith("allocate_zone 1000")
