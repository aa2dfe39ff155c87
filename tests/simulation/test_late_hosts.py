"""Hosts that are late, away and back, drawn at random: what the record says of it is what the chain says."""

import time
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from skyrelay.audit import audit_folder
from skyrelay.core.files import write_text
from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario, to_toml
from skyrelay.pilot.timetable import Timetable
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import Phase
from skyrelay.protocol.uav import UavAgent
from skyrelay.protocol.vehicle import VehicleAgent
from skyrelay.protocol.zone_view import read_zone
from skyrelay.report import write_report
from skyrelay.runfolder.folder import SCENARIO
from skyrelay.runfolder.manifest import write_manifest
from skyrelay.simulation.consortium import Consortium, chain_facts
from skyrelay.simulation.run import Run, without_credentials, world_agents
from skyrelay.simulation.world import World
from skyrelay.store.cid import Cid

SETS = ["mobility.penetration=0.04", "fleet.uavs=12", "coordination.steps=24", "coordination.period_steps=6"]
TICKS = 160
TOO_LATE = 2
"""A tick so many ticks ago is left out, as a host by the clock on the wall leaves out what has been over for a slot."""


class LateHosts:
    """Real hosts on one chain, each with ticks that it has yet to do; the world waits for nobody (`FreeHosts`)."""

    def __init__(self, hosts, client, heard, timetable, away):
        self._hosts, self._client, self._heard, self._away = hosts, client, heard, away
        self._timetable = iter(timetable)
        self._todo = {name: deque() for name in hosts}
        self._now = self._next_block = 0
        self._moves, self._choices, self._fixes = {}, {}, {}
        self.chain_seconds = 0.0

    @property
    def transactions(self):
        return sum(host.transactions for host in self._hosts.values())

    @property
    def gas_used(self):
        return sum(host.gas_used for host in self._hosts.values())

    def tell(self, fixes):
        self._fixes = fixes

    def spread(self):
        """Nothing: beacons are heard by who is there when they are sent."""

    def take_fixes(self):
        return {}

    def advise(self, advice):
        raise AssertionError("the contract selects")

    def take_moves(self):
        moves, self._moves = self._moves, {}
        return moves

    def choices(self):
        return self._choices

    def view(self, zone):
        return read_zone(self._client, zone)

    def cid_of(self, model):
        return Cid.from_bytes(self._client.model(model).cid, "model")

    def tick(self, tick, timestamp):
        if tick.phase is Phase.CLOSE:
            self._choices = {}
        due = None
        while due != tick:
            due = next(self._timetable).tick
            for todo in self._todo.values():
                todo.append((self._now, due))
            there = [name for name in self._hosts if (name, self._now) not in self._away]
            np.random.default_rng(self._now).shuffle(there)
            for name in there:
                while self._todo[name]:
                    began, wanted = self._todo[name].popleft()
                    if self._now - began <= TOO_LATE:
                        self._work(name, wanted, due.step, timestamp, there)
            self._now += 1
        last = self._client.chain.block_number
        for event in self._client.events(self._next_block, last):
            self._heard(event)
        self._next_block = last + 1

    def _work(self, name, tick, step, timestamp, there):
        host = self._hosts[name]
        host.tell(self._fixes)
        host.tick(tick, timestamp)
        beacons = host.take_beacons()
        for other in there:
            self._hosts[other].hear(beacons)
        if tick.phase is Phase.PROPOSE:
            self._choices |= host.choices()
        moves = host.take_moves()
        if tick.step == step:
            self._moves |= moves


def away(rng):
    """When which host is away: for a tick or three, and UAVs for longer than a period as well."""
    times = set()
    for name in ("vehicles", "uavs-1", "uavs-2", "coordinator"):
        at = 0
        while at < TICKS:
            at += rng.choice([5, 10, 20, 40])
            length = rng.choice([1, 2, 3, 30] if name.startswith("uavs") else [1, 2, 3])
            times |= {(name, tick) for tick in range(at, at + length)}
            at += length
    return times


@pytest.mark.survival
@pytest.mark.parametrize("seed", range(4))
def test_whoever_is_late_or_away_the_audit_agrees(tmp_path, seed):
    """By each of these the record once said something else than the chain."""
    begin = time.monotonic()
    folder = tmp_path / "run"
    folder.mkdir()
    world = World.of(load_scenario("bologna", [*SETS, "selection.rounds=2"]))
    elsewhere = world.scenario.chain.model_copy(update={"url": "http://127.0.0.1:1"})  # as a run by processes says
    there = replace(world, scenario=world.scenario.model_copy(update={"chain": elsewhere}))
    write_text(folder / SCENARIO, to_toml(without_credentials(there.scenario)))
    with Consortium(world.scenario, folder) as consortium:
        run = Run(there, consortium.account)
        agents = world_agents(world, consortium.account, consortium.hangar.load)
        uavs = [agent for agent in agents if isinstance(agent, UavAgent)]
        groups: dict[str, list[Agent]] = {
            "vehicles": [agent for agent in agents if isinstance(agent, VehicleAgent)],
            "uavs-1": [*uavs[:6]],
            "uavs-2": [*uavs[6:]],
            "coordinator": [agent for agent in agents if not isinstance(agent, UavAgent | VehicleAgent)],
        }
        consortium.found()
        hosts = {
            name: Host(
                members,
                consortium.client,
                consortium.store,
                lambda _: None,
                lambda _agent, _error: None,
                alone=False,
            )
            for name, members in groups.items()
        }
        for host in hosts.values():
            host.catch_up()
        timetable = Timetable.of(world.scenario, 0.0, 1.0, 1.0)
        run.hosts = LateHosts(hosts, consortium.client, run.hear, timetable, away(np.random.default_rng(seed)))
        run.play(Silent())
        facts = chain_facts(consortium.chain, consortium.client.address)
        run.write(folder, consortium.parties(), consortium.deciders(), facts, begin)
        write_report(folder)
        write_manifest(folder, None)
    report = audit_folder(folder)
    assert report.differences == []
    assert report.checked["rows of candidates.parquet"] > 100
