"""Everything on this machine: a chain, a store, a bus, a process for each kind of agent, and the world as the clock."""

from __future__ import annotations

import json
import os
import secrets
import socket
import threading
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomli_w

from skyrelay.chain.accounts import PASSWORD, Keyring
from skyrelay.chain.node.chain import NodeChain
from skyrelay.core.errors import ChainError, SkyRelayError, UsageError
from skyrelay.core.files import write_text
from skyrelay.core.plugins import is_code
from skyrelay.core.progress import Progress
from skyrelay.core.scenario import Scenario, to_toml
from skyrelay.net.http import public_address
from skyrelay.pilot.config import ClockConfig
from skyrelay.pilot.lockstep import by_the_contract_only
from skyrelay.pilot.nodes import kubo, kubo_program, validators
from skyrelay.pilot.processes import Children
from skyrelay.pilot.world import NAME, on_chain
from skyrelay.runfolder.folder import CHAIN, SCENARIO
from skyrelay.runfolder.manifest import write_manifest
from skyrelay.runfolder.reader import read_summary
from skyrelay.simulation.consortium import Consortium
from skyrelay.simulation.run import without_credentials
from skyrelay.simulation.world import World

START = 60.0
"""What is not ready after so long does not start [s]."""
LATEST = 3600.0
"""So long the hosts may take that people start elsewhere [s]."""
LOOPBACK = "127.0.0.1"
TLS = {"authority": "ca.pem", "certificate": "host.pem", "key": "host-key.pem"}
"""The files of a machine's certificates, as they are named in its folder."""
TOKEN = "SKYRELAY_CHAIN_TOKEN"  # noqa: S105  (the variable's name)


@dataclass(frozen=True)
class Place:
    """One process that hosts agents: the kind, the host's name, its keys, and its part of the file."""

    kind: str
    name: str
    keyring: Keyring
    table: dict[str, Any]

    def accounts(self) -> dict[str, str]:
        """Addresses by the names under which the run knows who is hosted here."""
        if self.kind == "coordinator":
            number = self.name.removeprefix("coordinator").replace("-", " ")  # of one that stands by
            return {
                f"{party}{number}": self.keyring.account(party) for party in ("coordinator", "reputation authority")
            }
        names = [member["name"] for member in self.table[self.kind]]
        return {name: self.keyring.account(name) for name in names}


@dataclass(frozen=True)
class Nodes:
    """Node programs that are started with the agents.

    Attributes:
        validators: of a consortium's chain; 0 for a chain server of our own.
        folder: of their chain, which stays.
        replace: the chain of an earlier run that is there.
        kubo: a Kubo node as the store.
    """

    validators: int = 0
    folder: Path = Path("devnet")
    replace: bool = False
    kubo: bool = False

    def __bool__(self) -> bool:
        return self.kubo or self.validators > 0

    @contextmanager
    def started(self, scenario: Scenario, say: Callable[[str], None], address: str) -> Iterator[Scenario]:
        """Start them; gives the scenario with where they are reached.

        Raises:
            UsageError: the scenario names such a node already, or other machines are to reach one of these.
            ChainError, StoreError: a node program is not there, or does not run.
        """
        for option, wanted, named in (
            ("--validators", self.validators, scenario.chain.url),
            ("--kubo", self.kubo, scenario.store.url),
        ):
            if wanted and named:
                raise UsageError(option, None, f"no other node named, as {public_address(named)} is")
            if wanted and address != LOOPBACK:
                raise UsageError(
                    option, f"beside --address {address}", f"hosts on {LOOPBACK}, where such a node answers"
                )
        with ExitStack() as stack:
            if self.kubo:
                kubo_program()  # what is missing is told before anything runs
            changed: dict[str, Any] = {}
            if self.validators:
                urls = stack.enter_context(validators(self.folder, self.validators, say, replace=self.replace))
                changed["chain"] = scenario.chain.model_copy(update={"url": ",".join(urls)})
            if self.kubo:
                home = Path(stack.enter_context(TemporaryDirectory(prefix="skyrelay-kubo-"))) / "repository"
                url = stack.enter_context(kubo(home, say))
                changed["store"] = scenario.store.model_copy(update={"url": url})
            yield scenario.model_copy(update=changed)


