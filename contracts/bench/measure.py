"""Gas of three ways to order a UAV's proposals, on the embedded chain: `python contracts/bench/measure.py`."""

from __future__ import annotations

import json
import random
import subprocess
from bisect import bisect
from pathlib import Path

from eth_abi import encode
from eth_hash.auto import keccak

from skyrelay.chain.chain import Call
from skyrelay.chain.embedded.chain import EmbeddedChain

SIZES = (10, 50, 100, 200, 500, 1000)
CAPACITY = 20_000


def main() -> None:
    """Measure each way at each size and print JSON."""
    compiled = json.loads(
        subprocess.run(  # noqa: S603 (the arguments are ours)
            ["node", str(Path(__file__).with_name("compile.mjs"))],  # noqa: S607 (whichever node the user has)
            capture_output=True,
            check=True,
            text=True,
        ).stdout
    )
    results = []
    with EmbeddedChain(timestamp=1_000, gas_limit=400_000_000) as chain:
        sender = chain.account("bench")
        created = chain.send([Call(sender, None, bytes.fromhex(compiled["bytecode"]), 5_000_000)])[0].created

        def run(signature: str, types: list[str], *values: object) -> int:
            data = keccak(signature.encode())[:4] + encode(types, values)
            receipt = chain.send([Call(sender, created, data, chain.block_gas_limit // 4)])[0]
            if not receipt.status:
                raise SystemExit(f"{signature}: {receipt.output!r} {receipt.halt}")
            return receipt.gas_used

        def outcome() -> bytes:
            return chain.query([Call(sender, created, keccak(b"selected()")[:4])])[0].output

        uint64, uint32, word = "uint64", "uint32", "uint256"
        for warm in (True, False):  # the first pass only fills the storage, for figures of the steady state
            for size in SIZES[-1:] if warm else SIZES:
                draw = random.Random(size)  # noqa: S311 (a benchmark's data)
                proposals = [(draw.randrange(10**17, 2 * 10**18), draw.randrange(1_000, 4_000)) for _ in range(size)]
                run("reset()", [])
                submit = [run("submit(uint64,uint32)", [uint64, uint32], *p) for p in proposals]
                heap = run("allocateByHeap(uint256)", [word], CAPACITY)
                expected = outcome()
                insertion = run("allocateByInsertion(uint256)", [word], CAPACITY)
                if outcome() != expected:
                    raise SystemExit("insertion selects others")
                order = sorted(range(size), key=lambda i: (-proposals[i][0], i))
                packed = b"".join(i.to_bytes(2, "big") for i in order)
                given = run("allocateByGivenOrder(uint256,bytes)", [word, "bytes"], CAPACITY, packed)
                if outcome() != expected:
                    raise SystemExit("the given order selects others")
                run("reset()", [])
                placed: list[tuple[int, int]] = []
                ordered = []
                for place, (score, demand) in enumerate(proposals, start=1):
                    at = bisect(placed, (-score, place))
                    before = placed[at - 1][1] if at else 0
                    placed.insert(at, (-score, place))
                    ordered.append(
                        run("submitInOrder(uint64,uint32,uint16)", [uint64, uint32, "uint16"], score, demand, before)
                    )
                walk = run("allocateInOrder(uint256)", [word], CAPACITY)
                if outcome() != expected:
                    raise SystemExit("the ordered list selects others")
                if not warm:
                    results.append(
                        {
                            "proposals": size,
                            "heap": heap,
                            "insertion": insertion,
                            "given_order": given,
                            "ordered_list": walk,
                            "submit_each": sum(submit) // size,
                            "submit_in_order_each": sum(ordered) // size,
                        }
                    )
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
