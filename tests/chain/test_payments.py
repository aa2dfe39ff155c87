"""The contract for payments by its client, on the embedded chain; the rules themselves are tested in contracts/test."""

import pytest

from skyrelay.chain.abi import ContractError
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.payments import PaymentsClient, price_of
from skyrelay.chain.typed_data import Receipt
from skyrelay.core.errors import ChainError

KEYRING = Keyring(b"p" * 32)
ADMIN, UAV, VEHICLE = (KEYRING.account(name) for name in ("admin", "uav", "vehicle"))
PRICE = price_of(500, 1000)


class Town:
    """A UAV and a vehicle that it has selected, with the price deposited."""

    def __init__(self):
        self.chain = EmbeddedChain()
        self.relay = IovClient.deploy(self.chain, Settings(), ADMIN)
        relay = self.relay
        relay.execute([relay.grant_role(ADMIN, Role.COORDINATOR, ADMIN)])
        relay.execute(
            [
                relay.register_uav(UAV, UavRecord(0, 0, 100, 90, 20_000, 1)),
                relay.register_vehicle(VEHICLE, VehicleRecord(10, 0, 500, 1)),
            ]
        )
        self.payments = PaymentsClient.deploy(self.chain, relay.address, ADMIN, service_seconds=40, window_seconds=60)
        pay = self.payments
        pay.execute([pay.mint(ADMIN, VEHICLE, 3 * PRICE)])
        pay.execute([pay.approve(VEHICLE, 2 * PRICE)])
        pay.execute([pay.deposit(VEHICLE, VEHICLE, 2 * PRICE)])
        relay.execute([relay.submit_veh_selection(VEHICLE, UAV, 1000, 1)])
        relay.execute([relay.allocate_zone(ADMIN, 1, 100)])

    def receipt(self, amount):
        receipt = Receipt(VEHICLE, UAV, 1, self.relay.zone_info(1).period, amount)
        return receipt, KEYRING.sign_message(VEHICLE, receipt.message(self.payments.address, self.chain.chain_id))


@pytest.fixture
def town():
    return Town()


def test_a_period_is_paid(town):
    pay = town.payments
    (opened,) = pay.execute([pay.open(UAV, 1)])
    assert (opened.name, opened.args["price"]) == ("AgreementOpened", PRICE)
    (agreement,) = pay.agreements(VEHICLE)
    assert (agreement.uav, agreement.zone, agreement.locked, agreement.claimed) == (UAV, 1, PRICE, None)
    (settled,) = pay.execute(pay.settle(UAV, [town.receipt(123)]))
    assert (settled.args["paid"], settled.args["penalty"]) == (123, 0)
    uav, vehicle = pay.accounts([UAV, VEHICLE])
    assert (uav.free, vehicle.free) == (123, 2 * PRICE - 123)
    assert not pay.agreements(VEHICLE)
    pay.execute([pay.request_withdrawal(UAV, 123)], timestamp=100)
    assert pay.accounts([UAV])[0].leaves_at == 160
    pay.execute([pay.withdraw(UAV)], timestamp=160)
    assert pay.balance(UAV) == 123
    assert pay.balance(pay.address) == 2 * PRICE - 123
    assert [event.name for event in pay.events()][:2] == ["Deposited", "AgreementOpened"]


def test_a_claim_of_less_than_was_signed_costs_the_price(town):
    pay = town.payments
    pay.execute([pay.open(UAV, 1)])
    receipt, signature = town.receipt(50)
    pay.execute([pay.claim(VEHICLE, UAV, 1, receipt.period, 49)])
    assert pay.agreements(VEHICLE)[0].claimed == 49
    (settled,) = pay.execute(pay.settle(UAV, [(receipt, signature)]))
    assert (settled.args["paid"], settled.args["penalty"]) == (50, PRICE - 50)


def test_what_nobody_settles_is_the_vehicles_again(town):
    pay = town.payments
    pay.execute([pay.open(UAV, 1)], timestamp=10)
    pay.execute([pay.close(ADMIN, [VEHICLE])], timestamp=111)
    assert pay.accounts([VEHICLE])[0].free == 2 * PRICE


def test_refusals_have_names(town):
    pay = town.payments
    pay.execute([pay.open(UAV, 1)])
    with pytest.raises(ContractError, match="MoreThanAgreed"):
        pay.execute(pay.settle(UAV, [town.receipt(PRICE + 1)]))
    with pytest.raises(ContractError, match="NoAgreement"):
        pay.execute(pay.settle(ADMIN, [town.receipt(1)]))
    forged = [(town.receipt(1)[0], town.receipt(2)[1])]
    with pytest.raises(ContractError, match="WrongSignature"):
        pay.execute(pay.settle(UAV, forged))


def test_it_connects_to_what_settles_for_this_contract_only(town):
    pay = town.payments
    found = PaymentsClient.connect(town.chain, pay.address, town.relay.address)
    assert found.token == pay.token
    with pytest.raises(ChainError, match="one that settles for the contract"):
        PaymentsClient.connect(town.chain, pay.address, pay.address)
    with pytest.raises(ChainError, match="a contract's address"):
        PaymentsClient.connect(town.chain, "0x" + "01" * 20, town.relay.address)
    with pytest.raises(ContractError, match="InvalidTerms"):
        PaymentsClient.deploy(town.chain, UAV, ADMIN, service_seconds=1, window_seconds=1)
