"""A small town of agents on an embedded chain, and what they need of the world around them."""

import pytest

from skyrelay.airspace.law import Law
from skyrelay.chain.client import IovClient, Role, Settings
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.core.scenario import Energy, Selection
from skyrelay.core.zones import ZoneGrid
from skyrelay.policy import Policy
from skyrelay.protocol.coordinator import ZoneCoordinator
from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import Fix, Phase, Tick
from skyrelay.protocol.model_card import chain_card
from skyrelay.protocol.uav import UavAgent
from skyrelay.protocol.vehicle import VehicleAgent
from skyrelay.store.local import LocalStore

GRID = ZoneGrid(0.0, 0.0, 2000.0, 2, 1)
LAW = Law(GRID, reach=900.0, speed=30.0, seconds=2.0, energy=Energy(), walls=None, patience=10.0)
SELECTION = Selection(max_distance=900.0)
UAVS = {"u1": (500.0, 500.0), "u2": (900.0, 900.0), "u3": (1200.0, 500.0), "u4": (3000.0, 1000.0)}
VEHICLES = {
    "v1": (450.0, 600.0),
    "v2": (700.0, 400.0),
    "v3": (1300.0, 700.0),
    "v4": (950.0, 1000.0),
    "v5": (3100.0, 900.0),
}


class Town:
    """Four UAVs, five vehicles, two zones; `agents` in the order of the host."""

    def __init__(self, folder, selection=SELECTION):
        self.selection = selection
        self.policy = Policy.builtin("generalist")
        self.chain = EmbeddedChain()
        boss = self.chain.account("boss")
        self.client = IovClient.deploy(self.chain, Settings.of(selection, channels=len(self.policy.card.maps)), boss)
        for role in (Role.COORDINATOR, Role.PUBLISHER):
            self.client.execute([self.client.grant_role(boss, role, boss)])
        self.store = LocalStore(folder)
        cid = self.store.put(self.policy.content)
        self.client.execute([self.client.register_model(boss, bytes(cid), chain_card(self.policy.card))])
        self.events = []
        self.agents = self.fresh_agents()
        self.host = Host(self.agents, self.client, self.store, self.events.append)
        self.places = UAVS | VEHICLES

    def fresh_agents(self):
        vehicles = [
            VehicleAgent(name, self.chain.account(name), 1500 + 100 * row, 100 * row, GRID, self.selection)
            for row, name in enumerate(VEHICLES)
        ]
        uavs = [
            UavAgent(name, self.chain.account(name), 1 + (name == "u4"), 100.0, 4000, LAW, lambda _: self.policy)
            for name in UAVS
        ]
        boss = self.chain.account("boss")
        return [*vehicles, *uavs, *(ZoneCoordinator(zone, boss, 60) for zone in GRID.ids)]

    def __getitem__(self, name):
        return next(agent for agent in self.agents if agent.name == name)

    def tell_positions(self, battery=90.0):
        for agent in self.agents:
            if agent.name in self.places:
                agent.receive(Fix(self.places[agent.name], battery))

    def tick(self, *phases, step=0):
        for phase in phases:
            self.host.tick(Tick(phase, step=step, time=step * LAW.seconds))

    def select(self):
        self.tick(Phase.CLOSE, Phase.LAND, Phase.REPORT, Phase.PROPOSE, Phase.ALLOCATE, Phase.DETERMINE)

    def fly(self, step, heard=lambda beacon: True):
        self.tick(Phase.BEACON, step=step)
        self.host.hear(beacon for beacon in self.host.take_beacons() if heard(beacon))
        self.tick(Phase.DECIDE, step=step)
        return self.host.take_moves()


@pytest.fixture
def town(tmp_path):
    return founded(tmp_path)


@pytest.fixture
def town_with(tmp_path):
    """A town of another selection, by its keys."""
    return lambda **keys: founded(tmp_path, SELECTION.model_copy(update=keys))


def founded(folder, selection=SELECTION):
    town = Town(folder, selection)
    town.tell_positions()
    town.tick(Phase.JOIN)
    return town
