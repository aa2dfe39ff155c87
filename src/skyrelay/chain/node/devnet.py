"""A consortium network on this machine: keys, genesis, configuration and the validators' processes.

QBFT runs on GoQuorum (the paper's chain; final after one block), Clique on go-ethereum 1.13 (the last that has it).
Gas is free, blocks are as long as two cores execute in a period, extra data carries the validators, and everything
listens on loopback alone. Nodes keep every state on disk (archive): a validator that is killed flushes nothing, and a
pruning one would come back without its last blocks.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import rlp
import tomli_w
from eth_keys.datatypes import PrivateKey

from skyrelay.core.errors import ChainError, UsageError
from skyrelay.core.files import write_text
from skyrelay.core.folders import new_folder
from skyrelay.core.recursion import recursion_limit_kept
from skyrelay.core.untrusted import parse_json, read_json
from skyrelay.net.http import Http, HttpError

with recursion_limit_kept():  # as in `skyrelay.chain.accounts`
    from eth_account import Account

Consensus = Literal["qbft", "clique"]

GAS_PER_SECOND = 150_000_000
"""Gas of a block for each second of its period. Proposer and validators execute a block one after the other within the
period; one that two cores cannot execute in it is thrown away and begun anew, for ever while the pool is full."""

_LOOPBACK = "127.0.0.1"
_QBFT_MIX_HASH = "0x63746963616c2062797a616e74696e65206661756c7420746f6c6572616e6365"
_LIGHT_KDF = 4096  # rounds of scrypt: the passwords are 256 random bits, which stretching cannot help
_STATE = "devnet.json"
_START_SECONDS = 60.0


@dataclass(frozen=True, slots=True)
class Validator:
    """One validator.

    Attributes:
        index: 0, 1, ...
        address: of its consensus key, 0x and 40 digits.
        public_key: of its peer-to-peer identity, 128 digits.
        rpc_port: where it answers JSON-RPC on loopback.
        p2p_port: where its peers reach it on loopback.
        auth_port: of the port that go-ethereum opens for a beacon client, which none uses here.
        host: the address at which peers reach it; JSON-RPC stays on loopback.
    """

    index: int
    address: str
    public_key: str
    rpc_port: int
    p2p_port: int
    auth_port: int
    host: str = _LOOPBACK

    @property
    def url(self) -> str:
        """The JSON-RPC endpoint."""
        return f"http://{_LOOPBACK}:{self.rpc_port}"

    @property
    def enode(self) -> str:
        """The address that peers dial."""
        return f"enode://{self.public_key}@{_bracketed(self.host)}:{self.p2p_port}?discport=0"


@dataclass(frozen=True, slots=True)
class Key:
    """A key: its address with capitals as checksum, 32 secret bytes, 128 digits of the public key."""

    address: str
    secret: bytes
    public_key: str


def fresh_key() -> Key:
    """A key that nobody has had."""
    secret = secrets.token_bytes(32)
    public = PrivateKey(secret).public_key
    return Key(public.to_checksum_address(), secret, public.to_hex()[2:])


class Devnet:
    """A network of validators whose folder outlives it: stop it, open it again, and it goes on from its last block.

    Use as a context manager: entering starts every validator and waits for blocks, leaving stops them.
    """

    def __init__(
        self, directory: Path, consensus: Consensus, chain_id: int, period: int, validators: Sequence[Validator]
    ) -> None:
        self.directory = directory
        self.consensus = consensus
        self.chain_id = chain_id
        self.period = period
        self.validators = tuple(validators)
        self._binary = find_binary(consensus)
        self._processes: dict[int, subprocess.Popen[bytes]] = {}

    @classmethod
    def create(
        cls,
        directory: Path,
        *,
        validators: int = 4,
        consensus: Consensus = "qbft",
        chain_id: int = 1337,
        period: int = 1,
        rpc_port: int | None = None,
    ) -> Devnet:
        """Write keys, genesis and configuration of a new network; nothing runs yet.

        Args:
            directory: where it goes; absent or empty.
            validators: how many, 1-32; QBFT goes on without f of them where validators >= 3 f + 1.
            consensus: ``"qbft"`` or ``"clique"``.
            chain_id: that transactions are signed for.
            period: time between blocks [s].
            rpc_port: of the first validator, the others' follow; left out: free ports are chosen.
        Raises:
            UsageError: an argument does not fit.
            ChainError: the folder is not empty, or no node program is found.
            RunFolderError: another process is making a network there.
        """
        if not 1 <= validators <= 32:
            raise UsageError("validators", validators, "1 to 32")
        if not 1 <= period <= 60:
            raise UsageError("period", period, "1 to 60 s between blocks")
        if not 1 <= chain_id < 2**32:
            raise UsageError("chain id", chain_id, "1 to 2^32 - 1")
        if rpc_port is not None and not 1024 <= rpc_port <= 65_535 - 3 * validators:
            raise UsageError("RPC port", rpc_port, f"1024 to {65_535 - 3 * validators}")
        if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
            raise ChainError(directory, "not empty", "a folder that is absent or empty, or one that holds a devnet")
        binary = find_binary(consensus)
        keys = sorted((fresh_key() for _ in range(validators)), key=lambda key: key.address.lower())
        ports = _free_ports(3 * validators) if rpc_port is None else list(range(rpc_port, rpc_port + 3 * validators))
        nodes = []
        for i, key in enumerate(keys):
            rpc, p2p, auth = ports[i::validators]
            nodes.append(Validator(i, key.address, key.public_key, rpc, p2p, auth))
        try:
            with new_folder(directory) as root:
                genesis = genesis_of(consensus, [key.address for key in keys], chain_id, period)
                write_text(root / "genesis.json", json.dumps(genesis, indent=2) + "\n")
                write_keystore(root / "accounts", "operator", fresh_key())
                for node, key in zip(nodes, keys, strict=True):
                    home = root / "validators" / str(node.index)
                    (home / "geth").mkdir(parents=True)
                    home.chmod(0o700)
                    write_secret(home / "geth" / "nodekey", key.secret.hex())
                    if consensus == "clique":  # it seals with an account, not with the node's key
                        write_keystore(home / "keystore", "validator", key)
                    write_text(
                        home / "config.toml", tomli_w.dumps(node_config(consensus, node, nodes, chain_id, period))
                    )
                    _initialise(binary, home, root / "genesis.json")
                state: dict[str, Any] = {"consensus": consensus, "chain_id": chain_id, "period": period}
                state["validators"] = [asdict(node) for node in nodes]
                write_text(root / _STATE, json.dumps(state, indent=2) + "\n")
        except OSError as error:
            raise ChainError(directory, error.strerror, "a folder that can be written") from None
        return cls(directory, consensus, chain_id, period, nodes)

    @classmethod
    def open(cls, directory: Path) -> Devnet:
        """A network that `create` wrote, with whatever blocks it made since.

        Raises: ChainError: the folder holds none.
        """
        path = directory / _STATE
        try:
            state = read_json(path)
            if state["consensus"] not in ("qbft", "clique"):
                raise ValueError  # noqa: TRY301
            nodes = [Validator(**node) for node in state["validators"]]
            return cls(directory, state["consensus"], int(state["chain_id"]), int(state["period"]), nodes)
        except OSError as error:
            raise ChainError(path, error.strerror, "the folder of a devnet") from None
        except (ValueError, KeyError, TypeError):
            raise ChainError(path, None, "what `skyrelay chain devnet` wrote") from None

    def __enter__(self) -> Devnet:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def endpoints(self) -> list[str]:
        """The validators' JSON-RPC endpoints."""
        return [node.url for node in self.validators]

    @property
    def operator(self) -> tuple[Path, Path]:
        """The encrypted keystore of the account that deploys and administers, and the file with its password."""
        return self.directory / "accounts" / "operator.json", self.directory / "accounts" / "operator.password"

    def start(self) -> None:
        """Start every validator that does not run, and return when all of them see new blocks.

        Raises: ChainError: a validator ends or none makes blocks; all are stopped again.
        """
        try:
            idle = [node for node in self.validators if node.index not in self._processes]
            if self.consensus == "clique" and len(idle) == len(self.validators):
                # Any signer may seal the first two blocks. Where several do before they hear of each other, their forks
                # can come to weigh the same, and all wait for a block of another's for ever. So the one whose turn the
                # first block is seals it alone, and the others begin from there.
                first = idle.pop(1 % len(idle))
                self._join([first])
                self._wait(lambda: (_number(first.url, "eth_blockNumber") or 0) > 0, first, "a first block")
            self._join(idle)
            self.wait_for_blocks()
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """Let every validator finish; one that does not within 15 s is killed."""
        for process in self._processes.values():
            process.send_signal(signal.SIGINT)
        for process in self._processes.values():
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._processes.clear()

    def kill(self, index: int) -> None:
        """End validator ``index`` at once, as a power cut would."""
        process = self._processes.pop(index)
        process.kill()
        process.wait()

    def pid(self, index: int) -> int:
        """Of the process of validator ``index``, which runs."""
        return self._processes[index].pid

    def runs(self, index: int) -> bool:
        """Whether validator ``index`` has been started and has not died since."""
        return index in self._processes and self._processes[index].poll() is None

    def ended(self) -> list[int]:
        """The validators that have died by themselves since this was last called; `restart` starts them again."""
        dead = [index for index, process in self._processes.items() if process.poll() is not None]
        for index in dead:
            del self._processes[index]
        return dead

    def restart(self, index: int) -> None:
        """Start validator ``index`` again, and return when it has caught up with the network and sees new blocks.

        Raises: ChainError: it ends, or sees no new block.
        """
        self._join([self.validators[index]])
        self.wait_for_blocks()

    def wait_for_blocks(self, more: int = 1) -> int:
        """Wait until every running validator is ``more`` blocks beyond the highest of now; return the lowest height.

        Raises: ChainError: a validator ends, or blocks take a minute longer than twice their period.
        """
        timeout = _START_SECONDS + 2 * more * self.period
        end = time.monotonic() + timeout
        running = [self.validators[index] for index in sorted(self._processes)]
        goal: int | None = None
        while time.monotonic() < end:
            self._check_alive()
            heights = [_number(node.url, "eth_blockNumber") for node in running]
            known = [height for height in heights if height is not None]
            if len(known) == len(running):
                goal = max(known) + more if goal is None else goal
                if min(known) >= goal:
                    return min(known)
            time.sleep(0.1)
        raise ChainError(
            f"devnet {self.directory}",
            f"not at block {goal} on every validator after {timeout:g} s" if goal is not None else "without an answer",
            "validators that agree",
        )

    def supervise(self) -> None:
        """Watch for a second.

        Raises: ChainError: a validator has ended.
        """
        time.sleep(1)
        self._check_alive()

    def log(self, index: int) -> Path:
        """Where validator ``index`` writes its log."""
        return self._home(self.validators[index]) / "node.log"

    def _home(self, node: Validator) -> Path:
        return self.directory / "validators" / str(node.index)

    def _join(self, nodes: Sequence[Validator]) -> None:
        """Start these validators beside those that run; on Clique they seal once they are linked and caught up."""
        for node in nodes:
            self._launch(node)
        if self.consensus == "qbft" or not nodes:
            return
        others = len(self._processes) - 1
        for node in nodes:
            self._wait(partial(_linked, node.url, others), node, f"links to {others} others")
        self.wait_for_blocks(0)
        with ThreadPoolExecutor(len(nodes)) as threads:
            list(threads.map(self._seal, nodes))

    def _launch(self, node: Validator) -> None:
        for port in (node.rpc_port, node.p2p_port):
            if _listens(port):
                raise ChainError(f"port {port} of {_LOOPBACK}", "taken", "a free port: is this devnet running already?")
        home = self._home(node)
        arguments = ["--datadir", ".", "--config", "config.toml", "--nat", "none", "--verbosity", "3"]
        if self.consensus == "qbft":
            arguments.append("--mine")
        else:
            arguments += ["--cache", "128"]  # MB; by default its database reserves half a gigabyte on disk at once
            # The sealing key must be open while it seals. It owns nothing and has no role in the contract, and only
            # this machine reaches the endpoint. go-ethereum asks to have that said:
            arguments += ["--unlock", node.address, "--password", "keystore/validator.password"]
            arguments += ["--allow-insecure-unlock", "--miner.etherbase", node.address]
        with self.log(node.index).open("ab") as log:
            process = subprocess.Popen(  # noqa: S603
                [self._binary, *arguments],
                cwd=home,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=_environment(),
                start_new_session=True,  # a Ctrl-C is ours to hand on
            )
        self._processes[node.index] = process
        # One after the other: a node dials the peers that it finds when it starts, and again only half a minute later.
        self._wait(lambda: _listens(node.rpc_port) and _listens(node.p2p_port), node, "a node that answers")

    def _seal(self, node: Validator) -> None:
        # go-ethereum takes no price of 0 from its configuration, but from its console.
        script = "miner.setGasPrice(0) && miner.start() === null"
        command = [self._binary, "attach", "--exec", script, "geth.ipc"]  # a long path would not do
        home = self._home(node)
        done = subprocess.run(command, cwd=home, capture_output=True, text=True, timeout=30, check=False)  # noqa: S603
        if done.stdout.strip() != "true":
            raise ChainError(f"validator {node.index}", done.stdout + done.stderr, "a node that seals, at no price")

    def _wait(self, holds: Callable[[], bool], node: Validator, expected: str) -> None:
        """Until something about a validator holds."""
        end = time.monotonic() + _START_SECONDS
        while not holds():
            self._check_alive()
            if time.monotonic() > end:
                told = f"not there after {_START_SECONDS:g} s"
                raise ChainError(f"validator {node.index}", told, f"{expected} ({self.log(node.index)})")
            time.sleep(0.05)

    def _check_alive(self) -> None:
        for index, process in self._processes.items():
            if process.poll() is not None:
                lines = self.log(index).read_text(encoding="utf-8", errors="replace").strip().splitlines() or [
                    "no word"
                ]
                told = f"ended with status {process.returncode}: {lines[-1]}"
                raise ChainError(f"validator {index}", told, f"a node that runs ({self.log(index)})")


