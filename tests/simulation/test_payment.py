"""A run in which vehicles pay: the money adds up, and the audit finds what was changed."""

import shutil

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from skyrelay.audit.folder import audit_folder
from skyrelay.chain import abi
from skyrelay.chain.proof.replay import replay
from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.simulation.run import play

SMALL = ["coordination.steps=20", "coordination.period_steps=8", "fleet.uavs=12", "mobility.penetration=0.05"]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    found = {}
    for enabled in ("false", "true"):
        found[enabled] = tmp_path_factory.mktemp(enabled)
        play(load_scenario("bologna", [*SMALL, f"payment.enabled={enabled}"], 3), found[enabled], Silent())
    return found


def payments(folder):
    return pq.read_table(folder / "payments.parquet")


def differences(folder):
    return [d for d in audit_folder(folder).differences if "manifest" not in d.place and "report" not in d.place]


def test_everyone_served_pays_what_was_carried(folders):
    rows = payments(folders["true"]).to_pylist()
    served = pq.read_table(folders["true"] / "proposals.parquet").filter(pc.field("accepted")).num_rows
    assert served == len(rows) > 20
    assert any(0 < row["due"] < row["price"] for row in rows)
    for row in rows:
        assert row["due"] == row["signed"] == row["paid"] <= row["price"]


def test_payment_moves_nobody(folders):
    off, on = (pq.read_table(folders[key] / "vehicles.parquet") for key in ("false", "true"))
    assert on.equals(off)
    assert not (folders["false"] / "payments.parquet").exists()


def test_no_money_is_made_or_lost(folders):
    known = {
        abi.payments().topic(name) for name in ("Deposited", "Settled", "DepositForfeited", "Claimed", "Withdrawn")
    }
    receipts = (receipt for block in replay(folders["true"] / "chain").blocks for receipt in block.receipts)
    events = [abi.payments().event(log) for one in receipts for log in one.logs if log.topics[0] in known]
    paid_in = sum(event.args["amount"] for event in events if event.name == "Deposited")
    paid = sum(event.args["paid"] for event in events if event.name == "Settled")
    assert paid == pc.sum(payments(folders["true"])["paid"]).as_py()
    assert 0 < paid < paid_in
    assert {event.name for event in events} == {"Deposited", "Settled"}  # nobody lost a deposit


def test_the_audit_agrees(folders):
    assert not differences(folders["true"])


@pytest.mark.parametrize("column", ["price", "due", "signed", "paid", "vehicle", "uav", "zone", "period"])
def test_the_audit_finds_a_changed_table(folders, tmp_path, column):
    folder = tmp_path / "changed"
    shutil.copytree(folders["true"], folder)
    table = payments(folder)
    values = table[column].to_pylist()
    values[3] = "nobody" if isinstance(values[3], str) else values[3] + 1
    changed = table.set_column(table.schema.get_field_index(column), column, pa.array(values, table[column].type))
    pq.write_table(changed, folder / "payments.parquet")
    assert any("payments" in difference.place for difference in differences(folder))


def test_the_audit_finds_a_table_that_is_gone(folders, tmp_path):
    folder = tmp_path / "gone"
    shutil.copytree(folders["true"], folder)
    (folder / "payments.parquet").unlink()
    assert any("payments" in difference.place for difference in differences(folder))
