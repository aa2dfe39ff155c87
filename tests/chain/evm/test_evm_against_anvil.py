"""The embedded chain and anvil (revm), given the same transactions, agree to the last gas and the last byte."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

import pytest
from chain_rounds import World
from evm_programs import Program, installer

from skyrelay.chain.chain import Answer, Call, Receipt
from skyrelay.chain.client import IovClient
from skyrelay.chain.embedded.chain import EmbeddedChain

pytestmark = [pytest.mark.contracts, pytest.mark.xdist_group("anvil")]


def both(chain: EmbeddedChain, anvil: Any, calls: list[Call], timestamp: int) -> list[tuple[Receipt, dict[str, Any]]]:
    """The calls in one block on both."""
    receipts = chain.send(calls, timestamp)
    assert len({receipt.block for receipt in receipts}) == 1
    requests: list[tuple[str, list[Any]]] = []
    for call in calls:
        transaction = {"from": call.sender, "data": "0x" + call.data.hex(), "gas": hex(call.gas), "gasPrice": "0x0"}
        requests.append(("eth_sendTransaction", [transaction | ({"to": call.to} if call.to else {})]))
    sent = anvil.batch([*requests, ("evm_setNextBlockTimestamp", [hex(timestamp)]), ("evm_mine", [])])
    answers = anvil.batch([("eth_getTransactionReceipt", [answer["result"]]) for answer in sent[: len(calls)]])
    return list(zip(receipts, [answer["result"] for answer in answers], strict=True))


def assert_equal(receipt: Receipt, other: dict[str, Any], context: str = "") -> None:
    seen = (
        receipt.status,
        receipt.gas_used,
        receipt.created,
        [(entry.address, ["0x" + t.hex() for t in entry.topics], "0x" + entry.data.hex()) for entry in receipt.logs],
        receipt.block,
        receipt.transaction,
    )
    expected = (
        other["status"] == "0x1",
        int(other["gasUsed"], 16),
        other["contractAddress"] if other["status"] == "0x1" else None,
        [(entry["address"], entry["topics"], entry["data"]) for entry in other["logs"]],
        int(other["blockNumber"], 16),
        int(other["transactionIndex"], 16),
    )
    assert seen == expected, context


def test_random_programs_cost_and_log_the_same(anvil: Any) -> None:
    chain = EmbeddedChain(timestamp=1)
    sender = chain.account("fuzz")
    friends: list[str] = []
    for seed in range(200):
        draw = random.Random(seed)  # noqa: S311
        program = Program(seed, friends or ["0x97"]).build(draw.randint(3, 40))
        pairs = both(chain, anvil, [Call(sender, None, installer(program), 9_000_000)], 10 + 2 * seed)
        assert_equal(*pairs[0], f"seed {seed}, creation of {program.hex()}")
        created = pairs[0][0].created
        if created is None:
            continue
        friends = [created, *friends][:4]
        data = draw.randbytes(seed % 90)
        limits = [9_000_000, 200_000, 60_000]
        calls = [Call(sender, created, data, gas) for gas in limits]
        for pair in both(chain, anvil, calls, 11 + 2 * seed):
            assert_equal(*pair, f"seed {seed}, a call of {program.hex()} with {data.hex()}")
        slots = anvil.batch([("eth_getStorageAt", [created, hex(slot), "latest"]) for slot in range(5)])
        storage = chain._state.storage.get(int(created, 16), {})
        assert [int(slot["result"], 16) for slot in slots] == [storage.get(i, 0) for i in range(5)], f"seed {seed}"


class Mirrored:
    """The embedded chain, every transaction and every question of which anvil gets too."""

    def __init__(self, anvil: Any) -> None:
        self.chain = EmbeddedChain(timestamp=1)
        self.anvil = anvil
        self.time = 1
        self.compared = 0
        self.account = self.chain.account
        self.logs = self.chain.logs
        self.transaction = self.chain.transaction
        self.chain_id = self.chain.chain_id
        self.block_gas_limit = self.chain.block_gas_limit

    @property
    def block_number(self) -> int:
        return self.chain.block_number

    def send(self, calls: Sequence[Call], timestamp: int | None = None) -> list[Receipt]:
        self.time += 1
        if not calls:
            return []
        pairs = both(self.chain, self.anvil, list(calls), self.time)
        for call, pair in zip(calls, pairs, strict=True):
            assert_equal(*pair, call.name)
        self.compared += len(pairs)
        return [receipt for receipt, _ in pairs]

    def query(self, calls: Sequence[Call]) -> list[Answer]:
        answers = self.chain.query(calls)
        messages = [{"from": call.sender, "to": call.to, "data": "0x" + call.data.hex()} for call in calls]
        for call, answer, other in zip(
            calls, answers, self.anvil.batch([("eth_call", [message, "latest"]) for message in messages]), strict=True
        ):
            if answer.status:
                assert other["result"] == "0x" + answer.output.hex(), call.name
            else:
                assert other["error"]["data"] == "0x" + answer.output.hex(), call.name
        return answers

    def code(self, address: str) -> bytes:
        code = self.chain.code(address)
        assert self.anvil("eth_getCode", address, "latest") == "0x" + code.hex()
        return code


def test_the_contract_in_all_its_uses_costs_and_does_the_same(anvil: Any) -> None:
    chain: Any = Mirrored(anvil)
    world = World(chain)
    world.found()
    world.play()
    assert IovClient.connect(chain, world.client.address).settings == world.client.settings
    client = world.client
    member = world.uavs[0]
    refused = [
        client.register_uav(member, world.uav_record(1)),
        client.allocate_zone(member, 1, 10),
        client.submit_veh_selection(world.vehicles[0], world.vehicles[1], 2000, 1),
        client.retire_model(world.admin, "0x" + "00" * 32),
    ]
    receipts = chain.send(refused)
    assert [client.refusal(call, r).error for call, r in zip(refused, receipts, strict=True)] == [
        "AlreadyRegistered",
        "AccessControlUnauthorizedAccount",
        "UnknownUAV",
        "UnknownModel",
    ]
    chain.query(refused)
    for address, slots in ((a, s) for a, s in chain.chain._state.storage.items() if s):
        places = sorted(slots)
        found = anvil.batch([("eth_getStorageAt", [f"0x{address:040x}", hex(slot), "latest"]) for slot in places])
        assert [int(slot["result"], 16) for slot in found] == [slots[slot] for slot in places]
    assert chain.compared > 300
