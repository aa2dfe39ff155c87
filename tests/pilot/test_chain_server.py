"""The chain server: real processes, signed transactions, kills."""

import http.client
import json
import socket
from typing import Any

import pytest
import requests
import rlp
from chain_rounds import World
from eth_account import Account
from hypothesis import given, settings
from hypothesis import strategies as st
from processes import free_port, until

from skyrelay.chain.abi import ContractError
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient, Settings, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.signed import read_signed
from skyrelay.core.errors import ChainError, UsageError
from skyrelay.pilot import signed_chain as rpc
from skyrelay.pilot.chain_server import LARGEST_BATCH, LARGEST_BODY, ChainServer
from skyrelay.pilot.signed_chain import RpcError, SignedChain

SKYRELAY = ("-c", "from skyrelay.cli.main import main; main()")
RING = Keyring(b"k" * 32)


@pytest.fixture
def served(tmp_path):
    chain = SignedChain(tmp_path / "state")
    with ChainServer(chain, "127.0.0.1:0") as server:
        yield server
    chain.close()


def connect(url, ring=RING):
    return NodeChain(url, ring, poll=0.01, rebroadcast=0.2, patience=30.0)


def ask(server, method, *params):
    answer = requests.post(server.url, json={"jsonrpc": "2.0", "id": 1, "method": method, "params": params}, timeout=30)
    tree = answer.json()
    if "error" in tree:
        raise RpcError(tree["error"]["code"], tree["error"]["message"], tree["error"].get("data"))
    return tree["result"]


def test_a_whole_round_leaves_the_events_of_the_embedded_chain(served):
    worlds = [World(chain, uavs=4, vehicles=8) for chain in (connect(served.url), EmbeddedChain())]
    for world in worlds:
        world.found()
        world.play(periods=1)
    names = [[event.name for event in world.client.events()] for world in worlds]
    assert names[0] == names[1]
    assert "UAVAllocated" in names[0]


CLIENT = """
import sys
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient, VehicleRecord
from skyrelay.chain.node.chain import NodeChain
url, contract, secret, count = sys.argv[1:]
chain = NodeChain(url, Keyring(bytes.fromhex(secret)), poll=0.01, rebroadcast=0.2, patience=60.0)
client = IovClient.connect(chain, contract)
for number in range(int(count)):
    names = [chain.account(f"{number} {member}") for member in range(3)]
    client.execute([client.register_vehicle(name, VehicleRecord(1, 2, 3, 1)) for name in names])
    print(number, flush=True)
"""


def start_server(start, state, port):
    server = start(*SKYRELAY, "chain", "serve", "--listen", f"127.0.0.1:{port}", "--state", state, "--json")
    return server, json.loads(server.stdout.readline())


def registered(client):
    return [event.args["vehicle"] for event in client.events() if event.name == "VehicleRegistered"]


def test_two_processes_at_once(start, tmp_path):
    server, known = start_server(start, tmp_path, free_port())
    chain = connect(known["url"])
    client = IovClient.deploy(chain, Settings(), chain.account("admin"))
    members = [start("-c", CLIENT, known["url"], client.address, secret * 32, 10) for secret in ("01", "02")]
    assert [member.wait(120) for member in members] == [0, 0]
    assert len(set(registered(client))) == len(registered(client)) == 60
    server.terminate()
    assert server.wait(30) == 0


def test_killed_again_and_again_nothing_is_lost_or_doubled(start, tmp_path):
    port = free_port()
    server, known = start_server(start, tmp_path, port)
    chain = connect(known["url"])
    client = IovClient.deploy(chain, Settings(), chain.account("admin"))
    members = [start("-c", CLIENT, known["url"], client.address, secret * 32, 12) for secret in ("01", "02")]
    for _ in range(4):
        for member in members:
            member.stdout.readline()  # some of its transactions are mined, the next are under way
        server.kill()
        server.wait()
        server, again = start_server(start, tmp_path, port)
        assert again["block"] >= 1
    assert [member.wait(120) for member in members] == [0, 0]
    assert len(set(registered(client))) == len(registered(client)) == 72


def test_what_was_taken_is_mined_after_a_kill_between_journal_and_block(tmp_path):
    with ChainServer(SignedChain(tmp_path), "127.0.0.1:0") as server:
        chain = connect(server.url)
        client = IovClient.deploy(chain, Settings(), chain.account("admin"))
        server._chain.close()
    vehicle = chain.account("vehicle")
    call = client.register_vehicle(vehicle, VehicleRecord(1, 2, 3, 1))
    digest, raw = RING.sign(vehicle, call.to, call.data, call.gas, 0, chain.chain_id)
    with (tmp_path / rpc.FILE_NAME).open("ab") as journal:
        journal.write(raw.hex().encode() + b"\n" + raw.hex().encode()[:70])  # and one that was cut off
    again = SignedChain(tmp_path)
    (receipt,) = again.answer_all([("eth_getTransactionReceipt", [digest])])
    assert (receipt["status"], receipt["from"]) == ("0x1", vehicle)
    again.close()
    assert SignedChain(tmp_path).answer_all([("eth_getTransactionReceipt", [digest])]) == [receipt]


