"""Four validators on loopback: what is written, and that blocks go on."""

import json
import socket
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient, Settings, VehicleRecord
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.node.devnet import GAS_PER_SECOND, Devnet
from skyrelay.chain.node.rpc import Endpoints
from skyrelay.core.errors import ChainError, UsageError

pytestmark = pytest.mark.nodes


def ask(url: str, method: str, *parameters: object) -> Any:
    body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": parameters}).encode()
    request = urllib.request.Request(url, body, {"Content-Type": "application/json"})  # noqa: S310
    with urllib.request.urlopen(request, timeout=10) as answer:  # noqa: S310
        return json.load(answer)["result"]


def block_hash(url: str, number: int) -> str:
    return str(ask(url, "eth_getBlockByNumber", hex(number), False)["hash"])


def listening_addresses() -> dict[int, set[str]]:
    """Ports of this machine that are listened on, with the addresses, from the kernel's tables."""
    found: dict[int, set[str]] = {}
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            local, state = line.split()[1], line.split()[3]
            if state == "0A":
                address, _, port = local.rpartition(":")
                found.setdefault(int(port, 16), set()).add(address)
    return found


# Of four signers Clique needs three to take turns: without one, a fork between two of them would stop it.
@pytest.mark.parametrize(("consensus", "validators"), [("qbft", 4), ("clique", 5)])
def test_blocks_go_on_through_the_loss_of_one(tmp_path, consensus, validators):
    network = Devnet.create(tmp_path / "net", consensus=consensus, validators=validators)
    with network:
        for node in network.validators:
            for port in (node.rpc_port, node.p2p_port):
                assert listening_addresses()[port] == {"0100007F"}, "127.0.0.1 and nothing else"
            block = ask(node.url, "eth_getBlockByNumber", "latest", False)
            assert len(bytes.fromhex(block["extraData"][2:])) > 32, "as on every proof-of-authority chain"
            assert int(block.get("baseFeePerGas", "0x0"), 16) == 0
        network.kill(1)
        height = network.wait_for_blocks(3)
        network.restart(1)
        assert block_hash(network.endpoints[1], height) == block_hash(network.endpoints[0], height)


def test_qbft_loses_no_block_when_all_are_killed(tmp_path):
    # Not of Clique: killed at once, its signers can come back on forks of equal weight and wait for each other.
    network = Devnet.create(tmp_path / "net")
    with network:
        height = network.wait_for_blocks()
        expected = block_hash(network.endpoints[0], height)
        for node in network.validators:
            network.kill(node.index)
        network.start()
        assert [block_hash(url, height) for url in network.endpoints] == [expected] * 4, "no block was lost"

    again = Devnet.open(tmp_path / "net")
    assert again.validators == network.validators
    with again:
        assert block_hash(again.endpoints[2], height) == expected
        with pytest.raises(ChainError, match=r"port \d+ of 127\.0\.0\.1: is 'taken'; expected a free port"):
            Devnet.open(tmp_path / "net").start()
        again.wait_for_blocks()
    for node in again.validators:
        with socket.socket() as probe:
            assert probe.connect_ex(("127.0.0.1", node.rpc_port)) != 0, "every node has stopped"


@pytest.mark.parametrize("consensus", ["qbft", "clique"])
def test_secrets_are_for_the_owner_alone_and_in_no_other_file(tmp_path, consensus):
    network = Devnet.create(tmp_path / "net", validators=2, consensus=consensus)
    with network:
        network.wait_for_blocks(2)
    secrets = list((tmp_path / "net").rglob("nodekey")) + list((tmp_path / "net").rglob("*.password"))
    assert len(secrets) == (3 if consensus == "qbft" else 5)
    others = [path for path in (tmp_path / "net").rglob("*") if path.is_file() and path not in secrets]
    for secret in secrets:
        assert secret.stat().st_mode & 0o077 == 0
        assert secret.parent.stat().st_mode & 0o077 == 0 or secret.parent.parent.stat().st_mode & 0o077 == 0
        text = secret.read_text()
        assert len(text) == 64
        assert not [path for path in others if text.encode() in path.read_bytes().lower()]


