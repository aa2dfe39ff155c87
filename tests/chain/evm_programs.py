"""Random EVM programs, and what anvil made of some of them.

    python tests/chain/evm_programs.py

plays programs on anvil (`npm ci` in contracts/) and writes `evm/anvil.json.gz`: each transaction with anvil's receipt,
then the storage that it left. `evm/test_state_tests.py` plays it where there is no anvil.
"""

from __future__ import annotations

import gzip
import json
import random
from pathlib import Path
from typing import Any

from skyrelay.chain import evm
from skyrelay.chain.embedded.chain import EmbeddedChain

RECORD = Path(__file__).parent / "evm" / "anvil.json.gz"
PROGRAMS = 120


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


def record(anvil: Any) -> dict[str, Any]:
    """What anvil makes of the programs."""
    sender = EmbeddedChain().account("fuzz")
    blocks: list[dict[str, Any]] = []

    def play(calls: list[dict[str, str]]) -> list[dict[str, Any]]:
        timestamp = 10 + len(blocks)
        requests = [("eth_sendTransaction", [{"from": sender, "gasPrice": "0x0", **call}]) for call in calls]
        sent = anvil.batch([*requests, ("evm_setNextBlockTimestamp", [hex(timestamp)]), ("evm_mine", [])])
        answers = anvil.batch([("eth_getTransactionReceipt", [answer["result"]]) for answer in sent[: len(calls)]])
        receipts = [answer["result"] for answer in answers]
        wanted = ("status", "gasUsed", "contractAddress")
        told = [
            {name: receipt[name] for name in wanted}
            | {"logs": [{name: entry[name] for name in ("address", "topics", "data")} for entry in receipt["logs"]]}
            for receipt in receipts
        ]
        blocks.append({"timestamp": timestamp, "calls": calls, "receipts": told})
        return receipts

    friends: list[str] = []
    for seed in range(1000, 1000 + PROGRAMS):
        draw = random.Random(seed)  # noqa: S311
        program = Program(seed, friends or ["0x97"]).build(draw.randint(3, 40))
        (receipt,) = play([{"data": "0x" + installer(program).hex(), "gas": hex(9_000_000)}])
        if receipt["status"] == "0x1":
            created = receipt["contractAddress"]
            friends = [created, *friends][:4]
            data = "0x" + draw.randbytes(seed % 90).hex()
            play([{"to": created, "data": data, "gas": hex(gas)} for gas in (9_000_000, 200_000, 60_000)])
    contracts = [r["contractAddress"] for b in blocks for r in b["receipts"] if r["contractAddress"]]
    places = [(address, slot) for address in contracts for slot in range(5)]
    answers = anvil.batch([("eth_getStorageAt", [address, hex(slot), "latest"]) for address, slot in places])
    storage = [[*place, answer["result"]] for place, answer in zip(places, answers, strict=True)]
    return {"sender": sender, "blocks": blocks, "storage": storage}


def main() -> None:
    from conftest import Anvil, free_port, start_anvil, wait_for

    port = free_port()
    process = start_anvil(port, "--no-mining", "--timestamp", "1")
    try:
        anvil = Anvil(f"http://127.0.0.1:{port}")
        wait_for(anvil)
        anvil("anvil_autoImpersonateAccount", True)
        RECORD.write_bytes(gzip.compress(json.dumps(record(anvil)).encode(), mtime=0))
    finally:
        process.terminate()
        process.wait()


if __name__ == "__main__":
    main()
