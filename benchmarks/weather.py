"""What lost and late beacons cost: coverage and connectivity of the default run, against perfect beacons.

    python benchmarks/weather.py [--seeds 1 2 3] [--json]

Every beacon is lost to every hearer by itself, by chance; what is not lost is late by the delay: at the moment of its
decision a UAV hears where a member was so long ago (between two steps members move evenly). What it does about age is
docs/reference/agents.md. Selection is by the chain, which no beacon enters.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import Beacon
from skyrelay.simulation.consortium import Consortium
from skyrelay.simulation.run import Run, world_agents
from skyrelay.simulation.world import World

WEATHERS = [(0.0, 0.0), (0.1, 0.0), (0.3, 0.0), (0.0, 0.2), (0.0, 1.0), (0.1, 0.2), (0.3, 1.0)]
FIGURES = ("coverage", "connectivity", "connectivity_neighbor", "in_range")


class Weathered(Host):
    """A host whose agents hear each other through weather."""

    loss, delay, seconds = 0.0, 0.0, 1.0
    random = np.random.default_rng(0)

    def spread(self) -> None:
        """As `Host.spread`, with what the weather leaves."""
        before: Mapping[str, Beacon] = getattr(self, "_before", {})
        now = self.take_beacons()
        self._before = {beacon.sender: beacon for beacon in now}
        self.hear([self._late(beacon, before.get(beacon.sender)) for beacon in now], self._arrives)

    def _late(self, beacon: Beacon, before: Beacon | None) -> Beacon:
        """Where the sender was when it sent what is heard now."""
        if not self.delay or before is None or before.position is None or beacon.position is None:
            return replace(beacon, time=beacon.time - self.delay)
        share = self.delay / self.seconds
        (x, y), (old_x, old_y) = beacon.position, before.position
        place = (x + share * (old_x - x), y + share * (old_y - y))
        return replace(beacon, position=place, time=beacon.time - self.delay)

    def _arrives(self, beacon: Beacon, agent: Agent) -> bool:
        del beacon, agent
        return bool(self.random.random() >= self.loss)


def play(seed: int, loss: float, delay: float) -> dict[str, float]:
    """A run's figures."""
    world = World.of(load_scenario(seed=seed))
    with tempfile.TemporaryDirectory() as folder, Consortium(world.scenario, Path(folder)) as consortium:
        run = Run(world, consortium.account)
        agents = world_agents(world, consortium.account, consortium.hangar.load)
        host = Weathered(agents, consortium.client, consortium.store, run.hear)
        host.loss, host.delay, host.seconds = loss, delay, world.law.seconds
        host.random = np.random.default_rng(seed)
        run.hosts = host
        consortium.found()
        run.play(Silent())
        summary = run.summary()
        return {name: float(summary[name]) for name in FIGURES}


def main() -> None:
    """Every weather, over the seeds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows = []
    for loss, delay in WEATHERS:
        runs = [play(seed, loss, delay) for seed in arguments.seeds]
        rows.append(
            {"loss": loss, "delay": delay} | {name: float(np.mean([run[name] for run in runs])) for name in FIGURES}
        )
    if arguments.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'lost':>6}{'late':>8}" + "".join(f"{name:>24}" for name in FIGURES))
    for row in rows:
        print(f"{row['loss']:>6.0%}{row['delay']:>6.1f} s" + "".join(f"{row[name]:>24.4f}" for name in FIGURES))


if __name__ == "__main__":
    main()
