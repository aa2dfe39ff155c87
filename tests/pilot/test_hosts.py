"""Five hosts, each in a network namespace of its own, on one switch: what one machine's processes do, hosts do."""

import os
import re
import subprocess
import sys
import threading
import time

import pyarrow.parquet as pq
import pytest
from town_of_processes import LAUNCH, audited, decided, once, sets

pytestmark = pytest.mark.hosts

VARIABLES = {"SKYRELAY_KEYSTORE_PASSWORD": "of this trial", "SKYRELAY_PLAIN_HTTP": "10.77.0.1"}
WORLD = "10.77.0.1"
KINDS = {"vehicles": "vehicle", "uavs-1": "uav", "uavs-2": "uav", "coordinator": "coordinator"}
LONG = 240.0
METRICS = "127.0.0.1:9464"
HALVES = ["uavs-1", "uavs-2"]


def ip(*words):
    subprocess.run(["ip", *map(str, words)], check=True)


class Network:
    """Namespaces by name, each with one link to the switch."""

    def __init__(self, names):
        self.prefix = f"sky{os.getpid()}"
        self.names = ["world", *names]
        self.processes = []

    def build(self):
        ip("netns", "add", self.inside("switch"))
        ip("-n", self.inside("switch"), "link", "add", "name", "bridge0", "type", "bridge")
        ip("-n", self.inside("switch"), "link", "set", "bridge0", "up")
        for number, name in enumerate(self.names, 1):
            ip("netns", "add", self.inside(name))
            ip(
                *("-n", self.inside(name), "link", "add", "name", "eth", "type", "veth"),
                *("peer", "name", f"p{number}", "netns", self.inside("switch")),
            )
            ip("-n", self.inside("switch"), "link", "set", f"p{number}", "master", "bridge0", "up")
            ip("-n", self.inside(name), "address", "add", f"10.77.0.{number}/24", "dev", "eth")
            for link in ("lo", "eth"):
                ip("-n", self.inside(name), "link", "set", link, "up")

    def inside(self, name):
        return f"{self.prefix}{name}"

    def skyrelay(self, name, *arguments, **options):
        command = ["ip", "netns", "exec", self.inside(name), sys.executable, "-c", LAUNCH, *map(str, arguments)]
        process = subprocess.Popen(command, text=True, env=os.environ | VARIABLES, **options)
        self.processes.append(process)
        return process

    def plug(self, name, state):
        """``down`` cuts a host off, ``up`` brings it back."""
        ip("-n", self.inside("switch"), "link", "set", f"p{self.names.index(name) + 1}", state)

    def part(self, names, isolated):
        """``on`` cuts these hosts off from each other, though not from the rest; ``off`` heals it."""
        for name in names:
            port = f"p{self.names.index(name) + 1}"
            ip("-n", self.inside("switch"), "link", "set", port, "type", "bridge_slave", "isolated", isolated)

    def peers(self, name):
        """To how many others a host is linked on the bus, by its metrics; None before it answers."""
        read = f"import urllib.request; print(urllib.request.urlopen('http://{METRICS}/metrics').read().decode())"
        command = ["ip", "netns", "exec", self.inside(name), sys.executable, "-c", read]
        told = subprocess.run(command, capture_output=True, text=True, check=False).stdout
        found = re.search(r"^skyrelay_peers\S* (\d+)", told, re.MULTILINE)
        return int(found[1]) if found else None

    def remove(self):
        for process in self.processes:
            process.kill()
            process.wait()
        for name in [*self.names, "switch"]:
            subprocess.run(["ip", "netns", "del", self.inside(name)], check=False, stderr=subprocess.DEVNULL)


@pytest.fixture
def network():
    network = Network(KINDS)
    try:
        network.build()
        yield network
    finally:
        network.remove()


class Trial:
    """The world on one host, and each kind of agent on another."""

    def __init__(self, network, folder, *options):
        self.network, self.lines = network, []
        self.world = network.skyrelay(
            *("world", "up", "--out", folder, "--address", WORLD, "--uav-hosts", 2, *sets(), *options),
            *(part for kind in ("vehicle", "uav", "coordinator") for part in ("--elsewhere", kind)),
            stderr=subprocess.PIPE,
        )
        self._reader = threading.Thread(target=lambda: self.lines.extend(self.world.stderr))
        self._reader.start()
        self.hosts = folder.with_name(f"{folder.name}-hosts")
        for name, kind in KINDS.items():
            self.wait_for(f"{name} * is waited for")
            command = ("agent", kind, "--config", self.hosts / f"{name}.toml", "--metrics", METRICS)
            network.skyrelay(name, *command, stderr=subprocess.DEVNULL)

    def wait_for(self, words):
        first, _, last = words.partition("*")
        self.wait_until(lambda: any(first.strip() in line and last.strip() in line for line in list(self.lines)))

    def wait_until(self, happens):
        until = time.monotonic() + LONG
        while not happens():
            assert time.monotonic() < until, self.lines
            assert self.world.poll() is None, self.lines
            time.sleep(0.02)

    def end(self):
        status = self.world.wait(LONG)
        self._reader.join()
        assert status == 0, self.lines


def test_five_hosts_decide_what_one_process_decides(run_folder, network, tmp_path):
    Trial(network, tmp_path / "up").end()
    one, many = decided(run_folder), decided(tmp_path / "up")
    for table in one:
        assert many[table] == one[table], table


def test_what_is_cut_in_two_or_off_flies_on_and_comes_together_again(network, tmp_path):
    """First the two UAV hosts do not reach each other, of which one zone has a UAV on each; then nobody reaches one."""
    folder = tmp_path / "up"
    trial = Trial(network, folder, "--no-live", "--wait", 2, "--set", "coordination.steps=240")
    trial.wait_for("Chain and keys * s")
    others = len(KINDS)  # the world, and the hosts but for itself
    trial.wait_until(lambda: [network.peers(name) for name in HALVES] == [others, others])
    network.part(HALVES, "on")
    trial.wait_until(lambda: [network.peers(name) for name in HALVES] == [others - 1, others - 1])
    network.part(HALVES, "off")
    trial.wait_until(lambda: [network.peers(name) for name in HALVES] == [others, others])
    network.plug("uavs-2", "down")
    trial.wait_for("uavs-2 is gone; the others go on *")
    network.plug("uavs-2", "up")
    trial.wait_for("uavs-2 is back at step *")
    trial.end()
    told = decided(folder)
    once(told)
    assert {row["period"] for row in told["proposals"] if row["accepted"]} == set(range(30))
    uavs = pq.read_table(folder / "uavs.parquet").to_pandas()
    fleet = uavs[(uavs.step == 0)]
    assert set(fleet.zone[fleet.uav.isin(["u09", "u10"])]) == {5}  # the last of one host and the first of the other
    audited(folder)
