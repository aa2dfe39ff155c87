"""The world as a process: who is where, what receivers say, the clock that hosts follow, and the run's record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient
from skyrelay.chain.node.chain import NodeChain
from skyrelay.core.progress import Progress
from skyrelay.core.resolved import ResolvedScenario
from skyrelay.core.scenario import load_scenario
from skyrelay.pilot.bus import Bus
from skyrelay.pilot.config import WorldConfig
from skyrelay.pilot.free import FreeHosts
from skyrelay.pilot.lockstep import RemoteHosts
from skyrelay.pilot.timetable import Timetable
from skyrelay.simulation.consortium import chain_facts
from skyrelay.simulation.run import Run, without_credentials
from skyrelay.simulation.world import World

NAME = "world"


def run_world(config: WorldConfig, say: Callable[[str], None], progress: Progress) -> None:
    """Be the world of a run to its end, and write the run's tables and summary.

    It owns no key: what it knows of its members beyond where they are, it reads on the chain, as anybody can.

    Args:
        say: is called with a line when a host goes or comes.
    Raises:
        TraceError, ChainError, BusError: naming what was wrong with what; a host that does not come is such.
    """
    access = config.chain
    at = config.bus
    with Bus(NAME, at.connect, at.listens(), certificates=at.certificates()) as bus:
        progress.advance(0)  # the bus is there
        world = World.of(load_scenario(config.scenario))
        world = replace(world, scenario=without_credentials(on_chain(world.scenario, ",".join(access.urls))))
        nobody = Keyring.ephemeral()
        chain = NodeChain(access.urls, nobody, chain_id=access.chain_id, confirmations=access.confirmations)
        client = IovClient.connect(chain, access.contract, access.chain_id)
        run = Run(world, config.accounts.__getitem__)
        common = (bus, access.contract, config.hosts, client, chain, run.hear, say)
        clock = config.clock
        if clock is None:
            asked = RemoteHosts(*common, config.wait, config.speed)
            asked.gather(config.gather)
            run.hosts = asked
        else:
            free = FreeHosts(*common)
            free.begin(lambda begin: Timetable.of(world.scenario, begin, clock.slot, clock.step), config.gather)
            run.hosts = free
        run.play(progress)
        progress.stage("Record", 1)
        facts = chain_facts(chain, access.contract)
        run.write(Path(config.folder), config.parties, config.deciders, facts, config.begun)


def on_chain(scenario: ResolvedScenario, url: str) -> ResolvedScenario:
    """The scenario on a chain at ``url``, with keys of this run only."""
    return scenario.model_copy(update={"chain": scenario.chain.model_copy(update={"url": url, "keystore": None})})