def up(
    scenario: Scenario,
    folder: Path,
    hosts: Path,
    say: Callable[[str], None],
    progress: Progress,
    finish: Callable[[Path], None] = lambda _: None,
    *,
    address: str = LOOPBACK,
    elsewhere: Sequence[str] = (),
    uav_hosts: int = 1,
    coordinators: int = 1,
    standby: float = 5.0,
    wait: float = 30.0,
    speed: float | None = None,
    clock: ClockConfig | None = None,
    nodes: Nodes = Nodes(),
    live: int | None = None,
    tls: Path | None = None,
) -> dict[str, Any]:
    """Start all of it, play the scenario in lock-step, and leave a run folder as `skyrelay.simulation.play` does.

    Args:
        folder: of the run.
        hosts: where each process finds its configuration and keystore, and leaves its log.
        say: is called with every line about a process.
        finish: as `skyrelay.simulation.play` has it.
        address: of this machine, where chain and bus are reached.
        elsewhere: kinds of hosts that are not started here: their files are written, and who starts them is waited for.
        uav_hosts: how many processes share the UAVs.
        coordinators: how many hosts may close periods and decide proposals; all but the first stand by.
        standby: how long each leaves the ones before it to act [s].
        wait: how long the world stands still for a host that does not answer [s].
        speed: seconds of the world's clock to one of the wall's, at most; None as fast as the hosts can.
        clock: by which the hosts go by themselves; None: the world asks them, in lock-step.
        nodes: the real node programs in place of our own parts.
        live: the port on loopback at which a page shows the fleet; None for no page.
        tls: the folder of this machine's certificates (`TLS`), where links on the bus are encrypted.
    Returns: the summary, as in ``summary.json``.
    Raises:
        UsageError, TraceError, ModelError, StoreError, ChainError, BusError: naming what was wrong with what.
    """
    if scenario.selection.method != "two-sided":
        raise by_the_contract_only()
    if scenario.chain.allocation != "strict":
        raise UsageError("chain.allocation", scenario.chain.allocation, "strict: hosts have no book of claims")
    if scenario.payment.enabled:
        raise UsageError("payment.enabled", True, "false: so far receipts are exchanged in `skyrelay run` alone")
    begin = time.monotonic()
    with ExitStack() as stack:
        if nodes:
            progress.stage("Node programs", 1)
        scenario = stack.enter_context(nodes.started(scenario, say, address))
        progress.stage("Vehicles", 1)
        world = World.of(scenario)
        write_text(hosts / "scenario.toml", to_toml(without_credentials(world.scenario)))
        progress.stage("Chain and keys", 1)
        password = os.environ.get(PASSWORD) or secrets.token_urlsafe(32)
        token = secrets.token_urlsafe(32)
        on_bus = _bus_of(f"{'tcp' if tls is None else 'tls'}/{address}:{free_port(address)}", tls)
        playing = threading.Event()

        def lost(name: str) -> None:
            if name != "live" and not playing.is_set():  # the world would wait for it in vain
                children.end(NAME)

        children = stack.enter_context(Children(hosts, {PASSWORD: password, TOKEN: token}, say, lost))
        url = scenario.chain.url
        if url is None:
            listen = f"{address}:{free_port(address)}"
            url = f"http://skyrelay:{token}@{listen}"
            children.start("chain", ["chain", "serve", "--state", str(folder / CHAIN), "--listen", listen], again=True)
            _wait_for_chain(url, children)
        places = _places(world, hosts, password, uav_hosts, coordinators, standby)
        accounts = _accounts(places)
        founded = on_chain(world.scenario, url)
        world = replace(world, scenario=without_credentials(on_chain(world.scenario, url)))
        write_text(folder / SCENARIO, to_toml(world.scenario))
        consortium = stack.enter_context(Consortium(founded, folder, elsewhere=accounts, coordinators=coordinators))
        consortium.found()

        def start_hosts() -> None:
            # Their files come now, since who starts a host by hand may wait for its file alone.
            for place in places:
                there = place.kind in elsewhere
                path = _write_config(place, world, consortium, hosts, url, on_bus, there, clock, scenario.store.url)
                command = ["agent", place.kind, "--config", str(path)]
                if place.kind == "uav" and is_code(scenario.coordination.policy):
                    command += ["--policy", scenario.coordination.policy]
                if there:
                    say(f"{place.name:<12} is waited for: skyrelay {' '.join(command)}")
                else:
                    children.start(place.name, command, again=True)

        watch = _write_watch(world, consortium, hosts, url, on_bus, accounts)
        file = hosts / f"{NAME}.toml"
        settings = {
            "folder": str(folder.resolve()),
            "begun": begin,
            "hosts": [place.name for place in places],
            "accounts": accounts,
            "parties": consortium.parties(),
            "deciders": consortium.deciders(),
            "gather": LATEST if elsewhere else START,
            "wait": wait,
            **({} if speed is None else {"speed": speed}),
            **({} if clock is None else {"clock": clock.model_dump(exclude_defaults=True)}),
        }
        _write_world(file, settings, consortium, url, on_bus)
        told = map(json.loads, children.follow(NAME, ["world", "--config", str(file)]))
        try:
            next(told)  # its end of the bus is there, which the hosts join by
            start_hosts()
            if live is not None:
                children.start("live", ["live", "--config", str(watch), "--port", str(live)])
                say(f"{'live':<12} http://{LOOPBACK}:{live}/")
            for line in told:
                if "say" in line:
                    say(line["say"])
                elif "stage" in line:
                    playing.set()
                    progress.stage(line["stage"], line["total"])
                else:
                    progress.advance(line["advance"])
        except SkyRelayError:
            for place in places:
                if not playing.is_set():
                    children.check(place.name)  # why the world was ended
            raise
        finish(folder)
        write_manifest(folder, consortium.signer)
    return dict(read_summary(folder))