def find_binary(consensus: Consensus) -> str:
    """The node program: what `make nodes` built, else what is on PATH.

    Raises: ChainError: there is none, or it cannot do this consensus.
    """
    names = ("goquorum", "geth") if consensus == "qbft" else ("geth",)
    wanted = "GoQuorum" if consensus == "qbft" else "go-ethereum 1.13 or earlier"
    tools = [str(root / ".tools" / "bin") for root in (Path.cwd(), Path(__file__).resolve().parents[4])]
    places = os.pathsep.join([*tools, os.environ.get("PATH", os.defpath)])
    found = [path for name in names if (path := shutil.which(name, path=places)) is not None]
    for path in found:
        told = subprocess.run([path, "version"], capture_output=True, text=True, timeout=30, check=False).stdout  # noqa: S603
        version = re.search(r"^Version: (\d+)\.(\d+)", told, re.MULTILINE)
        quorum = "Quorum Version" in told
        recent = version is not None and (int(version[1]), int(version[2])) >= (1, 14)
        if quorum if consensus == "qbft" else version is not None and not quorum and not recent:
            return path
    raise ChainError(
        f"node program for {consensus}",
        ", ".join(found) or None,
        f"{wanted} on PATH or in .tools/bin (`make nodes` builds it)",
    )


def genesis_of(consensus: Consensus, addresses: Sequence[str], chain_id: int, period: int) -> dict[str, Any]:
    """The first block: its extra data names the validators."""
    forks = [
        "homestead",
        "eip150",
        "eip155",
        "eip158",
        "byzantium",
        "constantinople",
        "petersburg",
        "istanbul",
        "berlin",
    ]
    config: dict[str, Any] = {"chainId": chain_id, **{f"{fork}Block": 0 for fork in forks}}
    genesis: dict[str, Any] = {
        "config": config,
        "nonce": "0x0",
        "timestamp": "0x0",
        "gasLimit": hex(GAS_PER_SECOND * period),
        "difficulty": "0x1",
        "alloc": {},
    }
    accounts = [bytes.fromhex(address[2:]) for address in addresses]
    if consensus == "qbft":
        # GoQuorum's line left go-ethereum before London; what it lacks is the BASEFEE opcode, which we do not use.
        config |= {"isQuorum": True, "txnSizeLimit": 128, "maxCodeSizeConfig": [{"block": 0, "size": 24}]}
        config["qbft"] = {
            "epochlength": 30_000,
            "blockperiodseconds": period,
            "requesttimeoutseconds": 2 * period,
            "policy": 0,
            "ceil2Nby3Block": 0,
            "validatorcontractaddress": "0x0000000000000000000000000000000000000000",
        }
        extra = rlp.encode([bytes(32), accounts, [], b"", []])
        return {**genesis, "extraData": "0x" + extra.hex(), "mixHash": _QBFT_MIX_HASH}
    config |= {"londonBlock": 0, "clique": {"period": period, "epoch": 30_000}}
    extra = bytes(32) + b"".join(accounts) + bytes(65)
    return {**genesis, "extraData": "0x" + extra.hex(), "baseFeePerGas": "0x0"}


