"""A relayer's word: kept, broken, excused, forged."""

from dataclasses import replace

import pytest

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.proof.omission import acknowledge, is_omitted
from skyrelay.chain.typed_data import Proposal, sign_proposal
from skyrelay.core.errors import ChainError


@pytest.fixture
def zone():
    """A UAV, two vehicles with keys and a relayer; what each vehicle signed."""
    with EmbeddedChain(timestamp=1_000) as chain:
        keyring = Keyring(b"omission".ljust(32, b"."))
        client = IovClient.deploy(chain, Settings(), chain.account("admin"))
        uav, relayer = chain.account("uav"), keyring.account("relayer")
        vehicles = [keyring.account(name) for name in ("one", "other")]
        client.execute([client.register_uav(uav, UavRecord(0, 0, 100, 50, 10_000, 1))])
        client.execute([client.register_vehicle(v, VehicleRecord(1, 1, 10, 1)) for v in vehicles])
        told = client.vehicle_infos(vehicles)
        signed = [
            sign_proposal(
                keyring, v, Proposal(uav, 1, 1, 10, 20, 300, 1_000, info.timestamp), client.address, chain.chain_id
            )
            for v, info in zip(vehicles, told, strict=True)
        ]
        yield client, keyring, relayer, signed


def word(zone, proposal, blocks=1):
    client, keyring, relayer, _ = zone
    chain = client.chain
    return acknowledge(keyring, relayer, proposal, chain.block_number + blocks, client.address, chain.chain_id)


def test_who_is_left_out_can_show_it(zone):
    client, _, relayer, (one, other) = zone
    kept, broken = word(zone, one), word(zone, other)
    client.execute([client.submit_signed(relayer, [one])])
    assert not is_omitted(kept, client)
    assert is_omitted(broken, client)


def test_what_came_too_late_is_left_out(zone):
    client, _, relayer, (one, other) = zone
    late = word(zone, other)
    client.execute([client.submit_signed(relayer, [one])])
    client.execute([client.submit_signed(relayer, [other])])
    assert is_omitted(late, client)
    assert is_omitted(late, client, handed_in=(client.chain.block_number, 0))


def test_what_the_contract_passed_over_was_handed_in(zone):
    client, _, relayer, (one, other) = zone
    promise = word(zone, other)
    vehicle = other.signer(client.address, client.chain.chain_id)
    record = client.update_vehicle_info(vehicle, VehicleRecord(5, 5, 10, 1))  # what it signed is void with that
    (_, receipt) = client.execute([record, client.submit_signed(relayer, [one, other])])
    assert is_omitted(promise, client)
    assert not is_omitted(promise, client, handed_in=(receipt.block, receipt.transaction))
    assert is_omitted(word(zone, other, 0), client, handed_in=(receipt.block, 0)), "another transaction"


def test_a_word_that_is_not_the_relayer_s_or_not_due_proves_nothing(zone):
    client, _, _, (one, other) = zone
    promise = word(zone, one)
    with pytest.raises(ChainError, match="due by block"):
        is_omitted(promise, client)
    due = word(zone, one, 0)
    assert is_omitted(due, client)
    with pytest.raises(ChainError, match="acknowledgement"):
        is_omitted(replace(due, proposal=other), client)
    with pytest.raises(ChainError, match="acknowledgement"):
        is_omitted(replace(due, deadline=due.deadline - 1), client)
    with pytest.raises(ChainError, match="acknowledgement"):
        is_omitted(replace(due, signature=due.signature[:64]), client)
