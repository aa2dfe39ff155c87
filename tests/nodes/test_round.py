"""A full selection round on four validators that die and return: it ends as on the embedded chain, nothing twice."""

import random
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Chain
from skyrelay.chain.client import IovClient, ModelCard, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.node.devnet import Devnet
from skyrelay.chain.proof.audit import audit_node
from skyrelay.store.cid import cid_of

pytestmark = [pytest.mark.nodes, pytest.mark.xdist_group("devnet")]

ZONE, UAVS, VEHICLES = 1, 6, 40
CARD = ModelCard(2, 8, 1, 60, 11, 6, 9, -4.0)


@dataclass(frozen=True)
class Outcome:
    """What a round left on the chain, in members' names."""

    selections: dict[str, list[str]]
    available: dict[str, int]
    model: bytes
    events: Counter[str]


def nothing() -> None:
    """No fault."""


def play_round(chain: Chain, fault: Callable[[], None] = nothing) -> tuple[str, Outcome]:
    """Deploy, register, propose (with ``fault`` while proposals are under way), allocate, assign a model."""
    rng = random.Random(7)  # noqa: S311
    party = {name: chain.account(name) for name in ("administrator", "coordinator", "publisher")}
    uavs = {f"uav {i}": chain.account(f"uav {i}") for i in range(UAVS)}
    vehicles = {f"vehicle {i}": chain.account(f"vehicle {i}") for i in range(VEHICLES)}
    client = IovClient.deploy(chain, Settings(), party["administrator"])
    roles = {Role.COORDINATOR: party["coordinator"], Role.PUBLISHER: party["publisher"]}
    client.execute([client.grant_role(party["administrator"], role, account) for role, account in roles.items()])
    client.execute([client.register_model(party["publisher"], bytes(cid_of(b"a policy")), CARD)])

    def place() -> tuple[float, float]:
        return rng.randrange(20_000) / 10, rng.randrange(20_000) / 10

    client.execute(
        [client.register_uav(u, UavRecord(*place(), 100, rng.randint(20, 100), 9_000, ZONE)) for u in uavs.values()]
        + [client.register_vehicle(v, VehicleRecord(*place(), rng.randint(1, 700), ZONE)) for v in vehicles.values()]
    )
    wishes = [(v, rng.choice(list(uavs.values())), rng.randint(500, 4_000)) for v in vehicles.values()]
    proposals = [client.submit_veh_selection(vehicle, uav, demand, 1) for vehicle, uav, demand in wishes]
    client.execute(proposals[:10])
    meanwhile = threading.Thread(target=fault)
    meanwhile.start()
    client.execute(proposals[10:])
    meanwhile.join()
    allocated = False
    while not allocated:
        receipts = client.execute([client.allocate_zone(party["coordinator"], ZONE, 15)])
        allocated = any(event.name == "ZoneAllocated" for event in client.events_of(receipts))
    client.execute([client.determine_mdrl_model(party["coordinator"], ZONE)])
    return client.address, outcome(client)


def outcome(client: IovClient) -> Outcome:
    uavs = {client.chain.account(f"uav {i}"): f"uav {i}" for i in range(UAVS)}
    vehicles = {client.chain.account(f"vehicle {i}"): f"vehicle {i}" for i in range(VEHICLES)}
    model = client.model_of_zone(ZONE)
    assert model is not None
    return Outcome(
        {uavs[uav]: sorted(vehicles[v] for v in chosen) for uav, chosen in client.selections(list(uavs)).items()},
        {uavs[info.address]: info.available for info in client.uav_infos(list(uavs))},
        model.cid,
        Counter(event.name for event in client.events()),
    )


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """The round on the embedded chain."""
    with EmbeddedChain(tmp_path_factory.mktemp("embedded") / "chain") as chain:
        found = play_round(chain)[1]
    assert sum(map(len, found.selections.values())) > UAVS, "the round selects some"
    assert sum(map(len, found.selections.values())) < VEHICLES, "and rejects some"
    return found


@contextmanager
def running(directory: Path, consensus: Literal["qbft", "clique"], validators: int = 4) -> Iterator[Devnet]:
    with Devnet.create(directory, consensus=consensus, validators=validators) as network:
        yield network


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Devnet]:
    with running(tmp_path_factory.mktemp("qbft") / "net", "qbft") as network:
        yield network


def connect(network: Devnet, *validators: int) -> NodeChain:
    keystore, password = network.operator
    return NodeChain(
        [network.endpoints[i] for i in validators],
        Keyring.open(keystore, password.read_text()),
        chain_id=network.chain_id,
        confirmations=0 if network.consensus == "qbft" else len(network.validators) // 2 + 1,
    )


def agrees_elsewhere(network: Devnet, validator: int, address: str, expected: Outcome) -> None:
    """Another validator tells the same, and an audit from there finds every selection right."""
    chain = connect(network, validator)
    assert outcome(IovClient.connect(chain, address, network.chain_id)) == expected
    report = audit_node(chain, address)
    assert report.agrees, report.differences
    assert report.checked["proposals"] == VEHICLES
    assert report.checked["vehicles selected"] == sum(map(len, expected.selections.values()))


def test_a_round_and_what_another_validator_says_of_it(network, expected):
    address, found = play_round(connect(network, 0))
    assert found == expected
    agrees_elsewhere(network, 3, address, expected)


def test_one_validator_dies_in_mid_round(network, expected):
    try:
        assert play_round(connect(network, 0), lambda: network.kill(2))[1] == expected
    finally:
        network.start()


def test_the_clients_validator_dies_and_it_turns_to_the_next(network, expected):
    try:
        assert play_round(connect(network, 0, 1), lambda: network.kill(0))[1] == expected
    finally:
        network.start()


def test_the_endpoint_vanishes_for_20_s(network, expected):
    def vanish() -> None:
        network.kill(1)
        time.sleep(20)
        network.restart(1)

    try:
        assert play_round(connect(network, 1), vanish)[1] == expected
    finally:
        network.start()


def test_all_die_and_return_and_nothing_is_lost_or_doubled(network, expected):
    def power_cut() -> None:
        for node in network.validators:
            network.kill(node.index)
        network.start()

    try:
        address, found = play_round(connect(network, 0), power_cut)
    finally:
        network.start()
    assert found == expected
    for node in network.validators:
        network.kill(node.index)
    network.start()
    agrees_elsewhere(network, 2, address, expected)


@pytest.mark.xdist_group("clique")
def test_a_round_on_clique_with_one_validator_lost(tmp_path, expected):
    with running(tmp_path / "net", "clique", validators=5) as clique:
        address, found = play_round(connect(clique, 0), lambda: clique.kill(2))
        assert found == expected
        agrees_elsewhere(clique, 3, address, expected)