def test_what_does_not_fit_is_refused_and_leaves_nothing(tmp_path):
    cases: list[tuple[dict[str, Any], str]] = [
        ({"validators": 0}, "validators: is 0; expected 1 to 32"),
        ({"period": 0}, "period: is 0; expected 1 to 60 s"),
        ({"chain_id": 0}, "chain id: is 0; expected"),
        ({"rpc_port": 80}, "RPC port: is 80; expected 1024 to"),
    ]
    for wrong, told in cases:
        with pytest.raises(UsageError, match=told):
            Devnet.create(tmp_path / "net", **wrong)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("")
    with pytest.raises(ChainError, match="full: is 'not empty'; expected a folder that is absent or empty"):
        Devnet.create(tmp_path / "full")
    with pytest.raises(
        ChainError, match=r"devnet\.json: is 'No such file or directory'; expected the folder of a devnet"
    ):
        Devnet.open(tmp_path / "full")
    (tmp_path / "full" / "devnet.json").write_text('{"consensus": "pow"}')
    with pytest.raises(ChainError, match="expected what `skyrelay chain devnet` wrote"):
        Devnet.open(tmp_path / "full")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full"]


def test_a_validator_that_ends_is_told_with_its_last_words(tmp_path):
    network = Devnet.create(tmp_path / "net", validators=1)
    config = tmp_path / "net" / "validators" / "0" / "config.toml"
    config.write_text(config.read_text().replace("NetworkId", "NetworkName"))
    with pytest.raises(
        ChainError, match=r"validator 0: is .ended with status 1: .*NetworkName.*expected a node that runs"
    ):
        network.start()


def test_no_node_program_is_told(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("skyrelay.chain.node.devnet.__file__", str(tmp_path / "a" / "b" / "c" / "d" / "e.py"))
    with pytest.raises(ChainError, match=r"node program for qbft: expected GoQuorum on PATH or in \.tools/bin"):
        Devnet.create(tmp_path / "net")


def test_a_burst_beyond_a_block_is_mined_block_by_block_and_no_block_is_thrown_away(tmp_path):
    ring = Keyring(b"b" * 32)
    with Devnet.create(tmp_path / "net") as network:
        chain = NodeChain(network.endpoints, ring, chain_id=network.chain_id)
        client = IovClient.deploy(chain, Settings(), chain.account("administrator"))
        signed = []
        for number in range(4_000):
            sender = ring.account(f"vehicle {number}")
            call = client.register_vehicle(sender, VehicleRecord(1, 2, 3, 1))
            signed.append(ring.sign(sender, call.to, call.data, call.gas, 0, chain.chain_id))
        first = chain.block_number
        nodes = Endpoints(network.endpoints, network.chain_id, None)
        replies = nodes.ask([("eth_sendRawTransaction", ["0x" + raw.hex()]) for _, raw in signed], 60.0)
        assert not [reply for reply in replies if "error" in reply]
        mined, head, blocks = 0, first, []
        while mined < len(signed):
            network.wait_for_blocks()
            last = chain.block_number
            blocks += chain.blocks(range(head + 1, last + 1))
            mined, head = sum(len(block["transactions"]) for block in blocks), last
            assert len(blocks) < 120, f"{mined} of {len(signed)} after {len(blocks)} blocks"
    filled = [len(block["transactions"]) for block in blocks]
    assert all(int(block["gasUsed"], 16) <= GAS_PER_SECOND for block in blocks)
    busy = filled[next(n for n, count in enumerate(filled) if count) :]
    assert sum(count > 0 for count in busy) >= 2, "more than one block holds"
    assert all(any(busy[n : n + 6]) for n in range(len(busy) - 5)), f"no row of empty blocks: {busy}"
