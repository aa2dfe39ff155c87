"""The machine gives what others gave: anvil (recorded here) and the official state tests (beside the checkout)."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest
from evm_programs import RECORD
from state_tests import cases

from skyrelay.chain.chain import Call
from skyrelay.chain.embedded.chain import EmbeddedChain

OFFICIAL = Path(__file__).parents[4] / "shared" / "data" / "evm-state-tests.tar.gz"
PARTS = 8


def test_recorded_programs_do_what_they_did_on_anvil() -> None:
    tape = json.loads(gzip.decompress(RECORD.read_bytes()))
    chain = EmbeddedChain(timestamp=1)
    played = 0
    for block in tape["blocks"]:
        calls = [
            Call(tape["sender"], call.get("to"), bytes.fromhex(call["data"][2:]), int(call["gas"], 16))
            for call in block["calls"]
        ]
        for number, (receipt, other) in enumerate(
            zip(chain.send(calls, block["timestamp"]), block["receipts"], strict=True)
        ):
            logs = [
                {"address": log.address, "topics": ["0x" + t.hex() for t in log.topics], "data": "0x" + log.data.hex()}
                for log in receipt.logs
            ]
            place = f"call {number} at {block['timestamp']}"
            assert receipt.status == (other["status"] == "0x1"), place
            assert receipt.gas_used == int(other["gasUsed"], 16), place
            assert receipt.created == (other["contractAddress"] if receipt.status else None), place
            assert logs == other["logs"], place
            played += 1
    for address, slot, value in tape["storage"]:
        assert chain._state.storage.get(int(address, 16), {}).get(slot, 0) == int(value, 16), (address, slot)
    assert played > 300


@pytest.mark.evm
@pytest.mark.parametrize("part", range(PARTS))
def test_official_state_tests(part: int) -> None:
    if not OFFICIAL.is_file():
        pytest.skip(f"the official state tests are not beside the checkout ({OFFICIAL.parent.parent.name}/data)")
    mine = [case for number, case in enumerate(cases(OFFICIAL)) if number % PARTS == part]
    assert len(mine) > 200
    failures = {case.name: failure for case in mine if (failure := case.failure())}
    assert not failures
