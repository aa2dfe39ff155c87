"""Official state tests (ethereum/tests, GeneralStateTests) on the embedded chain's machine.

    python tests/chain/state_tests.py evm-state-tests.tar.gz [PART OF A NAME]

A case gives the accounts before, a transaction, and the state's root and the hash of the logs after it, by London's
rules. The machine knows no fees; here the sender buys its gas and the coinbase earns what is above the base fee.
"""

from __future__ import annotations

import json
import sys
import tarfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rlp
from eth_hash.auto import keccak

from skyrelay.chain.evm.calls import execute
from skyrelay.chain.evm.gas import intrinsic_gas
from skyrelay.chain.evm.state import NO_CODE, BlockContext, Log, Transaction, WorldState
from skyrelay.chain.proof.trie import root


@dataclass(frozen=True)
class Case:
    """One result of one test."""

    name: str
    test: Mapping[str, Any]
    post: Mapping[str, Any]

    def failure(self) -> str | None:
        """Why the machine does not give what it should; None where it does."""
        should_fail = "expectException" in self.post
        result = play(self.test, self.post["indexes"])
        if result is None or should_fail:
            if (result is None) == should_fail:
                return None
            return f"{self.name}: {'was taken' if should_fail else 'was refused'}"
        state_root, logs = result
        wrong = [
            what
            for what, found, expected in (("state", state_root, "hash"), ("logs", logs, "logs"))
            if "0x" + found.hex() != self.post[expected]
        ]
        return f"{self.name}: {' and '.join(wrong)} not as they should be" if wrong else None


def cases(archive: Path) -> Iterator[Case]:
    """All cases of an archive, in its order."""
    with tarfile.open(archive) as files:
        for member in files:
            source = files.extractfile(member) if member.name.endswith(".json") else None
            if source is None:
                continue
            folder = Path(member.name).parent.name
            for name, test in json.load(source).items():
                for number, post in enumerate(test["post"]["London"]):
                    yield Case(f"{folder}/{name}[{number}]", test, post)


class _Watched(Transaction):
    """A transaction that remembers which accounts it touched (EIP-161 sweeps the empty ones among them).

    That RIPEMD-160's contract was touched is not undone with its frame: so it happened once, and so clients keep it.
    """

    touched: dict[int, Any]
    kept: set[int]

    def transfer(self, sender: int, recipient: int, value: int) -> None:
        self.put(self.touched, recipient, True)
        if recipient == 3:
            self.kept.add(recipient)
        super().transfer(sender, recipient, value)


def play(test: Mapping[str, Any], indexes: Mapping[str, int]) -> tuple[bytes, bytes] | None:
    """The state's root and the logs' hash after a transaction; None where no block can hold it."""
    env, told = test["env"], test["transaction"]
    data = _bytes(told["data"][indexes["data"]])
    gas = _number(told["gasLimit"][indexes["gas"]])
    value = _number(told["value"][indexes["value"]])
    base_fee = _number(env.get("currentBaseFee", "0x0"))
    prices = _prices(told, base_fee)
    if prices is None:
        return None
    price, highest = prices
    sender, coinbase = _number(told["sender"]), _number(env["currentCoinbase"])
    to = _number(told["to"]) if told["to"] else None
    state = _state(test["pre"])
    access = (told.get("accessLists") or {indexes["data"]: None})[indexes["data"]] or []
    transaction = _Watched(
        state,
        BlockContext(
            number=_number(env["currentNumber"]),
            timestamp=_number(env["currentTimestamp"]),
            gas_limit=_number(env["currentGasLimit"]),
            chain_id=1,
            block_hash=lambda number: int.from_bytes(keccak(str(number).encode()), "big"),
            coinbase=coinbase,
            difficulty=_number(env["currentDifficulty"]),
            base_fee=base_fee,
        ),
        sender,
        price=price,
        access=[(_number(entry["address"]), [_number(key) for key in entry["storageKeys"]]) for entry in access],
    )
    transaction.touched = {sender: True, coinbase: True}
    transaction.kept = set()
    nonce, balance = state.nonces.get(sender, 0), state.balances.get(sender, 0)
    if (
        gas < intrinsic_gas(data, to is None) + transaction.access_gas
        or balance < gas * highest + value
        or gas > transaction.block.gas_limit
        or nonce != _number(told["nonce"])
        or nonce >= 2**64 - 1
        or state.codes.get(sender, NO_CODE).code
    ):
        return None
    state.balances[sender] = balance - gas * price
    outcome = execute(transaction, to, data, gas, value)
    state.balances[sender] = state.balances.get(sender, 0) + (gas - outcome.gas_used) * price
    state.balances[coinbase] = state.balances.get(coinbase, 0) + outcome.gas_used * (price - base_fee)
    left_alone = {_number(address) for address in test["pre"]} - set(transaction.touched) - transaction.kept
    return _state_root(state, left_alone), _logs_hash(outcome.logs)


def _prices(told: Mapping[str, Any], base_fee: int) -> tuple[int, int] | None:
    """What a unit of gas costs, and the most that the sender must be able to pay; None where it offers too little."""
    if "maxFeePerGas" not in told:
        price = _number(told["gasPrice"])
        return (price, price) if price >= base_fee else None
    highest, tip = _number(told["maxFeePerGas"]), _number(told["maxPriorityFeePerGas"])
    return (min(highest, base_fee + tip), highest) if base_fee <= highest >= tip else None


def _state(accounts: Mapping[str, Any]) -> WorldState:
    state = WorldState()
    for address, account in accounts.items():
        key = _number(address)
        state.balances[key], state.nonces[key] = _number(account["balance"]), _number(account["nonce"])
        if code := _bytes(account["code"]):
            state.set_code(key, code)
        state.storage[key] = {_number(slot): _number(value) for slot, value in account["storage"].items()}
    return state


def _state_root(state: WorldState, kept_though_empty: set[int]) -> bytes:
    entries = {}
    for address in {*state.balances, *state.nonces, *state.codes, *state.storage}:
        if state.is_empty(address) and address not in kept_though_empty:
            continue
        slots = {_key(slot, 32): rlp.encode(value) for slot, value in state.storage.get(address, {}).items() if value}
        code = state.codes.get(address, NO_CODE).code
        account = [state.nonces.get(address, 0), state.balances.get(address, 0), root(slots), bytes(keccak(code))]
        entries[_key(address, 20)] = rlp.encode(account)
    return bytes(root(entries))


def _logs_hash(logs: tuple[Log, ...]) -> bytes:
    told = [[_word(log.address, 20), [_word(topic, 32) for topic in log.topics], log.data] for log in logs]
    return bytes(keccak(rlp.encode(told)))


def _key(number: int, size: int) -> bytes:
    return bytes(keccak(_word(number, size)))


def _word(number: int, size: int) -> bytes:
    return number.to_bytes(size, "big")


def _number(text: str) -> int:
    return int(text, 16) if text not in ("", "0x") else 0


def _bytes(text: str) -> bytes:
    return bytes.fromhex(text[2:])


if __name__ == "__main__":
    wanted = sys.argv[2] if len(sys.argv) > 2 else ""
    failures = [case.failure() for case in cases(Path(sys.argv[1])) if wanted in case.name]
    print("\n".join(failure for failure in failures if failure))
    print(f"{len(failures)} cases, {sum(map(bool, failures))} failures")
