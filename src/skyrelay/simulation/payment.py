"""Who pays whom in a run: the members' purses and tills, and the contract that settles them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient
from skyrelay.chain.payments import PaymentsClient, price_of
from skyrelay.chain.typed_data import Receipt
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.protocol.payment import Purse, Till, exchange
from skyrelay.simulation.flight import NOBODY
from skyrelay.simulation.world import World


class Cashier:
    """Carries receipts between the members of a run, and their calls to the chain.

    Vehicles keep the price of some periods deposited. When a selection is made, each UAV has the price of its vehicles
    locked; it bills them as it carries their traffic; at the end of the period it hands their receipts in.
    """

    def __init__(self, world: World, client: PaymentsClient, clearing_house: str, keyring: Keyring) -> None:
        self._client, self._clearing_house = client, clearing_house
        self._names = world.tracks.ids
        self._uav_names = world.fleet.ids
        self._vehicles = [keyring.account(name) for name in world.tracks.ids]
        self._uavs = [keyring.account(name) for name in world.fleet.ids]
        self._offers: list[int] = world.members.payment.tolist()
        self._prices = list(map(price_of, self._offers, world.members.demand.tolist()))
        self._config = world.scenario.payment
        self._period_steps = world.scenario.coordination.period_steps
        chain_id = client.chain.chain_id

        def sign(member: str, receipt: Receipt) -> bytes:
            return keyring.sign_message(member, receipt.message(client.address, chain_id))

        def signer(receipt: Receipt, signature: bytes) -> str | None:
            return receipt.signer(signature, client.address, chain_id)

        tolerance = 1.0 / self._period_steps  # a step, which one end may have seen begin before the other
        self._tills = {uav: Till(uav, sign, signer) for uav in self._uavs}
        self._purses = {vehicle: Purse(vehicle, sign, signer, tolerance) for vehicle in self._vehicles}
        self._row = {address: row for row, address in enumerate(self._vehicles)}
        self._uav_row = {address: row for row, address in enumerate(self._uavs)}
        self._agreed: dict[int, dict[str, Any]] = {}
        self._owner: IntArray = np.full(len(self._vehicles), NOBODY)
        self._steps = 0

    @classmethod
    def found(cls, world: World, relay: IovClient, clearing_house: str, keyring: Keyring) -> Cashier:
        """Deploy the token and the contract; ``clearing_house`` issues the token.

        Raises:
            ChainError: the chain is out of reach.
        """
        config = world.scenario.coordination
        seconds = math.ceil(config.period_steps * config.step_seconds)
        client = PaymentsClient.deploy(
            relay.chain,
            relay.address,
            clearing_house,
            service_seconds=seconds,
            window_seconds=world.scenario.payment.window,
        )
        return cls(world, client, clearing_house, keyring)

    def deposit(self, rows: Iterable[int], timestamp: int) -> None:
        """The vehicles of these rows bring their deposits up to the price of `payment.deposit_periods` periods."""
        present = [int(row) for row in rows if self._prices[int(row)]]
        held = self._client.accounts(self._vehicles[row] for row in present)
        lacking = {
            self._vehicles[row]: short
            for row, account in zip(present, held, strict=True)
            if (short := self._config.deposit_periods * self._prices[row] - account.free) > 0
        }
        client, house = self._client, self._clearing_house
        for calls in (
            [client.mint(house, vehicle, amount) for vehicle, amount in lacking.items()],
            [client.approve(vehicle, amount) for vehicle, amount in lacking.items()],
            [client.deposit(vehicle, vehicle, amount) for vehicle, amount in lacking.items()],
        ):
            client.execute(calls, timestamp)

    def open(self, period: int, owner: IntArray, timestamp: int) -> None:
        """A selection is made: every UAV has the prices of its vehicles locked.

        Args:
            owner: [V] row of the UAV that serves each vehicle, or -1.
        """
        self._owner, self._steps, self._agreed = owner, 0, {}
        busy, served = np.unique(owner[owner != NOBODY], return_counts=True)
        calls = [
            self._client.open(self._uavs[uav], vehicles)
            for uav, vehicles in zip(busy.tolist(), served.tolist(), strict=True)
        ]
        for event in self._client.execute(calls, timestamp):
            if event.name != "AgreementOpened":
                continue
            vehicle, uav, price = event.args["vehicle"], event.args["uav"], event.args["price"]
            place = event.args["zone"], event.args["period"]
            self._tills[uav].agree(vehicle, *place, price)
            self._purses[vehicle].agree(uav, *place, price)
            row, uav_row = self._row[vehicle], self._uav_row[uav]
            names = {"vehicle": self._names[row], "uav": self._uav_names[uav_row]}
            self._agreed[row] = {"period": period, "zone": place[0], **names, "price": price, "due": 0}

    def carry(self, carried: FloatArray) -> None:
        """A step has been flown: bills and receipts, when it is time for them.

        Args:
            carried: [V] what each vehicle's link holds of its demand [kbit/s].
        """
        self._steps += 1
        for row, agreed in self._agreed.items():
            due = due_of_step(float(carried[row]), self._offers[row], self._period_steps)
            agreed["due"] = min(agreed["due"] + due, agreed["price"])
            share = due / agreed["price"] if agreed["price"] else 0.0
            self._tills[self._uavs[self._owner[row]]].carry(self._vehicles[row], share)
            self._purses[self._vehicles[row]].receive(share)
        if self._steps % self._config.receipt_steps == 0 or self._steps == self._period_steps:
            exchange(self._tills, self._purses)

    def settle(self, timestamp: int) -> list[dict[str, Any]]:
        """The period is over: the last bills, and every UAV's receipts to the chain.

        Returns: the rows of the table ``payments``.
        """
        exchange(self._tills, self._purses)
        calls = []
        signed: dict[str, int] = {}
        for uav, till in self._tills.items():
            receipts = till.close()
            signed |= {receipt.vehicle: receipt.amount for receipt, _ in receipts}
            calls += self._client.settle(uav, receipts)
        paid = {e.args["vehicle"]: e.args["paid"] for e in self._client.execute(calls, timestamp)}
        rows = [
            agreed | {"signed": signed.get(self._vehicles[row], 0), "paid": paid.get(self._vehicles[row], 0)}
            for row, agreed in sorted(self._agreed.items())
        ]
        self._agreed = {}
        return rows


def due_of_step(carried: float, payment: int, period_steps: int) -> int:
    """What one step costs, in the token's unit: carried [kbit/s] at a payment [cents per Mbit/s for a whole period]."""
    return round(carried * payment / period_steps)