def test_a_journal_that_was_changed_is_refused(tmp_path):
    SignedChain(tmp_path).close()
    (tmp_path / rpc.FILE_NAME).write_text("c0ffee\n")
    with pytest.raises(ChainError, match=r"signed\.txt:1: expected a signed transaction"):
        SignedChain(tmp_path)


def test_one_folder_has_one_server(tmp_path):
    first = SignedChain(tmp_path)
    with pytest.raises(ChainError, match="a chain that no other process has open"):
        SignedChain(tmp_path)
    first.close()


def test_a_refusal_comes_with_its_reason(served):
    chain = connect(served.url)
    client = IovClient.deploy(chain, Settings(), chain.account("admin"))
    vehicle = chain.account("vehicle")
    client.execute([client.register_vehicle(vehicle, VehicleRecord(1, 2, 3, 1))])
    with pytest.raises(ContractError, match="AlreadyRegistered"):
        client.execute([client.register_vehicle(vehicle, VehicleRecord(1, 2, 3, 1))])


def sign(name="a", **fields):
    account = Account.from_key(bytes([len(name)]) * 31 + name.encode()[:1])
    common = {"nonce": 0, "gas": 100_000, "value": 0, "data": b"", "chainId": 31337, "to": "0x" + "11" * 20}
    prices = {"gasPrice": 0} if "type" not in fields and "maxFeePerGas" not in fields else {}
    return "0x" + bytes(account.sign_transaction(common | prices | fields).raw_transaction).hex()


def test_transactions_of_every_kind_that_wallets_sign(served):
    raws = [
        sign("a"),
        sign("b", maxFeePerGas=0, maxPriorityFeePerGas=0),
        sign("c", type=1, gasPrice=0, accessList=[]),
    ]
    for kind, raw in zip((0, 2, 1), raws, strict=True):
        digest = ask(served, "eth_sendRawTransaction", raw)
        receipt = ask(served, "eth_getTransactionReceipt", digest)
        assert (int(receipt["type"], 16), receipt["status"]) == (kind, "0x1")
        assert receipt["from"] == Account.recover_transaction(raw).lower()
        assert ask(served, "eth_getTransactionByHash", digest)["hash"] == digest
        block = ask(served, "eth_getBlockByNumber", receipt["blockNumber"], True)
        assert [t["hash"] for t in block["transactions"]] == [digest]
        assert ask(served, "eth_getBlockByHash", receipt["blockHash"], True) == block


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (sign(value=1), "insufficient funds"),
        (sign(gasPrice=1), "insufficient funds"),
        (sign(chainId=1), "invalid chain id"),
        (sign(gas=20_999), "intrinsic gas too low"),
        (sign(gas=30_000_001), "exceeds block gas limit"),
        (sign(type=1, gasPrice=0, accessList=[{"address": "0x" + "11" * 20, "storageKeys": []}]), "an access list"),
        ("0x", "1 to 131072"),
        ("0x05" + "00" * 40, "a legacy transaction or one of type 1 or 2"),
        ("0xc0", "9 fields"),
        ("0x" + "c1" * 50, "RLP"),
        ("nonsense", "hexadecimal data"),
        ("0x c0", "hexadecimal data"),
        (17, "hexadecimal data"),
    ],
)
def test_transactions_that_are_not_taken(served, raw, reason):
    with pytest.raises(RpcError, match=reason):
        ask(served, "eth_sendRawTransaction", raw)
    assert ask(served, "eth_blockNumber") == "0x0"


def test_a_signature_has_one_form(served):
    raw = bytes.fromhex(sign()[2:])
    fields = rlp.decode(raw)
    order = 0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFEBAAEDCE6AF48A03BBFD25E8CD0364141
    v, s = int.from_bytes(fields[6], "big"), order - int.from_bytes(fields[8], "big")
    flipped = [*fields[:6], (v + 1 if v % 2 else v - 1).to_bytes(2, "big"), fields[7], s.to_bytes(32, "big")]
    with pytest.raises(ChainError, match="the smaller s"):
        read_signed(rlp.encode(flipped))