def node_config(
    consensus: Consensus, node: Validator, nodes: Sequence[Validator], chain_id: int, period: int
) -> dict[str, Any]:
    """A node's configuration file."""
    peers = [peer.enode for peer in nodes if peer is not node]
    limit = GAS_PER_SECOND * period
    miner: dict[str, Any] = {"GasCeil": limit}
    host: dict[str, Any] = {
        "HTTPHost": _LOOPBACK,
        "HTTPPort": node.rpc_port,
        "HTTPModules": ["eth", "net", "web3", "istanbul" if consensus == "qbft" else "clique"],
    }
    if consensus == "qbft":
        miner["GasFloor"] = limit
        host["IPCPath"] = ""
    else:
        host |= {"IPCPath": "geth.ipc", "AuthAddr": _LOOPBACK, "AuthPort": node.auth_port}
    return {
        "Eth": {
            "NetworkId": chain_id,
            "SyncMode": "full",
            "NoPruning": True,
            "RPCGasCap": limit,
            "Miner": miner,
            # One coordinator or one load test may have many transactions under way.
            "TxPool": {"AccountSlots": 4096, "GlobalSlots": 16_384, "AccountQueue": 4096, "GlobalQueue": 16_384},
        },
        "Node": {
            **host,
            "P2P": {
                # No more than there are: go-ethereum asks only so many, or else five, before it catches up at once.
                "MaxPeers": max(1, len(peers)),
                "DialRatio": 1,
                "NoDiscovery": True,
                "BootstrapNodes": [],
                "BootstrapNodesV5": [],
                "StaticNodes": peers,
                "TrustedNodes": peers,
                "ListenAddr": f"{_bracketed(node.host)}:{node.p2p_port}",
            },
        },
    }


