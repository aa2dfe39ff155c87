"""The contract beside the Python reference: the same actions, good and bad, and the same state after each.

The reference below keeps lists and dictionaries where the contract keeps packed words, and takes every number from
`skyrelay.selection.fixed_point`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient, ProposalStatus, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.typed_data import Proposal, sign_proposal
from skyrelay.selection.fixed_point import (
    FixedParameters,
    allocate_fixed,
    distance_fixed,
    fixed_weights,
    qov_fixed,
    score_fixed,
)

WEIGHTS = (0.4, 0.3, 0.2, 0.1)
PARAMETERS = FixedParameters(fixed_weights(WEIGHTS), 4_000, 700, 30_000)
UAVS, VEHICLES, ZONES = 4, 10, 2
uav_numbers = st.integers(0, UAVS - 1)
vehicle_numbers = st.integers(0, VEHICLES - 1)
zones = st.integers(1, ZONES)
coordinates = st.integers(-14_000, 14_000)
# Round numbers, so that sums meet bandwidths exactly, equal scores and the limits occur.
demands = st.sampled_from([0, 1, 500, 1_000, 1_500, 4_000, 4_001]) | st.integers(1, 4_000)
bandwidths = st.sampled_from([0, 500, 1_000, 2_500, 4_000]) | st.integers(0, 9_000)


@dataclass
class Entry:
    """One proposal; one that was selected and given up has no demand."""

    vehicle: int
    demand: int
    score: int
    status: ProposalStatus = ProposalStatus.PENDING


@dataclass
class ReferenceUav:
    x: int
    y: int
    battery: int
    bandwidth: int
    zone: int
    entries: list[Entry] = field(default_factory=list)
    closed: tuple[int, int] | None = None
    """Zone and period in which its proposals were voided."""

    def committed(self) -> int:
        return sum(entry.demand for entry in self.entries if entry.status is ProposalStatus.SELECTED)


@dataclass
class ReferenceVehicle:
    x: int
    y: int
    payment: int
    zone: int
    reputation: int = 5_000
    proposal: tuple[int, Entry] | None = None


class Reference:
    """Algorithm 2 with rounds and periods, written for reading."""

    def __init__(self) -> None:
        self.uavs: list[ReferenceUav] = []
        self.vehicles: list[ReferenceVehicle] = []
        self.rounds = dict.fromkeys(range(1, ZONES + 1), 1)
        self.periods = dict.fromkeys(range(1, ZONES + 1), 1)
        self.waiting: set[int] = set()

    def submit(self, v: int, u: int, demand: int, round_: int) -> str | None:
        """The contract's error, or None."""
        vehicle, uav = self.vehicles[v], self.uavs[u]
        if uav.zone == 0 or vehicle.zone != uav.zone:
            return "DifferentZone"
        if round_ != self.rounds[uav.zone]:
            return "WrongRound"
        if uav.battery == 0:
            return "UAVEmpty"
        if vehicle.proposal is not None:
            to, entry = vehicle.proposal
            if entry.status is ProposalStatus.PENDING:
                return "ProposalOpen"
            if entry.status is ProposalStatus.SELECTED:
                return "AlreadySelected"
            if to == u:
                return "AlreadyRejected"
        if not 1 <= demand <= PARAMETERS.max_demand:
            return "OutOfRange"
        distance = distance_fixed(vehicle.x - uav.x, vehicle.y - uav.y)
        if distance > PARAMETERS.max_distance * 10**15:
            return "TooFar"
        if uav.closed == (uav.zone, self.periods[uav.zone]):
            return "UAVClosed"
        self.waiting.add(uav.zone)
        qov = qov_fixed(PARAMETERS, demand, vehicle.payment, vehicle.reputation, distance)
        entry = Entry(v, demand, score_fixed(qov, demand))
        uav.entries.append(entry)
        vehicle.proposal = (u, entry)
        return None

    def allocate(self, zone: int) -> None:
        for uav in self.uavs:
            if uav.zone != zone or all(entry.status is not ProposalStatus.PENDING for entry in uav.entries):
                continue
            live = [e for e in uav.entries if e.status in (ProposalStatus.PENDING, ProposalStatus.SELECTED)]
            accepted = allocate_fixed(uav.bandwidth, [(e.score, e.demand) for e in live])
            for index, entry in enumerate(live):
                entry.status = ProposalStatus.SELECTED if index in accepted else ProposalStatus.REJECTED
        self.rounds[zone] += 1
        self.waiting.discard(zone)

    def reset(self, zone: int) -> str | None:
        if zone in self.waiting:
            return "ProposalsUndecided"
        for u, uav in enumerate(self.uavs):
            if uav.zone == zone:
                self.void(u)
        self.rounds[zone] += 1
        self.periods[zone] += 1
        return None

    def void(self, u: int) -> None:
        uav = self.uavs[u]
        if uav.entries:
            uav.closed = (uav.zone, self.periods.get(uav.zone, 0))
        uav.entries.clear()
        for vehicle in self.vehicles:
            if vehicle.proposal is not None and vehicle.proposal[0] == u:
                vehicle.proposal = None

    def move_vehicle(self, v: int, x: int, y: int, payment: int, zone: int) -> str | None:
        vehicle = self.vehicles[v]
        if vehicle.proposal is not None:
            u, entry = vehicle.proposal
            if entry.status is not ProposalStatus.REJECTED:
                if zone == vehicle.zone:
                    return "TermsFrozen"
                self.give_up(self.uavs[u].entries, entry)
                vehicle.proposal = None
        vehicle.x, vehicle.y, vehicle.payment, vehicle.zone = x, y, payment, zone
        return None

    @staticmethod
    def give_up(entries: list[Entry], entry: Entry) -> None:
        """An open proposal's place goes to the last one; a selection stays without its demand."""
        if entry.status is ProposalStatus.SELECTED:
            entry.demand, entry.status = 0, ProposalStatus.NONE
            return
        place = next(i for i, other in enumerate(entries) if other is entry)
        last = entries.pop()
        if last is not entry:
            entries[place] = last

    def update_uav(self, u: int, x: int, y: int, battery: int, bandwidth: int) -> str | None:
        uav = self.uavs[u]
        if battery == 0:
            self.void(u)
        elif uav.entries and bandwidth < uav.bandwidth:
            return "BandwidthCommitted"
        uav.x, uav.y, uav.battery, uav.bandwidth = x, y, battery, bandwidth
        return None

    def move_uav(self, u: int, zone: int) -> str | None:
        if self.uavs[u].zone == zone:
            return "SameZone"
        self.void(u)
        self.uavs[u].zone = zone
        return None