def test_nonces_wait_for_each_other_and_are_used_once(served):
    late, early = sign(nonce=1), sign(nonce=0)
    digest = ask(served, "eth_sendRawTransaction", late)
    sender = Account.recover_transaction(late)
    assert ask(served, "eth_getTransactionReceipt", digest) is None
    assert ask(served, "eth_getTransactionCount", sender, "pending") == "0x0"
    with pytest.raises(RpcError, match="already known"):
        ask(served, "eth_sendRawTransaction", late)
    with pytest.raises(RpcError, match="replacement"):
        ask(served, "eth_sendRawTransaction", sign(nonce=1, data=b"x"))
    ask(served, "eth_sendRawTransaction", early)
    assert ask(served, "eth_getTransactionReceipt", digest)["status"] == "0x1"
    assert ask(served, "eth_getTransactionCount", sender, "pending") == "0x2"
    with pytest.raises(RpcError, match="nonce too low"):
        ask(served, "eth_sendRawTransaction", sign(nonce=0, data=b"x"))


def test_a_full_pool_turns_away_and_takes_again(served, monkeypatch):
    monkeypatch.setattr(rpc, "POOL", 3)
    for nonce in (1, 2, 3):
        ask(served, "eth_sendRawTransaction", sign(nonce=nonce))
    with pytest.raises(RpcError, match="txpool is full"):
        ask(served, "eth_sendRawTransaction", sign(nonce=4))


def test_an_estimate_is_enough_and_not_much_more(served):
    chain = connect(served.url)
    client = IovClient.deploy(chain, Settings(), chain.account("admin"))
    vehicle = chain.account("vehicle")
    call = client.register_vehicle(vehicle, VehicleRecord(1, 2, 3, 1))
    message = {"from": vehicle, "to": call.to, "data": "0x" + call.data.hex()}
    estimate = int(ask(served, "eth_estimateGas", message), 16)
    digest, raw = RING.sign(vehicle, call.to, call.data, estimate, 0, 31337)
    ask(served, "eth_sendRawTransaction", "0x" + raw.hex())
    receipt = ask(served, "eth_getTransactionReceipt", digest)
    assert receipt["status"] == "0x1"
    assert int(receipt["gasUsed"], 16) <= estimate <= 1.1 * int(receipt["gasUsed"], 16)
    with pytest.raises(RpcError, match="execution reverted") as caught:
        ask(served, "eth_estimateGas", message)
    assert caught.value.tree["data"].startswith("0x")


def test_logs_by_block_address_and_topic(served):
    chain = connect(served.url)
    client = IovClient.deploy(chain, Settings(), chain.account("admin"))
    names = [chain.account(f"vehicle {number}") for number in range(3)]
    client.execute([client.register_vehicle(name, VehicleRecord(1, 2, 3, 1)) for name in names])
    everything = ask(served, "eth_getLogs", {"fromBlock": "earliest"})
    last = ask(served, "eth_getBlockByNumber", "latest", False)
    here = [log for log in everything if log["blockHash"] == last["hash"]]
    assert len(here) == 3
    assert ask(served, "eth_getLogs", {"blockHash": last["hash"]}) == here
    topic = here[0]["topics"]
    assert ask(served, "eth_getLogs", {"fromBlock": "0x0", "topics": [topic[0], [topic[1]]]}) == here[:1]
    assert ask(served, "eth_getLogs", {"fromBlock": "0x0", "topics": [None, topic[1]]}) == here[:1]
    assert ask(served, "eth_getLogs", {"fromBlock": "0x0", "address": ["0x" + "22" * 20]}) == []
    bloom = int(last["logsBloom"], 16)
    assert 0 < bloom.bit_count() <= 3 * sum(1 + len(log["topics"]) for log in here)


def test_past_states_are_not_answered_wrongly(served):
    ask(served, "eth_sendRawTransaction", sign())
    assert ask(served, "eth_getCode", "0x" + "11" * 20, "0x1") == "0x"
    with pytest.raises(RpcError, match="the state of block 0x0 is not kept"):
        ask(served, "eth_getCode", "0x" + "11" * 20, "0x0")


def test_a_contract_that_calls_itself_to_the_end_harms_nobody(served):
    calls_itself = "60006000600060006000305af100"
    digest = ask(served, "eth_sendRawTransaction", sign(to="", data="0x6d" + calls_itself + "600052600e6012f3"))
    address = ask(served, "eth_getTransactionReceipt", digest)["contractAddress"]
    assert ask(served, "eth_getCode", address) == "0x" + calls_itself
    assert ask(served, "eth_call", {"to": address}) == "0x"
    assert ask(served, "eth_sendRawTransaction", sign(nonce=1, to=bytes.fromhex(address[2:]), gas=30_000_000))
    assert ask(served, "eth_blockNumber") == "0x2"


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.text(max_size=70)
    | st.sampled_from(["0x", "0x1", "latest", "pending"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["from", "to", "data", "gas", "address", "topics", "fromBlock", "toBlock", "blockHash"]),
            inner,
            max_size=4,
        )
    ),
    max_leaves=6,
)