@contextmanager
def new_hosts_folder(path: Path) -> Iterator[Path]:
    """An empty folder for the hosts' files, which stay for who wants to read their logs; no key and no password does.

    Raises:
        UsageError: something is at ``path`` that no run of this kind left.
    """
    left = {".log", ".toml", ".keystore"}
    try:
        path.mkdir(parents=True, exist_ok=True)
        path.chmod(0o700)
        for file in path.iterdir():
            if file.suffix not in left:
                raise UsageError(path, file.name, "a folder for the hosts' files, with nothing else in it")
        for file in path.iterdir():
            file.unlink()
    except OSError as error:
        raise UsageError(path, None, f"a place for the hosts' files ({error.strerror})") from error
    try:
        yield path
    finally:
        for file in path.glob("*.keystore"):
            file.unlink()
        for file in path.glob("*.toml"):
            _without_credentials(file)


def _without_credentials(file: Path) -> None:
    """Take names, passwords and tokens out of the addresses of a file; one that cannot be read goes."""
    try:
        tree = tomllib.loads(file.read_text("utf-8"))
    except (OSError, ValueError):
        file.unlink()
        return
    for table in (tree.get("chain"), tree.get("store")):
        if isinstance(table, dict):
            for key in ("url", "urls"):
                if isinstance(urls := table.get(key), str | list):
                    table[key] = public_address(urls) if isinstance(urls, str) else [*map(public_address, urls)]
    write_text(file, tomli_w.dumps(tree), private=True)


def a_port(wanted: int) -> int:
    """A TCP port of loopback: the one that is wanted, or any where somebody has it."""
    with socket.socket() as probe:
        try:
            probe.bind((LOOPBACK, wanted))
        except OSError:
            return free_port()
    return wanted


def free_port(address: str = LOOPBACK) -> int:
    """A TCP port of one of this machine's addresses that nobody listens at now.

    Raises:
        UsageError: it is no address of this machine.
    """
    with socket.socket() as probe:
        try:
            probe.bind((address, 0))
        except OSError as error:
            raise UsageError("--address", address, f"an address of this machine ({error.strerror})") from None
        port: int = probe.getsockname()[1]
        return port


def _wait_for_chain(url: str, children: Children) -> None:
    """Until the chain server answers.

    Raises:
        ChainError, SkyRelayError: it does not, or it has ended.
    """
    until = time.monotonic() + START
    while True:
        children.check("chain")
        try:
            NodeChain(url, Keyring.ephemeral())
        except ChainError:
            if time.monotonic() > until:
                raise
        else:
            return


