"""The node's chain against a node that loses, forgets, lies low and comes back."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from chain_rounds import World
from json_rpc_node import Node

from skyrelay.chain.abi import ContractError
from skyrelay.chain.accounts import PASSWORD, PASSWORD_FILE, Keyring
from skyrelay.chain.chain import Call
from skyrelay.chain.client import IovClient, Settings, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.node.chain import NodeChain
from skyrelay.core.errors import ChainError


@pytest.fixture
def node() -> Iterator[Node]:
    with Node() as running:
        yield running


def connect(node: Node, **options: float) -> NodeChain:
    defaults = {"poll": 0.01, "rebroadcast": 0.05, "patience": 20.0}
    return NodeChain(node.url, Keyring(b"k" * 32), **(defaults | options))  # type: ignore[arg-type]


def client_on(node: Node, **options: float) -> IovClient:
    chain = connect(node, **options)
    return IovClient.deploy(chain, Settings(), chain.account("admin"))


def vehicles(client: IovClient, count: int) -> list[Call]:
    names = [client.chain.account(f"vehicle {i}") for i in range(count)]
    return [client.register_vehicle(name, VehicleRecord(i, 2 * i, 10, 1)) for i, name in enumerate(names)]


def assert_each_mined_once(node: Node, client: IovClient, count: int) -> None:
    registered = [e.args["vehicle"] for e in client.events() if e.name == "VehicleRegistered"]
    assert len(registered) == len(set(registered)) == count
    failed = [r for block in node.chain.blocks for r in block.receipts if not r.status]
    assert failed == []


def test_a_whole_round_leaves_the_events_of_the_embedded_chain(node: Node) -> None:
    worlds = [World(chain, uavs=4, vehicles=8) for chain in (connect(node), EmbeddedChain())]
    for world in worlds:
        world.found()
        world.play(periods=1)
    on_node, embedded = ([event.name for event in world.client.events()] for world in worlds)
    assert sorted(on_node) == sorted(embedded)
    assert "UAVAllocated" in on_node


def test_many_transactions_of_one_sender_follow_each_other(node: Node) -> None:
    client = client_on(node)
    sender = client.chain.account("one")
    calls = [client.register_vehicle(sender, VehicleRecord(0, 0, 1, 1))]
    calls += [client.update_vehicle_info(sender, VehicleRecord(i, 0, 1, 1)) for i in range(1, 150)]
    client.execute(calls)
    assert client.vehicle_info(sender).x == 149
    assert node.chain._state.nonces[int(sender, 16)] == 150


def test_a_lost_answer_doubles_nothing(node: Node) -> None:
    client = client_on(node)
    node.lost_answers = 3
    client.execute(vehicles(client, 30))
    assert_each_mined_once(node, client, 30)


def test_a_pool_that_was_forgotten_is_filled_again_with_the_same_bytes(node: Node) -> None:
    client = client_on(node)
    node.seen.clear()
    node.forget_pool = True
    client.execute(vehicles(client, 20))
    assert_each_mined_once(node, client, 20)
    assert len(node.seen) > 20
    assert len(set(node.seen)) == 20


def test_a_full_pool_is_waited_for(node: Node) -> None:
    client = client_on(node)
    node.full_pool = 25
    client.execute(vehicles(client, 20))
    assert_each_mined_once(node, client, 20)


def test_a_receipt_that_is_not_found_at_once(node: Node) -> None:
    client = client_on(node)
    node.blind = 40
    client.execute(vehicles(client, 20))
    assert_each_mined_once(node, client, 20)


def test_a_node_that_vanishes_costs_a_retry(node: Node) -> None:
    client = client_on(node)
    node.gone_until = time.monotonic() + 1.5
    client.execute(vehicles(client, 10))
    assert_each_mined_once(node, client, 10)


def test_another_endpoint_serves_while_one_is_gone(node: Node) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        nobody = f"http://127.0.0.1:{probe.getsockname()[1]}"
    chain = NodeChain([nobody, node.url], Keyring(b"k" * 32), poll=0.01)
    assert chain.chain_id == node.chain.chain_id


def test_patience_ends(node: Node) -> None:
    client = client_on(node, patience=0.3)
    node.gone_until = time.monotonic() + 60
    with pytest.raises(ChainError, match=r"a node that answers JSON-RPC within 0\.3 s"):
        client.execute(vehicles(client, 1))


def test_confirmations_are_waited_for(node: Node) -> None:
    client = client_on(node)
    chain = connect(node, confirmations=2, patience=0.5)
    careful = IovClient(chain, client.address, client.settings)
    first, second = vehicles(careful, 2)
    with pytest.raises(ChainError, match="1 of 1 mined"):
        careful.execute([first])  # nobody else makes blocks here, so it stays unconfirmed
    assert chain.block_number == node.chain.block_number - 2
    node.blocks_by_themselves = True
    (receipt,) = careful.execute([second])
    assert node.chain.block_number >= receipt.block + 2


def test_a_refusal_is_decoded(node: Node) -> None:
    client = client_on(node)
    (call,) = vehicles(client, 1)
    client.execute([call])
    with pytest.raises(ContractError) as caught:
        client.execute([call])
    assert (caught.value.function, caught.value.error) == ("registerVehicle", "AlreadyRegistered")
    assert caught.value.arguments == {"member": call.sender}


def test_the_wrong_chain_address_or_contract_is_refused(node: Node) -> None:
    client = client_on(node)
    chain = connect(node)
    assert IovClient.connect(chain, client.address, chain.chain_id).settings == client.settings
    with pytest.raises(ChainError, match="another network"):
        NodeChain(node.url, Keyring.ephemeral(), chain_id=1)
    with pytest.raises(ChainError, match="another network"):
        IovClient.connect(chain, client.address, chain_id=1)
    with pytest.raises(ChainError, match="a contract's address"):
        IovClient.connect(chain, "0x" + "12" * 20)
    with pytest.raises(ChainError, match="0x and 40 hexadecimal digits"):
        IovClient.connect(chain, "0x12")
    created = chain.send([Call(chain.account("admin"), None, bytes.fromhex("600160005360016000f3"))])[0].created
    assert created is not None
    with pytest.raises(ChainError, match="another one is there"):
        IovClient.connect(chain, created)


def test_an_address_where_nobody_answers() -> None:
    with pytest.raises(ChainError, match="http:// or https://"):
        NodeChain("localhost:8545", Keyring.ephemeral())


def test_a_sender_of_another_host_cannot_be_signed_for(node: Node) -> None:
    with pytest.raises(ChainError, match="an account of this host's keyring"):
        connect(node).send([Call("0x" + "12" * 20, None, b"")])


# Keys


def test_a_keystore_keeps_its_members(tmp_path: Path) -> None:
    path = tmp_path / "keys" / "members.json"
    ring = Keyring.create(path, "a password")
    assert path.stat().st_mode & 0o077 == 0
    again = Keyring.open(path, "a password")
    assert again.account("vehicle 1") == ring.account("vehicle 1") != ring.account("vehicle 2")
    assert "a password" not in path.read_text()
    with pytest.raises(ChainError, match="a place for a new keystore"):
        Keyring.create(path, "another")
    with pytest.raises(ChainError, match="a Web3 keystore and its password") as caught:
        Keyring.open(path, "not this one")
    assert "not this one" not in str(caught.value)
    path.write_text("{}")
    with pytest.raises(ChainError, match="a Web3 keystore"):
        Keyring.open(path, "a password")


def test_the_password_comes_from_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "members.json"
    ring = Keyring.create(path, "from a file")
    monkeypatch.delenv(PASSWORD, raising=False)
    monkeypatch.delenv(PASSWORD_FILE, raising=False)
    with pytest.raises(ChainError, match=PASSWORD_FILE):
        Keyring.open(path)
    (tmp_path / "password").write_text("from a file\n")
    monkeypatch.setenv(PASSWORD_FILE, str(tmp_path / "password"))
    assert Keyring.open(path).account("a") == ring.account("a")
    monkeypatch.setenv(PASSWORD, "the variable wins")
    with pytest.raises(ChainError, match="its password"):
        Keyring.open(path)


def test_a_ring_shows_no_secret() -> None:
    assert repr(Keyring(b"k" * 32)) == "Keyring(0 accounts)"
    with pytest.raises(ChainError, match="32 bytes"):
        Keyring(b"short")