@settings(deadline=None, max_examples=400)
@given(st.sampled_from(sorted(rpc._METHODS)), st.lists(values, max_size=3))
def test_whatever_is_asked_is_answered_or_refused(method, params):
    chain = SignedChain(None)
    (answer,) = chain.answer_all([(method, params)])
    json.dumps(answer.tree if isinstance(answer, RpcError) else answer)


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b"", rpc.PARSE),
        (b"[" * 100_000, rpc.PARSE),
        (b"[" * 17 + b"]" * 17, rpc.PARSE),
        (b'["\\"' + b"[" * 100_000, rpc.PARSE),
        (b'"' + b"\\" * 1_000_000, rpc.PARSE),
        (b"\xff", rpc.PARSE),
        (b"[]", rpc.INVALID),
        (b"17", rpc.INVALID),
        (b'{"id": 1, "method": 5}', rpc.INVALID),
        (b'{"id": 1, "method": "eth_chainId", "params": {"a": 1}}', rpc.INVALID),
        (b'{"id": 1, "method": "eth_sign", "params": []}', rpc.UNKNOWN),
        (b'{"id": 1, "method": "eth_chainId", "params": [1]}', rpc.PARAMS),
        (b'{"id": 1, "method": "eth_getBlockByNumber", "params": ["0x-1", false]}', rpc.PARAMS),
        (b'{"id": 1, "method": "eth_getBlockByNumber", "params": ["0x1_0", false]}', rpc.PARAMS),
        (json.dumps([{"id": 1, "method": "eth_chainId"}] * (LARGEST_BATCH + 1)).encode(), rpc.INVALID),
    ],
)
def test_bodies_that_are_no_request(served, body, code):
    answer = requests.post(served.url, data=body, headers={"content-type": "application/json"}, timeout=30).json()
    assert answer["error"]["code"] == code
    assert ask(served, "eth_chainId") == "0x7a69"


def test_too_much_is_refused_before_it_is_read(served):
    host, port = served.url.removeprefix("http://").split(":")
    link = http.client.HTTPConnection(host, int(port), timeout=30)
    link.putrequest("POST", "/")
    link.putheader("content-type", "application/json")
    link.putheader("content-length", str(LARGEST_BODY + 1))
    link.endheaders()
    assert link.getresponse().status == 413


def test_a_page_in_a_browser_cannot_send_by_itself(served):
    simple = {"content-type": "text/plain"}
    assert requests.post(served.url, data=b"{}", headers=simple, timeout=30).status_code == 415


def test_connections_beyond_the_bound_are_closed_and_the_server_serves_on(served, monkeypatch):
    host, port = served.url.removeprefix("http://").split(":")
    served._http._free = type(served._http._free)(2)
    idle = [socket.create_connection((host, int(port))) for _ in range(3)]
    assert idle[2].recv(1) == b""
    for link in idle:
        link.close()
    until(lambda: served._http._free._value == 2)
    assert ask(served, "eth_chainId") == "0x7a69"


def test_elsewhere_than_on_loopback_only_with_a_token(tmp_path):
    chain = SignedChain(None)
    with pytest.raises(UsageError, match=r"--listen: is '0\.0\.0\.0:0'; expected a loopback address, or a token"):
        ChainServer(chain, "0.0.0.0:0")
    with ChainServer(chain, "0.0.0.0:0", token="a secret") as server:  # noqa: S106
        port = server.url.rpartition(":")[2]
        with pytest.raises(ChainError):
            NodeChain(f"http://127.0.0.1:{port}", RING)
        assert NodeChain(f"http://skyrelay:a%20secret@127.0.0.1:{port}", RING).chain_id == 31337
        body: Any = {"jsonrpc": "2.0", "id": 1, "method": "eth_chainId", "params": []}
        for header, status in (("Bearer a secret", 200), ("Bearer another", 401), ("Basic ???", 401)):
            answer = requests.post(f"http://127.0.0.1:{port}", json=body, headers={"authorization": header}, timeout=30)
            assert answer.status_code == status


def test_an_address_that_is_none_or_taken_is_one_line(start, served, tmp_path):
    for listen, expected in (("nowhere", "HOST:PORT"), (served.url.removeprefix("http://"), "an address that is free")):
        refused = start(*SKYRELAY, "chain", "serve", "--listen", listen, "--state", tmp_path / "other", stderr=-1)
        _, error = refused.communicate(timeout=60)
        assert refused.returncode == 2
        assert error.startswith("skyrelay: --listen")
        assert expected in error
        assert error.count("\n") == 1
