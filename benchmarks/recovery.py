"""How soon whoever is killed is at work again, in a run by the clock on the wall over four validators and a Kubo node.

    python benchmarks/recovery.py [--times 2] [--json]

Needs the node programs (`make nodes`). Each is killed (SIGKILL) while it has something to do, and `skyrelay up` starts
it again. Measured is the time from the kill to its first effective act, as an onlooker of bus and chain sees it: a
beacon that a new session of a UAV or a vehicle has signed, or a call of a vehicle's that is mined; a decision of the
coordinator's about proposals that wait for it; the policy from the store; a block that the validator has got since. A
UAV host also has to load its policy again: then its first UAV moves. One run; with `--times` each is killed so often.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.node.devnet import find_binary
from skyrelay.core.errors import SkyRelayError
from skyrelay.pilot.bus import Bus, uav_key, vehicle_key
from skyrelay.pilot.nodes import kubo_program
from skyrelay.protocol.beacon import parse
from skyrelay.protocol.messages import Beacon
from skyrelay.store.cid import Cid
from skyrelay.store.kubo import KuboStore

T = TypeVar("T")
PERIOD_STEPS, STEP, SLOT, ROUNDS, SPEED = 20, 2.0, 4.0, 1, 2.0
SETS = ["mobility.penetration=0.05", "fleet.uavs=12", f"selection.rounds={ROUNDS}", "energy.hover_per_minute=0.5"]
LIMIT = 300.0
"""What has not happened by then does not [s]."""


class Trial:
    """A run by processes, and what an onlooker sees of it.

    Args:
        folder: of the run.
        periods: that it has.
    """

    def __init__(self, folder: Path, periods: int) -> None:
        sets = [*SETS, f"coordination.period_steps={PERIOD_STEPS}", f"coordination.steps={PERIOD_STEPS * periods}"]
        command = ["up", "--out", str(folder), "--no-live", "--validators", "4", "--kubo"]
        command += ["--free-running", "--slot", str(SLOT), "--speed", str(SPEED)]
        command += [part for override in sets for part in ("--set", override)]
        launch = "from skyrelay.cli.main import main; main()"
        self.process = subprocess.Popen([sys.executable, "-c", launch, *command], stderr=subprocess.PIPE, text=True)
        self._said: list[tuple[float, str]] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.until(lambda: self.started("coordinator"))
        hosts = folder.with_name(f"{folder.name}-hosts")
        told = tomllib.loads((hosts / "live.toml").read_text("utf-8"))
        self.store = KuboStore(tomllib.loads((hosts / "uavs.toml").read_text("utf-8"))["store"]["url"])
        access = told["chain"]
        self.endpoints: list[str] = access["urls"]
        self._chain = NodeChain(self.endpoints, Keyring.ephemeral(), chain_id=access["chain_id"])
        self.client = IovClient.connect(self._chain, access["contract"], access["chain_id"])
        self._next_block, self._count = 0, Counter[str]()
        self._called = 0
        self._bus = Bus("meter", told["bus"]["connect"])
        keys = {"uavs": uav_key(access["contract"]), "vehicles": vehicle_key(access["contract"])}
        self._heard = {kind: self._bus.subscribe(key, 65_536) for kind, key in keys.items()}
        self._keys: dict[str, str] = {}
        self._places: dict[str, tuple[float, float] | None] = {}

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self._said.append((time.monotonic(), line.strip()))

    def until(self, happens: Callable[[], T]) -> T:
        """Wait for something true."""
        end = time.monotonic() + LIMIT
        while not (found := happens()):
            if time.monotonic() > end or self.process.poll() is not None:
                raise SystemExit("\n".join(line for _, line in self._said[-20:]))
            time.sleep(0.01)
        return found

    def started(self, name: str) -> list[tuple[float, int]]:
        """When a process was started, each time, and its id."""
        pattern = re.compile(rf"{name} +process (\d+)")
        return [(at, int(match[1])) for at, line in list(self._said) if (match := pattern.match(line))]

    def kill(self, name: str) -> float:
        """Kill it, and return when it has been started again; when it was killed."""
        times = self.started(name)
        gone = time.monotonic()
        os.kill(times[-1][1], signal.SIGKILL)
        self.until(lambda: len(self.started(name)) > len(times))
        return gone

    def hear(self, kind: str) -> tuple[list[Beacon], bool, bool]:
        """The beacons since this was last asked; whether a member has a new session; whether a UAV has moved."""
        beacons, again, moved = [], False, False
        for arrival in self._heard[kind].take(0.0):
            sealed = parse(arrival.content)
            if sealed is None or (kind == "uavs" and sealed.beacon.asks):
                continue  # a vehicle that nobody serves asks all UAVs of its zone
            beacon, sender = sealed.beacon, sealed.beacon.sender
            beacons.append(beacon)
            again |= self._keys.get(sender, sealed.certificate.key) != sealed.certificate.key
            moved |= self._places.get(sender, beacon.position) != beacon.position
            self._keys[sender], self._places[sender] = sealed.certificate.key, beacon.position
        return beacons, again, moved

    def early_in_a_period(self, kind: str) -> bool:
        """Whether beacons are heard, and the next selection is far."""
        steps = [round(beacon.time / STEP) % PERIOD_STEPS for beacon in self.hear(kind)[0]]
        return any(2 <= step <= PERIOD_STEPS // 4 for step in steps)

    def events(self, name: str) -> int:
        """How many of these the contract has."""
        last = self._chain.block_number
        if last >= self._next_block:
            self._count.update(event.name for event in self.client.events(self._next_block, last))
            self._next_block = last + 1
        return self._count[name]

    def vehicles_called(self) -> bool:
        """Whether vehicles have written to the contract since this was last asked; in flight they do not."""
        before, names = self._called, ("VehicleRegistered", "VehicleUpdated", "VehSelectionSubmitted")
        self._called = sum(map(self.events, names))
        return self._called > before

    def close(self) -> None:
        """End all of it."""
        self._bus.close()
        self.process.send_signal(signal.SIGINT)
        self.process.wait(60)
        self._reader.join()


def _heard_or_called(trial: Trial, kind: str) -> bool:
    """Whether a host's members have sent a beacon, or its vehicles called the contract."""
    return bool(trial.hear(kind)[1]) or (kind == "vehicles" and bool(trial.vehicles_called()))


