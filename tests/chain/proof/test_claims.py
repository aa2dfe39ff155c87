"""Selections by claim: what the audit says of them without the chain's help, and what a challenger proves on it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import SentTransaction
from skyrelay.chain.claims import BOND, SUPPLY, ClaimClient, Share, read_claim
from skyrelay.chain.client import IovClient, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.proof.reference import ReferenceContract
from skyrelay.chain.typed_data import Proposal, SignedProposal, sign_proposal
from skyrelay.protocol.claims import ClaimBook

ZONE = 1
OPEN, FINAL, VOID = 1, 2, 3


class World:
    """A zone of two UAVs and six vehicles, whose coordinator claims."""

    def __init__(self, chain: EmbeddedChain) -> None:
        self.chain, self.keyring = chain, Keyring(b"c" * 32)
        self.admin, self.challenger = chain.account("admin"), chain.account("challenger")
        self.client = IovClient.deploy(chain, Settings(settling=15), self.admin)
        self.claims = ClaimClient.deploy(self.client, self.admin)
        self.client.execute([self.client.grant_role(self.admin, Role.COORDINATOR, self.admin)])
        self.uavs = sorted(chain.account(f"uav {i}") for i in range(2))
        record = UavRecord(1500.0, 100.0, 100, 90.0, 5_000, ZONE)
        self.client.execute([self.client.register_uav(uav, record) for uav in self.uavs])
        self.vehicles = [self.keyring.account(f"vehicle {i}") for i in range(6)]
        self.client.execute([self.client.register_vehicle(v, VehicleRecord(0.0, 0.0, 1, 0)) for v in self.vehicles])
        self.book = ClaimBook(self.claims)

    def sign(self, vehicle: int, uav: int, demand: int = 2_000, payment: int = 100) -> SignedProposal:
        info = self.client.zone_info(ZONE)
        assert info is not None
        proposal = Proposal(self.uavs[uav], ZONE, info.round, 14_900 + vehicle, 1_000, payment, demand, 0)
        chain_id = self.chain.chain_id
        return sign_proposal(self.keyring, self.vehicles[vehicle], proposal, self.client.address, chain_id)

    def claim(self, signed: list[SignedProposal], change=lambda shares: shares) -> None:
        """What the book makes of proposals, or something else."""
        taken = self.book.take(signed)
        assert len(taken) == len(signed)
        honest = read_claim(_sent(self.book.call(self.admin, ZONE)))
        assert honest is not None
        shares = change(list(honest.shares))
        call = self.claims.claim(self.admin, ZONE, honest.round, honest.as_of, shares)
        events = self.client.events_of(self.client.execute([call]))
        self.book.decided(ZONE, events[-1])

    def audit(self) -> tuple[list[str], dict[str, int]]:
        """The differences, and what was compared."""
        reference = ReferenceContract(
            lambda _: None,
            lambda _: 0,
            lambda _: None,
            lambda event: read_claim(self.chain.transaction(event.block, event.transaction)),
            (self.client.address, self.chain.chain_id),
        )
        reference.follow(self.client.events())
        return [str(difference) for difference in reference.differences], dict(reference.checked)

    def challenge(self, uav: int) -> None:
        part = self.claims.part(ZONE, 1, self.uavs[uav])
        self.client.execute([self.claims.challenge(self.challenger, ZONE, 1, part)])


def _sent(call):
    return SentTransaction(call.sender, 0, call.to, call.data)


@pytest.fixture
def world():
    with EmbeddedChain(timestamp=1) as chain:
        yield World(chain)


def test_honest_claims_hold_and_the_bond_comes_back(world):
    world.claim([world.sign(v, v % 2) for v in range(5)])
    world.claim([world.sign(5, 0, 500), world.sign(0, 1, 600)])  # UAV 0 had no room for vehicle 0
    differences, checked = world.audit()
    assert not differences
    assert (checked["claims"], checked["proposals by signature"]) == (2, 7)
    info = world.client.zone_info(ZONE)
    assert info is not None
    assert (info.selected_uavs, info.selected_vehicles) == (2, 6)
    for uav in (0, 1):
        part = world.claims.part(ZONE, 1, world.uavs[uav])
        call = world.claims.challenge(world.challenger, ZONE, 1, part)
        assert not world.chain.send([call])[0].status
    assert world.claims.balance(world.admin) == SUPPLY - BOND
    while not world.chain.send([world.claims.finalise(world.challenger, ZONE, 1)])[0].status:
        assert world.claims.state(ZONE, 1) == OPEN
    assert world.claims.state(ZONE, 1) == FINAL
    assert world.claims.balance(world.admin) == SUPPLY


def serve_another(shares: list[Share]) -> list[Share]:
    return [replace(shares[0], selected=shares[0].selected ^ 0b110), *shares[1:]]


def pay_more(shares: list[Share]) -> list[Share]:
    """As if the vehicle had signed it."""
    first = shares[0].proposals[0]
    forged = replace(first, proposal=replace(first.proposal, payment=700))
    return [replace(shares[0], proposals=(forged, *shares[0].proposals[1:])), *shares[1:]]


def count_less(shares: list[Share]) -> list[Share]:
    return [replace(shares[0], before=1), *shares[1:]]


@pytest.mark.parametrize("cheat", [serve_another, pay_more, count_less])
def test_a_wrong_claim_is_named_offline_and_proved_on_the_chain(world, cheat):
    world.claim([world.sign(v, v % 2) for v in range(6)], cheat)
    differences, _ = world.audit()
    assert differences
    world.challenge(0)
    assert world.claims.state(ZONE, 1) == VOID
    assert world.claims.balance(world.challenger) == BOND // 2
    differences, checked = world.audit()
    assert not differences  # what was wrong is void, and the chain says so
    assert checked["claims proved wrong"] == 1
    info = world.client.zone_info(ZONE)
    assert info is not None
    assert (info.selected_uavs, info.selected_vehicles) == (0, 0)
    # The strict way: the vehicle's own transaction, in the same period.
    vehicle = world.chain.account("vehicle")
    world.client.execute([world.client.register_vehicle(vehicle, VehicleRecord(1490.0, 100.0, 1, ZONE))])
    world.client.execute([world.client.submit_veh_selection(vehicle, world.uavs[0], 1_000, info.round)])
    world.client.execute([world.client.allocate_zone(world.admin, ZONE, 10)])
    assert world.client.selections(world.uavs)[world.uavs[0]] == [vehicle]
    assert not world.audit()[0]


def test_a_vehicle_at_two_uavs_is_named(world):
    one, two = world.sign(0, 0), world.sign(0, 1)
    assert [event.args["uav"] for event in world.book.take([one, two])] == [world.uavs[0]]  # an honest book takes one
    shares = [Share(uav, 1, 0, (signed,)) for uav, signed in zip(world.uavs, (one, two), strict=True)]
    as_of = world.chain.block_number
    world.client.execute([world.claims.claim(world.admin, ZONE, 1, as_of, shares)])
    differences, _ = world.audit()
    assert any("in the round before" in difference for difference in differences)


def test_a_reputation_of_later_changes_nothing(world):
    world.claim([world.sign(v, v % 2) for v in range(6)])
    world.client.execute([world.client.grant_role(world.admin, Role.REPUTATION, world.admin)])
    world.client.execute([world.client.set_reputations(world.admin, {world.vehicles[0]: 100.0})])
    world.claim([world.sign(0, 1)])  # rejected before, and rated anew: as of the period's first claim, all the same
    assert not world.audit()[0]
    part = world.claims.part(ZONE, 1, world.uavs[1])
    assert not world.chain.send([world.claims.challenge(world.challenger, ZONE, 1, part)])[0].status


def test_what_the_contract_checks_at_once_needs_no_bond(world):
    world.book = ClaimBook(world.claims, proven=True)
    world.book.take([world.sign(v, v % 2) for v in range(6)])
    call = world.book.call(world.admin, ZONE)
    honest = read_claim(_sent(call))
    assert honest is not None
    wrong = world.claims.prove(world.admin, ZONE, honest.round, serve_another(list(honest.shares)))
    assert not world.chain.send([wrong])[0].status
    world.client.execute([call])
    differences, checked = world.audit()
    assert not differences
    assert (checked["claims"], checked["proposals by signature"]) == (1, 6)
    info = world.client.zone_info(ZONE)
    assert info is not None
    assert (info.selected_uavs, info.selected_vehicles) == (2, 4)
    assert world.claims.state(ZONE, 1) == FINAL
    assert world.claims.balance(world.admin) == SUPPLY
