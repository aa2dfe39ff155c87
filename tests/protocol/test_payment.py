"""Bills and receipts in flight: honest parties agree, and nobody can be made to sign or to serve for nothing."""

from dataclasses import replace

import pytest

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.typed_data import Receipt, compact, expanded
from skyrelay.protocol.payment import Bill, Purse, Till, exchange

CONTRACT, CHAIN = "0x" + "42" * 20, 1337
KEYRING = Keyring(b"k" * 32)
UAV, OTHER, VEHICLE = (KEYRING.account(name) for name in ("uav", "other", "vehicle"))


def sign(member, receipt):
    return KEYRING.sign_message(member, receipt.message(CONTRACT, CHAIN))


def signer(receipt, signature):
    return receipt.signer(signature, CONTRACT, CHAIN)


@pytest.fixture
def pair():
    till, purse = Till(UAV, sign, signer), Purse(VEHICLE, sign, signer, tolerance=0.1)
    till.agree(VEHICLE, 3, 7, 1000)
    purse.agree(UAV, 3, 7, 1000)
    return till, purse


def carry(pair, share, received=None):
    till, purse = pair
    till.carry(VEHICLE, share)
    purse.receive(share if received is None else received)


def test_what_was_carried_is_what_is_signed(pair):
    till, purse = pair
    assert exchange({UAV: till}, {VEHICLE: purse}) == 0
    for _ in range(4):
        carry(pair, 0.2)
        assert exchange({UAV: till}, {VEHICLE: purse}) == 1
    assert purse.signed == till.signed(VEHICLE) == 800
    carry(pair, 0.9)
    exchange({UAV: till}, {VEHICLE: purse})
    ((receipt, signature),) = till.close()
    assert receipt == Receipt(VEHICLE, UAV, 3, 7, 1000)  # never above the price
    assert signer(receipt, signature) == VEHICLE
    assert not till.close()


def test_a_uav_that_counts_more_than_arrived_is_not_paid_for_it(pair):
    till, purse = pair
    carry(pair, 0.3, received=0.25)
    assert exchange({UAV: till}, {VEHICLE: purse}) == 1  # within what two ends may differ by
    carry(pair, 0.3, received=0.0)
    assert exchange({UAV: till}, {VEHICLE: purse}) == 0
    assert purse.signed == 300
    assert not till.serves(VEHICLE)


def test_a_vehicle_that_does_not_sign_is_served_no_longer_and_can_sign_later(pair):
    till, purse = pair
    assert till.serves(VEHICLE)
    assert not till.serves(OTHER)
    carry(pair, 0.2)
    (bill,) = till.bills()
    assert not till.serves(VEHICLE)
    answer = purse.countersign(bill)
    assert answer is not None
    assert till.take(bill.receipt, answer)
    assert till.serves(VEHICLE)


@pytest.mark.parametrize(
    "change", [{"uav": OTHER}, {"zone": 4}, {"period": 8}, {"vehicle": OTHER}, {"amount": 0}, {"amount": 301}]
)
def test_a_vehicle_signs_no_bill_of_another_agreement_or_amount(pair, change):
    _, purse = pair
    purse.receive(0.2)
    receipt = replace(Receipt(VEHICLE, UAV, 3, 7, 200), **change)
    assert purse.countersign(Bill(receipt, sign(receipt.uav, receipt))) is None
    assert purse.signed == 0


def test_a_vehicle_signs_no_bill_that_the_uav_has_not_signed(pair):
    _, purse = pair
    purse.receive(0.2)
    receipt = Receipt(VEHICLE, UAV, 3, 7, 200)
    assert purse.countersign(Bill(receipt, sign(OTHER, receipt))) is None
    assert purse.countersign(Bill(receipt, bytes(65))) is None
    assert purse.countersign(Bill(receipt, sign(UAV, replace(receipt, amount=199)))) is None


def test_an_older_bill_is_not_signed_again(pair):
    _, purse = pair
    purse.receive(0.2)
    receipt = Receipt(VEHICLE, UAV, 3, 7, 200)
    bill = Bill(receipt, sign(UAV, receipt))
    assert purse.countersign(bill) is not None
    assert purse.countersign(bill) is None


def test_a_uav_takes_no_answer_but_the_vehicles_to_its_bill(pair):
    till, _ = pair
    carry(pair, 0.2)
    (bill,) = till.bills()
    less = replace(bill.receipt, amount=100)
    assert not till.take(less, sign(VEHICLE, less))
    assert not till.take(bill.receipt, sign(OTHER, bill.receipt))
    assert not till.take(bill.receipt, b"")
    assert till.take(bill.receipt, sign(VEHICLE, bill.receipt))


def test_a_signature_is_packed_and_unpacked():
    for amount in range(20):
        signature = sign(VEHICLE, Receipt(VEHICLE, UAV, 1, 1, amount))
        assert expanded(*compact(signature)) == signature
