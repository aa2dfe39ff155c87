"""Five hosts, each in a network namespace of its own, on one switch: what one machine's processes do, hosts do."""

import os
import subprocess
import sys
import threading
import time

import pytest
from town_of_processes import LAUNCH, decided, sets

pytestmark = pytest.mark.hosts

VARIABLES = {"SKYRELAY_KEYSTORE_PASSWORD": "of this trial", "SKYRELAY_PLAIN_HTTP": "10.77.0.1"}
WORLD = "10.77.0.1"
KINDS = {"vehicles": "vehicle", "uavs-1": "uav", "uavs-2": "uav", "coordinator": "coordinator"}
LONG = 240.0


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
            network.skyrelay(name, "agent", kind, "--config", self.hosts / f"{name}.toml", stderr=subprocess.DEVNULL)

    def wait_for(self, words):
        first, _, last = words.partition("*")
        until = time.monotonic() + LONG
        while not any(first.strip() in line and last.strip() in line for line in list(self.lines)):
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


def test_a_host_that_is_cut_off_is_left_behind_and_comes_back(network, tmp_path):
    trial = Trial(network, tmp_path / "up", "--wait", 2, "--set", "coordination.steps=240")
    trial.wait_for("Chain and keys * s")
    network.plug("uavs-2", "down")
    trial.wait_for("uavs-2 is gone; the others go on *")
    network.plug("uavs-2", "up")
    trial.wait_for("uavs-2 is back at step *")
    trial.end()