def _initialise(binary: str, home: Path, genesis: Path) -> None:
    command = [binary, "--datadir", str(home), "init", str(genesis)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)  # noqa: S603
    if done.returncode:
        lines = (done.stdout + done.stderr).strip().splitlines() or ["no word"]
        raise ChainError(f"{binary} init", lines[-1], "a node program that takes this genesis")


def write_keystore(folder: Path, name: str, key: Key) -> None:
    """An encrypted key and, beside it, the password that opens it, both for the owner's eyes only."""
    folder.mkdir(parents=True)
    folder.chmod(0o700)
    password = secrets.token_hex(32)
    write_secret(folder / f"{name}.json", json.dumps(Account.encrypt(key.secret, password, iterations=_LIGHT_KDF)))
    write_secret(folder / f"{name}.password", password)


def write_secret(path: Path, text: str) -> None:
    """Write a file that has been readable by its owner alone from its first byte on."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
        file.write(text)


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _environment() -> dict[str, str]:
    """What a node may know of ours: not the passwords that may be in our environment."""
    passed = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ}
    return {**passed, "PRIVATE_CONFIG": "ignore"}  # GoQuorum: no private transactions


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.create_server((_LOOPBACK, 0))) for _ in range(count)]
        return [server.getsockname()[1] for server in sockets]


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1)
        return probe.connect_ex((_LOOPBACK, port)) == 0


def _linked(url: str, others: int) -> bool:
    return (_number(url, "net_peerCount") or 0) >= others


def _number(url: str, method: str) -> int | None:
    """What a method without parameters returns, such as the height of a node's chain; None where it does not answer."""
    ask = json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": []}).encode()
    try:
        return int(parse_json(Http(url, timeout=2.0).read(ask, most=4096, deadline=4.0))["result"], 16)
    except (HttpError, ValueError, KeyError, TypeError):
        return None