class SideBySide(RuleBasedStateMachine):
    """Every rule acts on both; the invariant compares them."""

    @initialize(data=st.data())
    def start(self, data: st.DataObject) -> None:
        self.chain = EmbeddedChain(timestamp=1_000)
        account = self.chain.account
        self.admin = account("admin")
        self.uav_names = [account(f"uav {i}") for i in range(UAVS)]
        self.keyring = Keyring(b"differential".ljust(32, b"."))
        self.vehicle_names = [self.keyring.account(f"vehicle {i}") for i in range(VEHICLES)]
        self.client = IovClient.deploy(self.chain, Settings(qov_weights=WEIGHTS), self.admin)
        self.reference = Reference()
        grants = [self.client.grant_role(self.admin, role, self.admin) for role in Role if role is not Role.ADMIN]
        calls = []
        for i, name in enumerate(self.uav_names):
            uav = ReferenceUav(i * 100, 0, 9_000, 1_000 + 1_500 * i, 1 + i % ZONES)
            self.reference.uavs.append(uav)
            calls.append(self.client.register_uav(name, self._uav_record(uav)))
        for i, name in enumerate(self.vehicle_names):
            x, y = data.draw(st.tuples(coordinates, coordinates) | st.just((0, 0)))
            payment = data.draw(st.integers(0, 700) | st.just(100))
            vehicle = ReferenceVehicle(x, y, payment, 1 + i % ZONES)
            self.reference.vehicles.append(vehicle)
            calls.append(self.client.register_vehicle(name, self._vehicle_record(vehicle)))
        self.client.execute(grants + calls)

    def teardown(self) -> None:
        if hasattr(self, "chain"):
            self.chain.close()

    @staticmethod
    def _uav_record(uav: ReferenceUav) -> UavRecord:
        return UavRecord(uav.x / 10, uav.y / 10, 100, uav.battery / 100, uav.bandwidth, uav.zone)

    @staticmethod
    def _vehicle_record(vehicle: ReferenceVehicle) -> VehicleRecord:
        return VehicleRecord(vehicle.x / 10, vehicle.y / 10, vehicle.payment, vehicle.zone)

    def _agree(self, call, expected: str | None) -> None:
        receipt = self.chain.send([call])[0]
        found = None if receipt.status else self.client.refusal(call, receipt).error
        assert found == expected

    @rule(v=vehicle_numbers, u=uav_numbers, demand=demands, late=st.sampled_from([0, 0, 0, -1, 1]))
    def submit(self, v: int, u: int, demand: int, late: int) -> None:
        round_ = self.reference.rounds.get(self.reference.uavs[u].zone, 1) + late
        call = self.client.submit_veh_selection(self.vehicle_names[v], self.uav_names[u], demand, round_)
        self._agree(call, self.reference.submit(v, u, demand, round_))

    @rule(
        data=st.data(),
        u=uav_numbers,
        place=st.tuples(coordinates, coordinates),
        payment=st.sampled_from([0, 350, 700, 701]),
        demand=demands,
        late=st.sampled_from([0, 0, 0, 1]),
        stale=st.sampled_from([0, 0, 0, 1]),
    )
    def submit_signed(
        self,
        data: st.DataObject,
        u: int,
        place: tuple[int, int],
        payment: int,
        demand: int,
        late: int,
        stale: int,
    ) -> None:
        """Several sign with where they are now, somebody hands it in: each as if it had moved and then proposed."""
        uav = self.reference.uavs[u]
        signers = data.draw(st.lists(vehicle_numbers, min_size=1, max_size=4))
        told = self.client.vehicle_infos([self.vehicle_names[v] for v in signers])
        round_ = self.reference.rounds.get(uav.zone, 1) + late
        signed = [
            sign_proposal(
                self.keyring,
                self.vehicle_names[v],
                Proposal(self.uav_names[u], uav.zone, round_, *place, payment, demand, info.timestamp - stale),
                self.client.address,
                self.chain.chain_id,
            )
            for v, info in zip(signers, told, strict=True)
        ]
        receipts = self.client.execute([self.client.submit_signed(self.admin, signed)])
        taken = [event.args["vehicle"] for event in self.client.events_of(receipts)]
        expected = []
        for v in dict.fromkeys(signers):  # who signs the same twice is taken once
            if stale or payment > PARAMETERS.max_payment:
                continue
            vehicle = self.reference.vehicles[v]
            before = replace(vehicle)
            vehicle.x, vehicle.y, vehicle.payment, vehicle.zone = *place, payment, uav.zone
            if self.reference.submit(v, u, demand, round_) is None:
                expected.append(self.vehicle_names[v])
            else:
                self.reference.vehicles[v] = before
        assert taken == expected

    @rule(
        zone=zones,
        asked=st.lists(demands, min_size=VEHICLES, max_size=VEHICLES),
        choices=st.lists(st.integers(0, 1), min_size=VEHICLES, max_size=VEHICLES),
        piece=st.sampled_from([1, 2, 5, 1_000]),
    )
    def whole_round(self, zone: int, asked: list[int], choices: list[int], piece: int) -> None:
        """All vehicles of a zone that are free propose, each to one of two UAVs, and the zone is allocated."""
        for v, vehicle in enumerate(self.reference.vehicles):
            rejected_by = vehicle.proposal[0] if vehicle.proposal else None
            candidates = [u for u, uav in enumerate(self.reference.uavs) if uav.zone == zone and u != rejected_by]
            if vehicle.zone == zone and candidates:
                self.submit(v, candidates[choices[v] % len(candidates)], asked[v], 0)
        self.allocate(zone, piece)

    @rule(data=st.data(), zone=st.integers(0, ZONES))
    def a_vehicle_with_a_proposal_moves(self, data: st.DataObject, zone: int) -> None:
        proposing = [v for v, vehicle in enumerate(self.reference.vehicles) if vehicle.proposal is not None]
        if proposing:
            v = data.draw(st.sampled_from(proposing))
            vehicle = self.reference.vehicles[v]
            self.move_vehicle(v, vehicle.x, vehicle.y, vehicle.payment, zone)

    @rule(u=uav_numbers)
    def a_uav_offers_what_it_has_promised(self, u: int) -> None:
        uav = self.reference.uavs[u]
        self.update_uav(u, uav.x, uav.y, 5_000, uav.committed())

    @rule(zone=zones, piece=st.sampled_from([1, 2, 5, 1_000]))
    def allocate(self, zone: int, piece: int) -> None:
        round_ = self.reference.rounds[zone]
        while self.client.zone_info(zone).round == round_:
            self._agree(self.client.allocate_zone(self.admin, zone, piece), None)
        self.reference.allocate(zone)

    @rule(zone=zones)
    def reset(self, zone: int) -> None:
        self._agree(self.client.reset_lists_for_zone(self.admin, zone), self.reference.reset(zone))

    @rule(v=vehicle_numbers, x=coordinates, y=coordinates, payment=st.integers(0, 700), zone=st.integers(0, ZONES))
    def move_vehicle(self, v: int, x: int, y: int, payment: int, zone: int) -> None:
        record = VehicleRecord(x / 10, y / 10, payment, zone)
        expected = self.reference.move_vehicle(v, x, y, payment, zone)
        self._agree(self.client.update_vehicle_info(self.vehicle_names[v], record), expected)

    @rule(
        u=uav_numbers,
        x=coordinates,
        y=coordinates,
        battery=st.sampled_from([0, 1, 5_000, 10_000]),
        bandwidth=bandwidths,
    )
    def update_uav(self, u: int, x: int, y: int, battery: int, bandwidth: int) -> None:
        record = UavRecord(x / 10, y / 10, 100, battery / 100, bandwidth)
        expected = self.reference.update_uav(u, x, y, battery, bandwidth)
        self._agree(self.client.update_uav_info(self.uav_names[u], record), expected)

    @rule(u=uav_numbers, zone=st.integers(0, ZONES))
    def move_uav(self, u: int, zone: int) -> None:
        self._agree(self.client.update_uav_zone(self.uav_names[u], zone), self.reference.move_uav(u, zone))

    @rule(u=uav_numbers)
    def reset_uav(self, u: int) -> None:
        self._agree(self.client.reset_uav_submission(self.uav_names[u], self.uav_names[u]), None)
        self.reference.void(u)

    @rule(v=vehicle_numbers, reputation=st.integers(0, 10_000))
    def set_reputation(self, v: int, reputation: int) -> None:
        self._agree(self.client.set_reputations(self.admin, {self.vehicle_names[v]: reputation / 100}), None)
        self.reference.vehicles[v].reputation = reputation

    @invariant()
    def same_state(self) -> None:
        for u, uav in enumerate(self.reference.uavs):
            (found,) = self.client._read("getProposals", [(self.uav_names[u],)])[0]
            expected = [
                (
                    self.vehicle_names[entry.vehicle],
                    entry.demand,
                    entry.score,
                    entry.status,
                )
                for entry in uav.entries
            ]
            assert [(e["vehicle"].lower(), e["demand"], e["score"], e["status"]) for e in found] == expected
        for info, uav in zip(self.client.uav_infos(self.uav_names), self.reference.uavs, strict=True):
            assert (info.zone, info.bandwidth) == (uav.zone, uav.bandwidth)
            assert info.available == uav.bandwidth - uav.committed() >= 0
        for zone, round_ in self.reference.rounds.items():
            about = self.client.zone_info(zone)
            members = [uav for uav in self.reference.uavs if uav.zone == zone]
            held = [sum(e.status is ProposalStatus.SELECTED for e in uav.entries) for uav in members]
            assert (about.round, about.allocating, about.uavs) == (round_, False, len(members))
            assert (about.selected_vehicles, about.selected_uavs) == (sum(held), sum(h > 0 for h in held))


