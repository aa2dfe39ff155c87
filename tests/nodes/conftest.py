"""Real node programs: what `make test-nodes` builds into .tools/bin, or what is on PATH."""

import json
import os
import re
import secrets
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from skyrelay.pilot.nodes import ALONE

ROOT = Path(__file__).resolve().parents[2]
START_SECONDS = 60


@dataclass
class KuboNode:
    """A Kubo daemon on loopback, in a swarm that only holders of its key can join."""

    home: Path
    binary: str
    process: subprocess.Popen[bytes] | None = None
    url: str = ""

    def run(self, *arguments: str) -> str:
        environment = {**os.environ, "IPFS_PATH": str(self.home), "IPFS_TELEMETRY": "off", "LIBP2P_FORCE_PNET": "1"}
        done = subprocess.run([self.binary, *arguments], env=environment, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def start(self) -> None:
        (self.home / "api").unlink(missing_ok=True)
        environment = {**os.environ, "IPFS_PATH": str(self.home), "IPFS_TELEMETRY": "off", "LIBP2P_FORCE_PNET": "1"}
        with (self.home / "daemon.log").open("wb") as log:
            self.process = subprocess.Popen(
                [self.binary, "daemon"], env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        end = time.monotonic() + START_SECONDS
        while "Daemon is ready" not in (told := (self.home / "daemon.log").read_text()):
            assert self.process.poll() is None, told
            assert time.monotonic() < end, told
            time.sleep(0.1)
        port = re.search(r"/tcp/(\d+)", (self.home / "api").read_text())
        assert port
        self.url = f"http://127.0.0.1:{port[1]}"

    def connect(self, other: "KuboNode") -> None:
        addresses = [a for a in json.loads(other.run("id"))["Addresses"] if a.startswith("/ip4/127.0.0.1/")]
        self.run("swarm", "connect", addresses[0])

    def stop(self, how: signal.Signals = signal.SIGTERM) -> None:
        if self.process is not None:
            self.process.send_signal(how)
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
            self.process = None


def private_node(home: Path, swarm_key: str) -> KuboNode:
    """A node that talks to nobody but the nodes that it is told to: as docs/how-to/ipfs.md sets it up."""
    binary = shutil.which("ipfs", path=os.pathsep.join([str(ROOT / ".tools" / "bin"), os.environ["PATH"]]))
    assert binary, "no ipfs on PATH or in .tools/bin: `make nodes` builds it"
    node = KuboNode(home, binary)
    node.run("init", "--empty-repo", "--profile=test")
    for key, value in ({"Addresses.API": "/ip4/127.0.0.1/tcp/0"} | ALONE).items():
        node.run("config", "--json", key, json.dumps(value))
    (home / "swarm.key").write_text(f"/key/swarm/psk/1.0.0/\n/base16/\n{swarm_key}\n")
    return node


@pytest.fixture
def idle_node(tmp_path: Path) -> KuboNode:
    """A Kubo node's repository, without a daemon."""
    return private_node(tmp_path / "idle", secrets.token_hex(32))


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[KuboNode, KuboNode]]:
    """Two connected Kubo nodes."""
    key = secrets.token_hex(32)
    homes = tmp_path_factory.mktemp("kubo")
    nodes = private_node(homes / "a", key), private_node(homes / "b", key)
    try:
        for node in nodes:
            node.start()
        nodes[1].connect(nodes[0])
        yield nodes
    finally:
        for node in nodes:
            node.stop()
