"""What vehicles paid, against the chain and the tables of the run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skyrelay.audit.tables import Compared
from skyrelay.chain import abi
from skyrelay.chain.abi import Event
from skyrelay.chain.embedded.ledger import Block
from skyrelay.runfolder.reader import Run
from skyrelay.simulation.payment import due_of_step


def check_payments(compared: Compared, run: Run, rows: Sequence[Mapping[str, Any]], blocks: Sequence[Block]) -> None:
    """The table ``payments`` against the contract's record, and what was due against what was carried.

    The record has been executed again, so that prices, deposits and signatures are as the contract demands. What is
    left is that the table says what the record says, and that nobody was billed for more than its tables show.

    Args:
        rows: of the table.
        blocks: of the run's chain.
    """
    deployed = _contracts(run.summary.contract, blocks)
    if not run.scenario.payment.enabled:
        if deployed or rows:
            compared.differs("payments.parquet", "the run", "payments", "none: payment.enabled is false")
        return
    if len(deployed) != 1:
        compared.differs("chain", "contracts for payments", len(deployed), 1)
        return
    compared.rows("payments", rows, _agreements(run, deployed[0], blocks), ("period", "vehicle", "uav"))
    billed = _due(run, rows)
    for row in rows:
        compared.count("payments against what was carried")
        place = f"period {row['period']}, {row['vehicle']}"
        compared.same("payments.parquet", f"{place}: due", row["due"], billed[row["period"], row["vehicle"]])
        if row["signed"] > row["due"]:
            compared.differs("payments.parquet", f"{place}: signed", row["signed"], f"no more than {row['due']}")


def _contracts(relay: str, blocks: Sequence[Block]) -> list[str]:
    """Addresses of the contracts for payments that settle for a SkyRelay contract."""
    found = []
    for block in blocks:
        for transaction, receipt in zip(block.transactions, block.receipts, strict=True):
            if transaction.to is None and receipt.created is not None:
                arguments = abi.payments().creation_arguments(transaction.data)
                if arguments is not None and arguments["relay"] == relay:
                    found.append(receipt.created)
    return found


def _agreements(run: Run, address: str, blocks: Sequence[Block]) -> list[dict[str, Any]]:
    """What the record says of every agreement, in the columns of the table."""
    names = dict(zip(run.accounts["address"], run.accounts["name"], strict=True))
    begins = (number * run.summary.period_steps * run.summary.step_seconds for number in range(run.summary.periods))
    periods = {1 + math.floor(begin): number for number, begin in enumerate(begins)}  # by the chain's clock
    agreements: dict[tuple[str, str, int, int], dict[str, Any]] = {}
    for block in blocks:
        for transaction, receipt in zip(block.transactions, block.receipts, strict=True):
            events = [abi.payments().event(log) for log in receipt.logs if log.address == address]
            for event in events:
                if event.name == "AgreementOpened":
                    agreements[_key(event)] = {
                        "period": periods.get(block.timestamp, -1),
                        "zone": event.args["zone"],
                        "vehicle": names.get(event.args["vehicle"], event.args["vehicle"]),
                        "uav": names.get(event.args["uav"], event.args["uav"]),
                        "price": event.args["price"],
                        "signed": 0,
                        "paid": 0,
                    }
            settled = [event for event in events if event.name == "Settled"]
            for event in settled:
                agreements[_key(event)]["paid"] = event.args["paid"]
            settle = abi.payments().functions["settle"]
            if settled and transaction.to == address and abi.payments().function_of(transaction.data) is settle:
                receipts = settle.decode_arguments(transaction.data)["receipts"]
                for event, signed in zip(settled, receipts, strict=True):
                    agreements[_key(event)]["signed"] = signed["amount"]
    return list(agreements.values())


def _key(event: Event) -> tuple[str, str, int, int]:
    return event.args["vehicle"], event.args["uav"], event.args["zone"], event.args["period"]


def _due(run: Run, rows: Sequence[Mapping[str, Any]]) -> dict[tuple[int, str], int]:
    """By period and vehicle, what the table of vehicles says was carried, at the payment that the vehicle offered."""
    steps = run.summary.period_steps
    table = run.vehicles
    owed = {(row["period"], row["vehicle"]): 0 for row in rows}
    prices = {(row["period"], row["vehicle"]): row["price"] for row in rows}
    flown = np.flatnonzero(table["step"] > 0)
    period = (table["step"][flown] - 1) // steps
    for row, number in zip(flown.tolist(), period.tolist(), strict=True):
        key = number, table["vehicle"][row]
        if key in owed and table["demand_kbps"][row]:
            payment = prices[key] // int(table["demand_kbps"][row])
            due = due_of_step(float(table["carried_kbps"][row]), payment, steps)
            owed[key] = min(owed[key] + due, prices[key])
    return owed
