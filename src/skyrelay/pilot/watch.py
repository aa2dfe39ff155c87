"""An onlooker of a pilot: reads beacons from the bus and events from the chain, and holds no key of anybody's."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Annotated

from pydantic import Field

from skyrelay.airspace.law import Law
from skyrelay.chain.abi import Event
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient
from skyrelay.chain.node.chain import NodeChain
from skyrelay.core.errors import ChainError
from skyrelay.core.resolved import ResolvedScenario, resolve
from skyrelay.core.scenario import load_scenario
from skyrelay.mobility import read_streets
from skyrelay.pilot.bus import Bus, uav_key, vehicle_key
from skyrelay.pilot.config import Address, Area, BusAccess, Table, read_table
from skyrelay.pilot.picture import Picture
from skyrelay.protocol.beacon import BeaconGate, parse
from skyrelay.runfolder.feed import Feed, Record, header_of

WAIT = 0.1
"""For news, before the chain is looked at again [s]."""
SETTLED = 0.3
"""After its last beacon so long ago a step is told, whether or not the next one has begun [s]."""
ANSWER = 5.0
"""A chain that takes longer does not answer [s]."""
WAITING = 65_536
"""Beacons that may wait to be looked at."""


MemberName = Annotated[str, Field(min_length=1, max_length=256)]


class ChainToWatch(Table):
    """The contract."""

    urls: Annotated[list[str], Field(min_length=1, max_length=20)] = Field(description="endpoints, the next in reserve")
    chain_id: Annotated[int, Field(ge=1)] = Field(description="that every endpoint must have")
    contract: Address
    confirmations: Annotated[int, Field(ge=0, le=1000)] = 0


class WatchConfig(Table):
    """An onlooker's whole file."""

    scenario: str = Field(description="the scenario's file, in its area")
    area: Area
    plane: Annotated[int, Field(ge=1024, le=32767)] | None = Field(None, description="EPSG code of the area's metres")
    chain: ChainToWatch
    bus: BusAccess = BusAccess()
    members: dict[Address, MemberName] = Field({}, description="what members are called; others by their address")

    def resolved(self) -> ResolvedScenario:
        """The scenario in its area."""
        return resolve(load_scenario(self.scenario), self.area.grid())


def load_watch(path: Path) -> WatchConfig:
    """Read and check an onlooker's file; relative paths in it start from its folder.

    Raises:
        UsageError: naming the first key that does not fit.
    """
    config = read_table(path, WatchConfig)
    folder = path.resolve().parent
    return config.model_copy(update={"scenario": str(folder / config.scenario), "bus": config.bus.placed(folder)})


class Watch:
    """The fleet that a file names, as it flies.

    Args:
        say: is called with every line that a person should read.
    Raises:
        ScenarioError: of the scenario that the file names.
        ChainError: no endpoint answers, or chain or contract are not what the file says.
        BusError: the bus is not there.
    """

    def __init__(self, config: WatchConfig, say: Callable[[str], None]) -> None:
        scenario, grid = config.resolved(), config.area.grid()
        low, side = (grid.x0, grid.y0), grid.side
        box = (*low, low[0] + side * grid.columns, low[1] + side * grid.rows)
        streets = read_streets(Path(named), box, config.plane) if (named := scenario.map.streets) else []
        self._law, self._say = Law.of(scenario, grid), say
        self._header = header_of(scenario, grid, scenario.fleet.range, streets)
        access = config.chain
        self._chain = NodeChain(
            access.urls,
            Keyring.ephemeral(),
            chain_id=access.chain_id,
            confirmations=access.confirmations,
            patience=ANSWER,
        )
        self._client = IovClient.connect(self._chain, access.contract, access.chain_id)
        self.picture = Picture(self._law, scenario.coordination, config.members)
        contract = (access.contract, access.chain_id)
        uavs, vehicles = self.picture.uavs, self.picture.vehicles
        self.gate = BeaconGate(contract, uavs, vehicles, set(grid.ids), patience=self._law.patience)
        at = config.bus
        self._bus = Bus("onlooker", at.connect, at.listens(), weather=at.weather(), certificates=at.certificates())
        self._heard = [self._bus.subscribe(key(access.contract), WAITING) for key in (uav_key, vehicle_key)]
        now = time.monotonic()
        self._next_block, self._mined, self._answers = 0, now, True
        self._beacon, self._told = now, True
        self._aside = ThreadPoolExecutor(1, "chain")
        self._asked: Future[tuple[int, list[Event]]] | None = None

    def close(self) -> None:
        """Leave bus and chain."""
        self._bus.close()
        self._aside.shutdown(wait=False, cancel_futures=True)

    async def follow(self) -> Feed:
        """The header, and every step when it is known; goes on until it is cancelled."""
        with closing(self):
            yield self._header
            while True:
                for record in await asyncio.to_thread(self.look):
                    yield record

    def look(self) -> list[Record]:
        """What has become known in a moment: no record, one, or one for each of several steps."""
        arrivals = [one for heard, wait in zip(self._heard, (WAIT, 0.0), strict=True) for one in heard.take(wait)]
        parsed = [(sealed.beacon.time, one.content) for one in arrivals if (sealed := parse(one.content)) is not None]
        parsed.sort(key=lambda one: one[0])  # those of a step together, whichever way they came
        # The chain first: what it says was mined before the beacons that stand here were sent.
        self._read()
        records: list[Record] = []
        for stands, content in parsed:
            self._take(content, stands, records)
        now = time.monotonic()
        self.picture.judge(now - self._mined, now - self._beacon)
        if now - self._beacon > SETTLED and (not self._told or self.picture.news):
            records.append(self._record(ahead=self._told))
        return records

    def _take(self, content: bytes, stands: float, records: list[Record]) -> None:
        # Members' clocks, not this machine's: nobody is early but who is later than the run ends, nobody stale. What a
        # member's own time is worth `Picture` finds out of all of them; who joins late can ask for no more than that.
        on_time = stands <= self.picture.clock + self._law.patience
        beacon = self.gate.admit(content, min(stands, self.picture.end), remember=on_time)
        if beacon is None:
            return
        self._beacon = time.monotonic()
        self.picture.take(beacon, self._beacon)
        if self.picture.behind:
            if not self._told:
                records.append(self._record())
            self.picture.advance()
        self._told = False  # also where the step was told before all that belongs to it had come

    def _record(self, *, ahead: bool = False) -> Record:
        self._told = True
        return self.picture.record(ahead=ahead)

    def _read(self) -> None:
        """Hear the chain's events; one that does not answer is waited for aside, while the bus is heard."""
        if self._asked is None:
            self._asked = self._aside.submit(self._fetch)
        try:
            last, events = self._asked.result(ANSWER if self._answers else 0.0)
        except TimeoutError:
            self._away(f"no answer within {ANSWER:g} s")
            return
        except ChainError as error:
            self._asked = None
            self._away(str(error))
            return
        self._asked = None
        if not self._answers:
            self._answers = True
            self._say("the chain answers again")
        if last >= self._next_block:
            self._next_block, self._mined = last + 1, time.monotonic()
            self.picture.mined()
        for event in events:
            self.picture.hear(event)

    def _fetch(self) -> tuple[int, list[Event]]:
        """The newest block, and the events up to it that have not been heard."""
        last = self._chain.block_number
        return last, self._client.events(self._next_block, last) if last >= self._next_block else []

    def _away(self, reason: str) -> None:
        if self._answers:
            self._answers = False
            self._say(f"the chain does not answer: {reason}")
            self.picture.alert("no-quorum", "", f"the chain does not answer: {reason}")
