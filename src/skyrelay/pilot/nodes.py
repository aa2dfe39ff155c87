"""Real node programs beside the agents: a consortium's validators and a Kubo node, started again when they die."""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from skyrelay.chain.node.devnet import Devnet
from skyrelay.core.errors import ChainError, SkyRelayError, StoreError, UsageError

START = 60.0
"""A Kubo node that is not ready after so long does not start [s]."""
LOOK = 0.2
"""Between two looks at whether they run [s]."""
STOP = 20.0
"""A Kubo node that has not ended so long after SIGTERM is killed [s]."""
ALONE = {
    "Addresses.Gateway": [],
    "AutoConf.Enabled": False,
    "AutoTLS.Enabled": False,
    "Bootstrap": [],
    "DNS.Resolvers": {},
    "Ipns.DelegatedPublishers": [],
    "Routing.DelegatedRouters": [],
    "Routing.Type": "none",
    "Addresses.Swarm": ["/ip4/127.0.0.1/tcp/0"],
}
"""A node that talks to nobody; docs/how-to/ipfs.md says what each is for."""


@contextmanager
def validators(folder: Path, count: int, say: Callable[[str], None], *, replace: bool = False) -> Iterator[list[str]]:
    """A QBFT network of so many GoQuorum validators; gives their endpoints. Its folder stays, for who audits the chain.

    Args:
        say: is called with every line about a process.
        replace: the network that is in the folder already.
    Raises:
        UsageError: there is one already.
        ChainError: no node program is found, or a validator does not run.
    """
    if (folder / "devnet.json").is_file():
        if not replace:
            raise UsageError(folder, "the chain of an earlier run", "another --out, or --force to replace it")
        shutil.rmtree(folder)
    network = Devnet.create(folder, validators=count)
    dead: list[int] = []
    with network, _watched(lambda: _revive(network, dead, say)):
        for node in network.validators:
            _say_process(say, f"validator-{node.index}", network.pid(node.index), network.log(node.index))
        yield network.endpoints


def _revive(network: Devnet, dead: list[int], say: Callable[[str], None]) -> None:
    """Start the validators that have ended again.

    Args:
        dead: those that have not been started again; one that does not start now, as its port is still taken, is tried
            again after the others.
    """
    for index in network.ended():
        if index not in dead:
            say(f"{f'validator-{index}':<12} ended; started again")
            dead.append(index)
    while dead:
        index = dead.pop(0)
        try:
            network.restart(index)
        except ChainError:
            if network.runs(index):  # and sees no new block yet: there may be no quorum
                _say_process(say, f"validator-{index}", network.pid(index), network.log(index))
            else:
                dead.append(index)
            raise
        _say_process(say, f"validator-{index}", network.pid(index), network.log(index))


@contextmanager
def kubo(folder: Path, say: Callable[[str], None]) -> Iterator[str]:
    """A Kubo node on loopback that talks to no other; gives where its RPC is reached.

    Args:
        folder: of its repository, which must not be there yet.
        say: is called with every line about a process.
    Raises:
        StoreError: no node program is found, or it does not run.
    """
    node = _Kubo(folder, kubo_program())
    url = node.start()
    try:
        _say_process(say, "kubo", node.pid, node.log)

        def revive() -> None:
            if node.ended():
                node.start()
                say(f"{'kubo':<12} ended; started again")
                _say_process(say, "kubo", node.pid, node.log)

        with _watched(revive):
            yield url
    finally:
        node.stop()


def kubo_program() -> str:
    """What `make nodes` built, else what is on PATH.

    Raises:
        StoreError: there is none.
    """
    tools = [str(root / ".tools" / "bin") for root in (Path.cwd(), Path(__file__).resolve().parents[3])]
    found = shutil.which("ipfs", path=os.pathsep.join([*tools, os.environ.get("PATH", os.defpath)]))
    if found is None:
        raise StoreError("node program for IPFS", None, "Kubo's ipfs on PATH or in .tools/bin (`make nodes` builds it)")
    return found


class _Kubo:
    """A Kubo node's repository and process."""

    def __init__(self, home: Path, program: str) -> None:
        self._home, self._program = home, program
        # Not the passwords that may be in our environment.
        self._environment = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ} | {
            "IPFS_PATH": str(home),
            "IPFS_TELEMETRY": "off",
            "LIBP2P_FORCE_PNET": "1",
        }
        self._process: subprocess.Popen[bytes] | None = None
        self._port = "0"
        home.mkdir(mode=0o700)
        self._run("init", "--empty-repo", "--profile=test")
        for key, value in ALONE.items():
            self._run("config", "--json", key, json.dumps(value))
        (home / "swarm.key").write_text(f"/key/swarm/psk/1.0.0/\n/base16/\n{secrets.token_hex(32)}\n", "ascii")

    @property
    def log(self) -> Path:
        """What it says."""
        return self._home / "daemon.log"

    @property
    def pid(self) -> int:
        """Of the process that runs now."""
        return self._process.pid if self._process is not None else 0

    def ended(self) -> bool:
        """Whether it does not run: it has died by itself, or did not start again."""
        return self._process is None or self._process.poll() is not None

    def start(self) -> str:
        """Start it, at the port that it had before; return when it is ready, with its address."""
        self._run("config", "--json", "Addresses.API", json.dumps(f"/ip4/127.0.0.1/tcp/{self._port}"))
        for left in ("api", "repo.lock"):
            (self._home / left).unlink(missing_ok=True)  # of one that was killed
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(  # noqa: S603
                [self._program, "daemon"],
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,  # a Ctrl-C is ours to hand on
            )
        until = time.monotonic() + START
        while "Daemon is ready" not in (told := self.log.read_text("utf-8", "replace")):
            if self.ended() or time.monotonic() > until:
                self.stop()
                last = (told.strip().splitlines() or ["it said nothing"])[-1]
                raise StoreError("kubo", last, "a node that is ready")
            time.sleep(0.05)
        port = re.search(r"/tcp/(\d+)", (self._home / "api").read_text("ascii"))
        if port is None:
            raise StoreError("kubo", None, "a node that says where it answers")
        self._port = port[1]
        return f"http://127.0.0.1:{self._port}"

    def stop(self) -> None:
        """Let it finish; one that does not is killed."""
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        try:
            process.wait(STOP)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _run(self, *arguments: str) -> None:
        command = [self._program, *arguments]
        done = subprocess.run(command, env=self._environment, capture_output=True, text=True, timeout=60, check=False)  # noqa: S603
        if done.returncode:
            raise StoreError("kubo", done.stderr.strip().splitlines()[-1:], f"ipfs {arguments[0]} to work")


@contextmanager
def _watched(look: Callable[[], None]) -> Iterator[None]:
    """Have a thread look again and again, until this is left."""
    over = threading.Event()

    def watch() -> None:
        while not over.wait(LOOK):
            with suppress(SkyRelayError):  # what does not start now is tried again
                look()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _say_process(say: Callable[[str], None], name: str, pid: int, log: Path) -> None:
    say(f"{name:<12} process {pid}, log {log}")