SideBySide.TestCase.settings = settings(
    max_examples=50, stateful_step_count=30, deadline=None, suppress_health_check=list(HealthCheck)
)
TestSideBySide = SideBySide.TestCase


@pytest.fixture(scope="module")
def pair():
    """A vehicle and a UAV in one zone, range gate off."""
    with EmbeddedChain(timestamp=1_000) as chain:
        admin, uav, vehicle = (chain.account(name) for name in ("admin", "uav", "vehicle"))
        client = IovClient.deploy(chain, Settings(qov_weights=WEIGHTS, range_gate=False), admin)
        client.execute(
            [
                client.grant_role(admin, Role.REPUTATION, admin),
                client.register_uav(uav, UavRecord(0, 0, 100, 50, 1_000, 1)),
                client.register_vehicle(vehicle, VehicleRecord(0, 0, 0, 1)),
            ]
        )
        yield client, admin, uav, vehicle


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    position=st.tuples(*[st.integers(-(2**31), 2**31 - 1) | st.integers(-30_000, 30_000)] * 4),
    payment=st.integers(0, 700),
    demand=st.integers(1, 4_000),
    reputation=st.integers(0, 10_000),
)
def test_qov_and_score_agree_to_the_last_unit(pair, position, payment, demand, reputation):
    client, admin, uav, vehicle = pair
    vx, vy, ux, uy = position
    client.execute(
        [
            client.set_reputations(admin, {vehicle: reputation / 100}),
            client.update_vehicle_info(vehicle, VehicleRecord(vx / 10, vy / 10, payment, 1)),
            client.update_uav_info(uav, UavRecord(ux / 10, uy / 10, 100, 50, 1_000)),
        ]
    )
    qov = qov_fixed(PARAMETERS, demand, payment, reputation, distance_fixed(vx - ux, vy - uy))
    assert client._read("quality", [(vehicle, uav, demand)])[0] == [qov, score_fixed(qov, demand)]