def measure(trial: Trial) -> dict[str, float]:
    """Kill each once; seconds from there to its first act."""
    seconds: dict[str, float] = {}
    for kind in ("uavs", "vehicles"):
        trial.until(partial(trial.early_in_a_period, kind))
        trial.vehicles_called()
        begin = trial.kill(kind)
        trial.until(partial(_heard_or_called, trial, kind))
        seconds["uavs: a beacon" if kind == "uavs" else "vehicles: a beacon or a call"] = time.monotonic() - begin
        if kind == "uavs":
            trial.until(lambda: trial.hear("uavs")[2])
            seconds["uavs: a move"] = time.monotonic() - begin
    registered = next(event for event in trial.client.events() if event.name == "ModelRegistered")
    cid = Cid.from_bytes(bytes.fromhex(registered.args["cid"][2:]), "chain")
    begin = trial.kill("kubo")
    trial.until(lambda: _works(lambda: trial.store.get(cid)))
    seconds["kubo: the policy"] = time.monotonic() - begin
    begin = trial.kill("validator-3")
    heads = NodeChain(trial.endpoints[0], Keyring.ephemeral()).block_number
    last = trial.endpoints[3]
    trial.until(lambda: _works(lambda: NodeChain(last, Keyring.ephemeral()).block_number > heads))
    seconds["validator: a block"] = time.monotonic() - begin
    proposed, decided = trial.events("VehSelectionSubmitted"), trial.events("ZoneAllocated")
    trial.until(lambda: trial.events("VehSelectionSubmitted") > proposed)
    begin = trial.kill("coordinator")
    trial.until(lambda: trial.events("ZoneAllocated") > decided)
    seconds["coordinator: a decision"] = time.monotonic() - begin
    return seconds


def _works(ask: Callable[[], object]) -> bool:
    with suppress(SkyRelayError):
        return bool(ask())
    return False


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    try:
        find_binary("qbft")
        kubo_program()
    except SkyRelayError as error:
        print(f"left out: {error}")
        return
    period = (5 + 2 * ROUNDS) * SLOT + PERIOD_STEPS * STEP / SPEED
    with tempfile.TemporaryDirectory() as name:
        trial = Trial(Path(name) / "run", 3 * options.times + 1)
        try:
            rounds = [measure(trial) for _ in range(options.times)]
        finally:
            trial.close()
    worst = {what: max(times[what] for times in rounds) for what in rounds[0]}
    result = {
        "period_s": period,
        "load": round(os.getloadavg()[0], 1),
        "seconds": {what: [round(times[what], 2) for times in rounds] for what in worst},
        "worst_in_periods": {what: round(seconds / period, 3) for what, seconds in worst.items()},
    }
    if options.json:
        print(json.dumps(result, indent=2))
        return
    print(f"a period: {period:g} s; processes that wait for one of the cores: {result['load']}")
    for what, seconds in worst.items():
        print(f"{what:<28}{seconds:>8.2f} s{seconds / period:>8.3f} periods")


if __name__ == "__main__":
    main()
