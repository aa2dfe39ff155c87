"""The embedded chain and anvil (revm), given the same transactions, agree to the last gas and the last byte."""

from __future__ import annotations

import random
from typing import Any

import pytest
from chain_rounds import World

from skyrelay.chain.chain import Answer, Call, Receipt
from skyrelay.chain.client import IovClient
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.evm import machine as evm

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


class Program:
    """Random bytecode that mostly does something."""

    def __init__(self, seed: int, friends: list[str]) -> None:
        self.random = random.Random(seed)  # noqa: S311
        self.code = bytearray()
        self.friends = friends
        self.height = 0

    def push(self, value: int) -> None:
        size = max(1, (value.bit_length() + 7) // 8)
        self.code += bytes([0x5F + size]) + value.to_bytes(size, "big")
        self.height += 1

    def operand(self) -> None:
        r = self.random
        kind = r.randrange(7)
        if kind == 0 and self.height:
            depth = r.randint(1, min(16, self.height))
            self.code.append(0x7F + depth)
            self.height += 1
        elif kind <= 2:
            self.push(r.randrange(0, 70))
        elif kind == 3:
            self.push(
                r.choice([0, 1, 31, 32, 33, 255, 256, evm.WORD, 1 << 255, (1 << 255) - 1, evm.WORD - 1, 1 << 128])
            )
        elif kind == 4:
            self.push(r.getrandbits(256))
        elif kind == 5:
            self.push(r.getrandbits(r.randint(1, 256)))
        else:
            self.push(evm.WORD - r.randrange(0, 300))

    def small(self, most: int = 200) -> None:
        self.push(self.random.randrange(0, most))

    def op(self, code: int, takes: int, gives: int) -> None:
        self.code.append(code)
        self.height += gives - takes

    def step(self) -> None:
        r = self.random
        kind = r.randrange(23)
        if kind <= 4:
            opcode = r.choice(
                [1, 2, 3, 4, 5, 6, 7, 0x0A, 0x0B, 0x10, 0x11, 0x12, 0x13, 0x14, 0x16, 0x17, 0x18, *range(0x1A, 0x1E)]
            )
            self.operand()
            self.operand()
            self.op(opcode, 2, 1)
        elif kind == 5:
            for _ in range(3):
                self.operand()
            self.op(r.choice([8, 9]), 3, 1)
        elif kind == 6:
            self.operand()
            self.op(r.choice([0x15, 0x19, 0x35]), 1, 1)
        elif kind == 7:
            self.op(
                r.choice(
                    [
                        0x30,
                        0x32,
                        0x33,
                        0x34,
                        0x36,
                        0x38,
                        0x3A,
                        0x3D,
                        0x41,
                        0x42,
                        0x43,
                        0x45,
                        0x46,
                        0x47,
                        0x48,
                        0x58,
                        0x59,
                        0x5A,
                    ]
                ),
                0,
                1,
            )
        elif kind == 8:
            self.operand()
            self.small()
            self.op(r.choice([0x52, 0x53]), 2, 0)
        elif kind == 9:
            self.small()
            self.op(0x51, 1, 1)
        elif kind <= 12:
            if r.random() < 0.6:
                self.push(r.choice([0, 0, 1, 2, r.getrandbits(256)]))
            else:
                self.operand()
            self.push(r.randrange(0, 4))
            self.op(0x55, 2, 0)
        elif kind == 13:
            self.push(r.randrange(0, 5))
            self.op(0x54, 1, 1)
        elif kind == 14:
            self.small()
            self.small()
            self.op(0x20, 2, 1)
        elif kind == 15:
            self.small(100)
            self.small(100)
            self.small(100)
            self.op(r.choice([0x37, 0x39]), 3, 0)
        elif kind == 16:
            topics = r.randrange(0, 5)
            for _ in range(topics):
                self.operand()
            self.small()
            self.small()
            self.op(0xA0 + topics, topics + 2, 0)
        elif kind == 17:  # a jump forward, over some of what follows
            self.operand()
            inner = bytes([0x60, 7, 0x60, 9, 0x01, 0x50])
            target = len(self.code) + 4 + len(inner)
            self.code += bytes([0x61]) + target.to_bytes(2, "big") + b"\x57" + inner + b"\x5b"
            self.height -= 1
        elif kind == 18:  # a loop
            start = len(self.code) + 2
            self.code += bytes([0x60, r.randint(1, 9), 0x5B, 0x60, 1, 0x90, 0x03, 0x80])
            self.code += bytes([0x80, 0x54, 0x50]) if r.random() < 0.5 else b""
            self.code += bytes([0x61]) + start.to_bytes(2, "big") + b"\x57"
            self.height += 1
        elif kind <= 20:
            opcode = r.choice([0xF1, 0xF1, 0xF2, 0xF4, 0xFA])
            self.small(64)
            self.small(64)
            self.small(64)
            self.small(64)
            if opcode in (0xF1, 0xF2):
                self.push(r.choice([0, 0, 0, 1]))
            self.push(int(r.choice([*self.friends, "0x04", "0x02", "0x01", "0x03", "0x05", "0x99"]), 16))
            self.push(r.choice([0, 700, 5000, 50_000, 10_000_000]))
            self.op(opcode, 7 if opcode in (0xF1, 0xF2) else 6, 1)
            if r.random() < 0.5:
                self.code += bytes.fromhex("3d600060003e")  # all that came back, into memory
        elif kind == 21:
            for _ in range(3):
                self.small(60)
            self.push(int(r.choice(self.friends), 16))
            self.op(0x3C, 4, 0)
            self.push(int(r.choice([*self.friends, "0x98", "0x97"]), 16))
            self.op(r.choice([0x31, 0x3B, 0x3F]), 1, 1)
        else:
            salted = r.random() < 0.5
            if salted:
                self.small(5)
            self.small(70)
            self.small(40)
            self.push(0)
            self.op(0xF5 if salted else 0xF0, 4 if salted else 3, 1)

    def build(self, steps: int) -> bytes:
        for _ in range(steps):
            self.step()
            while self.height > 900:
                self.op(0x50, 1, 0)
        for place in range(min(self.height, 8)):
            self.code += bytes([0x60, 32 * place, 0x52])  # what is on the stack goes to memory
        r = self.random.random()
        if r < 0.6:
            self.code += bytes([0x61, 1, 0xA0, 0x60, 0, 0xA0, 0x60, 64, 0x60, 0, 0xF3])  # logged, then returned
        elif r < 0.8:
            self.code += bytes([0x60, 64, 0x60, 0, 0xFD])
        elif r < 0.88:
            self.code += bytes([0xFE])
        elif r < 0.94:
            self.push(int(self.random.choice(self.friends), 16))
            self.code.append(0xFF)
        return bytes(self.code)


def installer(code: bytes) -> bytes:
    """What creates a contract of this code."""
    return bytes([0x61]) + len(code).to_bytes(2, "big") + bytes([0x80, 0x60, 12, 0x60, 0, 0x39, 0x60, 0, 0xF3]) + code


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
        self.chain_id = self.chain.chain_id
        self.block_gas_limit = self.chain.block_gas_limit

    @property
    def block_number(self) -> int:
        return self.chain.block_number

    def send(self, calls: list[Call], timestamp: int | None = None) -> list[Receipt]:
        self.time += 1
        if not calls:
            return []
        pairs = both(self.chain, self.anvil, list(calls), self.time)
        for call, pair in zip(calls, pairs, strict=True):
            assert_equal(*pair, call.name)
        self.compared += len(pairs)
        return [receipt for receipt, _ in pairs]

    def query(self, calls: list[Call]) -> list[Answer]:
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
    chain = Mirrored(anvil)
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
