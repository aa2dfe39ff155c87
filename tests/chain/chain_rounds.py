"""A small world on the chain that uses every function of the contract, and the run folder it leaves."""

from __future__ import annotations

import hashlib
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Call, Chain
from skyrelay.chain.client import IovClient, ModelCard, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.typed_data import Proposal, sign_proposal

ZONES = (1, 2)


def cid(name: str) -> bytes:
    return bytes([1, 0x55, 0x12, 0x20]) + hashlib.sha256(name.encode()).digest()


def card(uavs: tuple[int, int], score: float) -> ModelCard:
    return ModelCard(uavs[0], uavs[1], 1, 40, 19, 6, 9, score)


class World:
    """Members with random records, and the parties."""

    def __init__(
        self, chain: Chain, seed: int = 1, uavs: int = 6, vehicles: int = 30, keyring: Keyring | None = None
    ) -> None:
        self.chain = chain
        self.keyring = keyring or Keyring(b"k" * 32)
        """Of the vehicles that sign: the chain's own where it signs transactions."""
        self.random = random.Random(seed)  # noqa: S311
        self.time = 100
        self.admin, self.coordinator, self.publisher, self.authority = (
            chain.account(name) for name in ("admin", "coordinator", "publisher", "authority")
        )
        self.client = IovClient.deploy(chain, Settings(rating_step=1.5), self.admin, self.time)
        self.uavs = [chain.account(f"uav {i}") for i in range(uavs)]
        self.vehicles = [chain.account(f"vehicle {i}") for i in range(vehicles)]
        self.zone_of: dict[str, int] = {}

    def do(self, *calls: Call) -> None:
        self.time += 1
        self.client.execute(calls, self.time)

    def uav_record(self, zone: int) -> UavRecord:
        r = self.random
        return UavRecord(r.uniform(0, 2000), r.uniform(0, 2000), 100, r.uniform(1, 100), r.uniform(1000, 20_000), zone)

    def vehicle_record(self, zone: int) -> VehicleRecord:
        r = self.random
        return VehicleRecord(r.uniform(0, 2000), r.uniform(0, 2000), r.uniform(0, 700), zone)

    def found(self) -> None:
        """Roles, models, members."""
        client, r = self.client, self.random
        parties = {
            Role.COORDINATOR: self.coordinator,
            Role.PUBLISHER: self.publisher,
            Role.REPUTATION: self.authority,
            Role.REGISTRAR: self.authority,
        }
        self.do(*[client.grant_role(self.admin, role, account) for role, account in parties.items()])
        self.do(
            client.register_model(self.publisher, cid("a"), card((1, 3), -4.5)),
            client.register_model(self.publisher, cid("b"), card((2, 5), -4.25)),
            client.register_model(self.publisher, cid("c"), card((2, 5), -4.25)),
        )
        for member in [*self.uavs, *self.vehicles]:
            self.zone_of[member] = r.choice(ZONES)
        self.do(*[client.register_uav(u, self.uav_record(self.zone_of[u])) for u in self.uavs])
        self.do(*[client.register_vehicle(v, self.vehicle_record(self.zone_of[v])) for v in self.vehicles])
        self.do(client.set_reputations(self.authority, {m: r.uniform(1, 100) for m in [*self.uavs, *self.vehicles]}))

    def propose(self, share: float) -> None:
        """Vehicles without a proposal, or with a rejected one, ask a UAV of their zone."""
        client, r = self.client, self.random
        open_uavs = {zone: client.zone_uavs(zone) for zone in ZONES}
        rounds = {zone: info.round for zone in ZONES if (info := client.zone_info(zone)) is not None}
        calls = []
        selections = client.vehicle_selections(self.vehicles)
        for vehicle, (status, asked, _) in zip(self.vehicles, selections, strict=True):
            zone = self.zone_of[vehicle]
            candidates = [u for u in open_uavs[zone] if u != asked]
            if status in (0, 3) and candidates and r.random() < share:
                demand = r.uniform(1000, 4000)
                calls.append(client.submit_veh_selection(vehicle, r.choice(candidates), demand, rounds[zone]))
        self.do(*calls)

    def propose_signed(self, zone: int = 1) -> None:
        """Vehicles with keys of their own come, sign, and have others hand in what they signed."""
        client, r = self.client, self.random
        uavs, info = client.zone_uavs(zone), client.zone_info(zone)
        names = [f"signer {self.time} {i}" for i in range(4)]
        vehicles = [self.keyring.account(name) for name in names]
        for name in names:
            self.chain.account(name)  # a node's chain signs for whom it has been asked about
        for vehicle in vehicles:
            self.zone_of[vehicle] = zone
        self.do(*[client.register_vehicle(v, self.vehicle_record(0)) for v in vehicles])
        signed = [
            sign_proposal(
                self.keyring,
                vehicle,
                Proposal(r.choice(uavs), zone, info.round, -10 * i, 70, 600 + i, 2_000, told.timestamp),
                client.address,
                self.chain.chain_id,
            )
            for i, (vehicle, told) in enumerate(zip(vehicles, client.vehicle_infos(vehicles), strict=True))
        ]
        self.do(client.submit_signed(self.publisher, [*signed, signed[0]]))

    def allocate(self, piece: int) -> None:
        """Every zone, in pieces; after the first piece anyone goes on."""
        for zone in ZONES:
            done, sender = self.client.zone_info(zone) is None, self.coordinator
            while not done:
                self.time += 1
                receipts = self.client.execute([self.client.allocate_zone(sender, zone, piece)], self.time)
                sender = self.publisher
                done = any(event.name == "ZoneAllocated" for event in self.client.events_of(receipts))

    def play(self, periods: int = 2, signs: bool = True) -> None:
        """Periods of two rounds, with members that move, leave and are rated."""
        client, r = self.client, self.random
        for period in range(periods):
            self.propose(0.8)
            if signs:
                self.propose_signed()
            self.allocate(7)
            for vehicle in r.sample(self.vehicles, 3):  # some leave their zone, and with it their proposal
                self.zone_of[vehicle] = 3 - self.zone_of[vehicle]
                self.do(client.update_vehicle_info(vehicle, self.vehicle_record(self.zone_of[vehicle])))
            self.propose(0.8)
            self.allocate(100)
            for zone in ZONES:
                self.do(client.determine_mdrl_model(self.coordinator, zone))
            if period == 0:
                self.do(client.retire_model(self.publisher, client.models()[1].model_id))
                self.do(client.reset_uav_submission(self.uavs[0], self.uavs[0]))
                self.do(client.update_uav_zone(self.uavs[1], 3 - self.zone_of[self.uavs[1]]))
                self.zone_of[self.uavs[1]] = 3 - self.zone_of[self.uavs[1]]
            matched = client.selections(self.uavs)
            self.do(*[client.reset_lists_for_zone(self.coordinator, zone) for zone in ZONES])
            for uav, vehicles in matched.items():
                for vehicle in vehicles[:1]:
                    rate = [client.rate_vehicle(uav, vehicle, index, True) for index in range(12)]
                    self.do_or_not(client.rate_uav(vehicle, uav, r.random() < 0.5), *rate)
            self.do(*[client.update_uav_info(u, self.uav_record(0)) for u in self.uavs])
            self.do(*[client.update_vehicle_info(v, self.vehicle_record(self.zone_of[v])) for v in self.vehicles])
        self.do(client.suspend_member(self.authority, self.uavs[2]), client.suspend_zone(self.authority, 1))
        self.do(client.set_zone_coordinator(self.admin, 2, self.publisher))
        self.do(client.revoke_role(self.admin, Role.PUBLISHER, self.publisher))
        self.do(client.begin_admin_transfer(self.admin, self.authority))

    def do_or_not(self, *calls: Call) -> None:
        """What the contract may refuse: the refusal is recorded like the rest."""
        self.time += 1
        self.chain.send(calls, self.time)


def write_run(folder: Path, build: Callable[[World], None] | None = None, **sizes: Any) -> World:
    """A run folder as `skyrelay run` leaves it, as far as the audit reads it."""
    with EmbeddedChain(folder / "chain") as chain:
        world = World(chain, **sizes)
        world.found()
        (build or World.play)(world)
        events = world.client.events()
        columns: dict[str, list[Any]] = {
            "block": [e.block for e in events],
            "tx": [e.transaction for e in events],
            "log": [e.index for e in events],
            "step": [0 for _ in events],
            "name": [e.name for e in events],
            "args": [json.dumps(e.args) for e in events],
        }
        pq.write_table(pa.table(columns), folder / "events.parquet", write_page_checksum=True)
        summary = {"chain_head": chain.head, "blocks": chain.block_number, "contract": world.client.address}
        (folder / "summary.json").write_text(json.dumps(summary))
        return world
