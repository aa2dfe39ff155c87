"""Reports of who was heard are signed, count for one contract, and their hash stands on the chain."""

from dataclasses import replace
from functools import partial

import pytest

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient, Role, Settings, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.protocol.witness import evidence, lowered, report

RING = Keyring(b"w" * 32)
CONTRACT = ("0x" + "c0" * 20, 31337)
NAMES = [RING.account(f"vehicle {number}") for number in range(4)]


def reports(period=3):
    return [
        report(
            CONTRACT,
            one,
            period,
            {other: (12.34, 20) for other in NAMES if other != one},
            partial(RING.vouch, one),
        )
        for one in NAMES
    ]


def test_a_report_is_its_witness_own_and_of_one_contract_and_period():
    one = reports()[0]
    assert one.signed(CONTRACT)
    assert one.heard[NAMES[1]] == (12.3, 20)
    other = (NAMES[0], 31337)
    assert not one.signed(other)
    assert not one.signed((CONTRACT[0], 1))
    for changed in (
        {"period": 4},
        {"witness": NAMES[1]},
        {"heard": {NAMES[1]: (12.4, 20)}},
        {"heard": {NAMES[0]: (12.3, 20)}},
        {"heard": {NAMES[1]: (float("nan"), 20)}},
        {"heard": {"0x12": (1.0, 20)}},
        {"heard": {NAMES[1]: (1e9, 20)}},
        {"signature": bytes(65)},
        {"signature": b""},
    ):
        assert not replace(one, **changed).signed(CONTRACT), changed
    with pytest.raises(ValueError, match="of others"):
        report(CONTRACT, NAMES[0], 1, {NAMES[0]: (1.0, 1)}, lambda message: RING.vouch(NAMES[0], message))


def test_evidence_names_all_reports_in_any_order_and_stands_in_the_transaction():
    told = reports()
    digest = evidence(CONTRACT, told)
    assert digest == evidence(CONTRACT, reversed(told))
    assert digest != evidence(CONTRACT, told[1:])
    assert digest != evidence(CONTRACT, reports(period=4))

    chain = EmbeddedChain()
    boss, liar = chain.account("boss"), chain.account("liar")
    client = IovClient.deploy(chain, Settings(), boss)
    client.execute([client.grant_role(boss, Role.REPUTATION, boss)])
    client.execute([client.register_vehicle(liar, VehicleRecord(1, 2, 3, 1))])
    down = lowered({liar: client.vehicle_info(liar).reputation}, [liar, boss], 30.0)
    receipt = client.execute([client.set_reputations(boss, down, digest)])[0]
    assert client.vehicle_info(liar).reputation == 20.0
    assert chain.transaction(receipt.block, receipt.transaction).data.endswith(digest)
