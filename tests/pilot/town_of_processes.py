"""The small scenario that several tests play with processes, and what its agents decided."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import pyarrow.parquet as pq
import requests

SMALL = ["mobility.penetration=0.08", "fleet.uavs=18", "coordination.steps=24", "coordination.period_steps=8"]
WAIT = 240.0
PASSWORD = {"SKYRELAY_KEYSTORE_PASSWORD": "of this trial"}
LAUNCH = "from skyrelay.cli.main import main; main()"


def sets(*overrides):
    return [part for override in (*SMALL, *overrides) for part in ("--set", override)]


def skyrelay(*arguments, **options):
    return subprocess.Popen([sys.executable, "-c", LAUNCH, *map(str, arguments)], text=True, **options)


def _rows(folder, table, columns):
    return pq.read_table(folder / f"{table}.parquet", columns=columns).to_pylist()


def decided(folder):
    """Who proposed to whom, who serves whom, how everyone moved: all that agents decide."""
    names = {row["address"]: row["name"] for row in _rows(folder, "accounts", ["address", "name"])}
    proposals = ["period", "round", "zone", "vehicle", "uav", "qou", "qov", "score", "demand_kbps", "accepted", "order"]
    moves = ["step", "uav", "x", "y", "zone", "selected", "battery", "action"]
    events = _rows(folder, "events", ["name", "args"])
    allocated = [json.loads(row["args"]) for row in events if row["name"] == "UAVAllocated"]
    selections = [(names[args["uav"]], [names[vehicle] for vehicle in args["selected"]]) for args in allocated]
    return {
        "proposals": _rows(folder, "proposals", proposals),
        "candidates": _rows(folder, "candidates", ["period", "vehicle", "uav", "qou"]),
        "selections": selections,
        "moves": _rows(folder, "uavs", moves),
        "vehicles": _rows(folder, "vehicles", ["step", "vehicle", "uav", "covered"]),
    }


class Up:
    """A running `skyrelay up`, whose processes can be found and killed."""

    def __init__(self, folder, *overrides, options=()):
        self.folder, self.lines = folder, []
        self.hosts = folder.with_name(f"{folder.name}-hosts")
        self.elsewhere = {}  # the processes that are not its own children, by the host's name
        environment = os.environ | PASSWORD
        self.process = skyrelay(
            "up", "--out", folder, *options, *sets(*overrides), stderr=subprocess.PIPE, env=environment
        )
        self._reader = threading.Thread(target=lambda: self.lines.extend(self.process.stderr))
        self._reader.start()

    def start(self, name, change=lambda text: text):
        """Start a host that was left to be started elsewhere, once its file is there and changed."""
        told = self.wait_for(lambda: [line for line in list(self.lines) if re.match(rf"{name} +is waited for", line)])
        file = self.hosts / f"{name}.toml"
        if name not in self.elsewhere:
            file.write_text(change(file.read_text()))
        log = (self.hosts / f"{name}.log").open("a")
        kind = told[0].split("skyrelay agent ")[1].split()[0]
        environment = os.environ | PASSWORD
        self.elsewhere[name] = skyrelay("agent", kind, "--config", file, stdout=log, stderr=log, env=environment)

    def log(self, name):
        return (self.hosts / f"{name}.log").read_text()

    def pid(self, name):
        """Of the process that runs under a name now."""
        if name in self.elsewhere:
            return self.elsewhere[name].pid
        found = [match[1] for line in list(self.lines) if (match := re.match(rf"{name} +process (\d+)", line))]
        return int(found[-1]) if found else None

    def wait_for(self, happened):
        until = time.monotonic() + WAIT
        while not (found := happened()):
            assert time.monotonic() < until, self.lines
            assert self.process.poll() is None, self.lines
            time.sleep(0.02)
        return found

    def wait_for_block(self, number):
        file = self.hosts / "coordinator.toml"
        self.wait_for(lambda: self.pid("coordinator") and file.is_file())
        url = json.loads(re.search(r"urls = (\[[^\]]*\])", file.read_text())[1].replace(",\n", "\n"))[0]
        ask: Any = [{"jsonrpc": "2.0", "id": 1, "method": "eth_blockNumber", "params": []}]
        self.wait_for(lambda: int(requests.post(url, json=ask, timeout=5).json()[0]["result"], 16) >= number)

    def kill(self, name):
        os.kill(self.pid(name), signal.SIGKILL)

    def end(self):
        while (status := self.process.poll()) is None:
            for name, process in self.elsewhere.items():
                assert process.poll() != 2, self.log(name)  # it would be waited for in vain
            time.sleep(0.05)
        self._reader.join()
        self.stop()
        assert status == 0, self.lines

    def stop(self):
        """End what is left of it, whatever has become of the test."""
        for process in (self.process, *self.elsewhere.values()):
            process.terminate() if process is self.process else process.kill()
            process.wait(60)


def audited(folder):
    audit = skyrelay("audit", folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    told, _ = audit.communicate(timeout=120)
    assert audit.returncode == 0, told


def once(told):
    """Nothing is doubled, and what the contract says last of a period is what the record has."""
    asked = [(row["period"], row["round"], row["vehicle"]) for row in told["proposals"]]
    assert len(set(asked)) == len(asked)
    taken = [(row["period"], row["vehicle"]) for row in told["proposals"] if row["accepted"]]
    assert taken
    assert len(set(taken)) == len(taken)
