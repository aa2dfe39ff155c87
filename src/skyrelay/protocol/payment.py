"""Both sides of a payment in flight, without input or output: a UAV bills, a vehicle countersigns.

A bill says what is due so far for a period; the vehicle's signature makes it a receipt, which settles on the chain.
A UAV serves one interval before it has the receipt for it. That is all it can lose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from skyrelay.chain.typed_data import Receipt

Sign = Callable[[str, Receipt], bytes]
"""Signs a receipt as one of this host's members: 65 bytes."""
Signer = Callable[[Receipt, bytes], str | None]
"""Who has signed a receipt."""


@dataclass(frozen=True, slots=True)
class Bill:
    """What a UAV says is due, with its signature."""

    receipt: Receipt
    signature: bytes


class Till:
    """A UAV's side of the period's agreements.

    Args:
        uav: its address.
        sign, signer: of receipts.
    """

    def __init__(self, uav: str, sign: Sign, signer: Signer) -> None:
        self._uav, self._sign, self._signer = uav, sign, signer
        self._prices: dict[str, int] = {}
        self._place: dict[str, tuple[int, int]] = {}
        self._due: dict[str, int] = {}
        self._billed: dict[str, Receipt] = {}
        self._receipts: dict[str, tuple[Receipt, bytes]] = {}

    def agree(self, vehicle: str, zone: int, period: int, price: int) -> None:
        """The chain has locked a vehicle's price for this period."""
        self._prices[vehicle], self._place[vehicle], self._due[vehicle] = price, (zone, period), 0

    def carry(self, vehicle: str, share: float) -> None:
        """A vehicle was carried: this share of what it asks for over a whole period."""
        if vehicle in self._prices:
            due = self._due[vehicle] + round(share * self._prices[vehicle])
            self._due[vehicle] = min(due, self._prices[vehicle])

    def bills(self) -> list[Bill]:
        """A bill for everyone who owes more than it has signed."""
        bills = []
        for vehicle, due in self._due.items():
            if due > self.signed(vehicle):
                self._billed[vehicle] = receipt = Receipt(vehicle, self._uav, *self._place[vehicle], due)
                bills.append(Bill(receipt, self._sign(self._uav, receipt)))
        return bills

    def take(self, receipt: Receipt, signature: bytes) -> bool:
        """A vehicle's answer; False where it is not the bill, signed by the vehicle."""
        if self._billed.get(receipt.vehicle) != receipt or self._signer(receipt, signature) != receipt.vehicle:
            return False
        self._receipts[receipt.vehicle] = receipt, signature
        return True

    def signed(self, vehicle: str) -> int:
        """What a vehicle has signed so far."""
        held = self._receipts.get(vehicle)
        return 0 if held is None else held[0].amount

    def serves(self, vehicle: str) -> bool:
        """Whether a vehicle has an agreement and has signed its last bill; who does not is served no longer."""
        billed = self._billed.get(vehicle)
        return vehicle in self._prices and (billed is None or billed.amount <= self.signed(vehicle))

    def close(self) -> list[tuple[Receipt, bytes]]:
        """The period is over: the greatest receipt of each vehicle, to be settled."""
        receipts = list(self._receipts.values())
        for held in (self._prices, self._place, self._due, self._billed, self._receipts):
            held.clear()
        return receipts


class Purse:
    """A vehicle's side.

    Args:
        vehicle: its address.
        sign, signer: of receipts.
        tolerance: by how much of a period's price a UAV's count may be ahead of the vehicle's own, since a link is
            measured at both ends.
    """

    def __init__(self, vehicle: str, sign: Sign, signer: Signer, tolerance: float) -> None:
        self._vehicle, self._sign, self._signer, self._tolerance = vehicle, sign, signer, tolerance
        self._agreed: tuple[str, int, int, int] | None = None
        self._received = 0.0
        self._signed = 0

    def agree(self, uav: str, zone: int, period: int, price: int) -> None:
        """The chain has locked the price for this period."""
        self._agreed = uav, zone, period, price
        self._received, self._signed = 0.0, 0

    def receive(self, share: float) -> None:
        """The vehicle was carried: this share of what it asks for over a whole period."""
        self._received += share

    def countersign(self, bill: Bill) -> bytes | None:
        """The signature.

        None where the bill is not this agreement's UAV's, asks for no more than was signed, or for more than was
        received.
        """
        receipt = bill.receipt
        if self._agreed is None or receipt.vehicle != self._vehicle:
            return None
        *place, price = self._agreed
        most = min(price, round(price * (self._received + self._tolerance)))
        if [receipt.uav, receipt.zone, receipt.period] != place or not self._signed < receipt.amount <= most:
            return None
        if self._signer(receipt, bill.signature) != receipt.uav:
            return None
        self._signed = receipt.amount
        return self._sign(self._vehicle, receipt)

    @property
    def signed(self) -> int:
        """What it has signed in this period: to claim less would cost the price."""
        return self._signed


def exchange(tills: Mapping[str, Till], purses: Mapping[str, Purse]) -> int:
    """Every UAV bills, every vehicle of this process answers; returns how many receipts were signed."""
    signed = 0
    for till in tills.values():
        for bill in till.bills():
            answer = purses[bill.receipt.vehicle].countersign(bill)
            signed += answer is not None and till.take(bill.receipt, answer)
    return signed