def _places(world: World, hosts: Path, password: str, uav_hosts: int, coordinators: int, standby: float) -> list[Place]:
    """A host for the vehicles, some for the UAVs, some for the zones' coordinator, each with keys of its own."""
    members, fleet = world.members, world.fleet
    vehicles = [
        {"name": name, "demand": demand, "payment": payment}
        for name, demand, payment in zip(
            world.tracks.ids, members.demand.tolist(), members.payment.tolist(), strict=True
        )
    ]
    uavs = [
        {"name": name, "zone": zone, "bandwidth": bandwidth}
        for name, zone, bandwidth in zip(fleet.ids, fleet.zone.tolist(), fleet.bandwidth.tolist(), strict=True)
    ]
    # Each has the next so many, so that they register in the fleet's order.
    share = -(-len(uavs) // min(uav_hosts, len(uavs)))
    parts = [uavs[start : start + share] for start in range(0, len(uavs), share)]
    zones = list(world.law.grid.ids)
    coordinating: list[dict[str, Any]] = [
        {"zones": zones} | ({"standby": number * standby} if number else {}) for number in range(coordinators)
    ]
    tables: list[tuple[str, str, dict[str, Any]]] = [
        ("vehicle", "vehicles", {"vehicle": vehicles}),
        *(
            ("uav", "uavs" if len(parts) == 1 else f"uavs-{number}", {"uav": part})
            for number, part in enumerate(parts, 1)
        ),
        *(
            ("coordinator", "coordinator" if number == 1 else f"coordinator-{number}", {"coordinator": table})
            for number, table in enumerate(coordinating, 1)
        ),
    ]
    places = [
        Place(kind, name, Keyring.create(hosts / f"{name}.keystore", password), table) for kind, name, table in tables
    ]
    reputations = world.reputations(_accounts(places).__getitem__)
    for table in coordinating:
        table["reputations"] = reputations
    return places


def _accounts(places: Sequence[Place]) -> dict[str, str]:
    """Addresses by name."""
    return {name: address for place in places for name, address in place.accounts().items()}


def _chain_of(world: World, consortium: Consortium, url: str) -> dict[str, Any]:
    """The table of a file that says where the contract is."""
    return {
        "urls": url.split(","),
        "chain_id": consortium.chain.chain_id,
        "contract": consortium.client.address,
        "confirmations": world.scenario.chain.confirmations,
    }


def _write_watch(
    world: World, consortium: Consortium, hosts: Path, url: str, bus: dict[str, Any], accounts: dict[str, str]
) -> Path:
    """The file of whoever looks on (`skyrelay live`): it has no key."""
    plane = world.tracks.plane
    config = {
        "scenario": "scenario.toml",
        "area": asdict(world.law.grid),
        **({} if plane is None else {"plane": plane}),
        "chain": _chain_of(world, consortium, url),
        "bus": bus,
        "members": {address: name for name, address in accounts.items()},
    }
    path = hosts / "live.toml"
    write_text(path, tomli_w.dumps(config), private=True)
    return path


def _write_config(
    place: Place,
    world: World,
    consortium: Consortium,
    hosts: Path,
    url: str,
    bus: dict[str, Any],
    elsewhere: bool,
    clock: ClockConfig | None,
    store_url: str | None,
) -> Path:
    """The file that a place's process is started with."""
    config = {
        "name": place.name,
        "scenario": "scenario.toml",
        **({} if clock is None else {"clock": clock.model_dump(exclude_defaults=True)}),
        "area": asdict(world.law.grid),
        "chain": _chain_of(world, consortium, url) | {"keystore": f"{place.name}.keystore"},
        "store": {"url": store_url} if store_url else {"path": consortium.store.place.removeprefix("store ")},
        "bus": _elsewhere(bus) if elsewhere else bus,
        **place.table,
    }
    path = hosts / f"{place.name}.toml"
    write_text(path, tomli_w.dumps(config), private=True)
    return path


def _bus_of(endpoint: str, tls: Path | None) -> dict[str, Any]:
    """The table of a file on this machine that says where the bus is."""
    files = {} if tls is None else {"tls": {what: str(tls.resolve() / name) for what, name in TLS.items()}}
    return {"connect": [endpoint], **files}


def _elsewhere(bus: dict[str, Any]) -> dict[str, Any]:
    """The same for another machine, whose certificates are beside its file."""
    if "tls" not in bus:
        return bus | {"listen": ["tcp/0.0.0.0:0"]}
    return bus | {"listen": ["tls/0.0.0.0:0"], "tls": dict(TLS)}


def _write_world(file: Path, settings: dict[str, Any], consortium: Consortium, url: str, bus: dict[str, Any]) -> None:
    """The file that the world's process is started with."""
    access = {
        "urls": url.split(","),
        "chain_id": consortium.chain.chain_id,
        "contract": consortium.client.address,
    }
    tree = {
        "scenario": str(file.with_name("scenario.toml").resolve()),
        **settings,
        "chain": access,
        "bus": {"listen": bus["connect"], **({"tls": bus["tls"]} if "tls" in bus else {})},
    }
    write_text(file, tomli_w.dumps(tree), private=True)
