"""The embedded chain: blocks, its record on disk, and what survives a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from skyrelay.chain.chain import Call
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.embedded.ledger import FILE_NAME
from skyrelay.chain.proof.replay import replay
from skyrelay.core.errors import ChainError

# Adds its call data's first word to slot 0 and logs the sum; reverts with the data if that word is 0.
COUNTER = bytes.fromhex("6000358015601957600054018060005560005260206000a0005b366000600037366000fd")
INSTALLER = bytes.fromhex("6024600c60003960246000f3")


def word(value: int) -> bytes:
    return value.to_bytes(32, "big")


def deployed(chain: EmbeddedChain) -> tuple[str, str]:
    sender = chain.account("someone")
    receipt = chain.send([Call(sender, None, INSTALLER + COUNTER)])[0]
    assert receipt.created is not None
    return sender, receipt.created


def count(chain: EmbeddedChain, counter: str) -> int:
    return chain._state.storage.get(int(counter, 16), {}).get(0, 0)


def test_many_calls_in_one_block() -> None:
    chain = EmbeddedChain()
    sender, counter = deployed(chain)
    receipts = chain.send([Call(sender, counter, word(n)) for n in (1, 0, 2)], timestamp=50)
    assert [(r.block, r.transaction, r.status) for r in receipts] == [(2, 0, True), (2, 1, False), (2, 2, True)]
    assert [int.from_bytes(entry.data, "big") for r in receipts for entry in r.logs] == [1, 3]
    assert [entry.index for r in receipts for entry in r.logs] == [0, 1]
    assert receipts[1].output == word(0)
    assert chain.timestamp == 50
    assert [entry.block for entry in chain.logs(counter, 0, 9)] == [2, 2]


def test_a_new_block_where_the_gas_limit_would_be_passed() -> None:
    chain = EmbeddedChain(gas_limit=1_000_000)
    sender, counter = deployed(chain)
    receipts = chain.send([Call(sender, counter, word(1), gas=980_000)] * 3)
    # Each uses some 27,000 or more, so that another 980,000 do not fit behind it.
    assert [r.block for r in receipts] == [2, 3, 4]


def test_the_same_calls_give_the_same_record(tmp_path: Path) -> None:
    for name in ("a", "b"):
        with EmbeddedChain(tmp_path / name, timestamp=5) as chain:
            sender, counter = deployed(chain)
            chain.send([Call(sender, counter, word(n)) for n in range(5)], timestamp=9)
    first, second = ((tmp_path / name / FILE_NAME).read_bytes() for name in ("a", "b"))
    assert first == second


def test_an_opened_chain_goes_on(tmp_path: Path) -> None:
    with EmbeddedChain(tmp_path) as chain:
        sender, counter = deployed(chain)
        chain.send([Call(sender, counter, word(7))], timestamp=20)
        head = chain.head
    with EmbeddedChain(tmp_path) as chain:
        assert (chain.head, chain.block_number, chain.timestamp, count(chain, counter)) == (head, 2, 20, 7)
        chain.send([Call(sender, counter, word(1))])
        assert count(chain, counter) == 8
    assert replay(tmp_path).differences == []


def test_an_unfinished_last_block_is_dropped_wherever_it_was_cut(tmp_path: Path) -> None:
    with EmbeddedChain(tmp_path) as chain:
        sender, counter = deployed(chain)
        whole = (tmp_path / FILE_NAME).stat().st_size
        chain.send([Call(sender, counter, word(7))])
        content = (tmp_path / FILE_NAME).read_bytes()
    for cut in range(whole + 1, len(content), 97):
        (tmp_path / FILE_NAME).write_bytes(content[:cut])
        with EmbeddedChain(tmp_path) as chain:
            assert chain.block_number == 1
            assert count(chain, counter) == 0
            chain.send([Call(sender, counter, word(2))])
        assert replay(tmp_path).differences == []


def test_a_damaged_block_is_refused(tmp_path: Path) -> None:
    with EmbeddedChain(tmp_path) as chain:
        sender, counter = deployed(chain)
        chain.send([Call(sender, counter, word(7))])
    path = tmp_path / FILE_NAME
    content = bytearray(path.read_bytes())
    content[-20] ^= 1
    path.write_bytes(content)
    with pytest.raises(ChainError, match="block 2"):
        EmbeddedChain(tmp_path)
    assert path.read_bytes() == content


def test_a_missing_block_is_refused(tmp_path: Path) -> None:
    with EmbeddedChain(tmp_path) as chain:
        sender, counter = deployed(chain)
        for n in (1, 2, 3):
            chain.send([Call(sender, counter, word(n))])
    lines = (tmp_path / FILE_NAME).read_bytes().splitlines(keepends=True)
    (tmp_path / FILE_NAME).write_bytes(b"".join(lines[:2] + lines[3:]))
    with pytest.raises(ChainError, match="the hash of the block before"):
        EmbeddedChain(tmp_path)


def test_two_processes_cannot_write_one_chain(tmp_path: Path) -> None:
    with EmbeddedChain(tmp_path), pytest.raises(ChainError, match="no other process"):
        EmbeddedChain(tmp_path)


def test_a_chain_of_another_id_is_refused(tmp_path: Path) -> None:
    EmbeddedChain(tmp_path, chain_id=5).close()
    with pytest.raises(ChainError, match="chain_id: is 5; expected 6"):
        EmbeddedChain(tmp_path, chain_id=6)
    EmbeddedChain(tmp_path).close()


def test_time_does_not_run_backwards() -> None:
    chain = EmbeddedChain(timestamp=10)
    with pytest.raises(ChainError, match="no less than the latest block's, 10"):
        chain.send([Call(chain.account("a"), None, b"")], timestamp=9)
    assert chain.block_number == 0


@pytest.mark.parametrize("gas", [20_999, 30_000_001])
def test_a_gas_limit_that_fits_no_block_executes_nothing(gas: int) -> None:
    chain = EmbeddedChain()
    sender, counter = deployed(chain)
    with pytest.raises(ChainError, match="gas limit of count"):
        chain.send([Call(sender, counter, word(1)), Call(sender, counter, word(1), gas, "count")])
    assert count(chain, counter) == 0


def test_a_call_that_a_precompiled_contract_refuses_fails_alone(tmp_path: Path) -> None:
    with EmbeddedChain(tmp_path) as chain:
        sender, counter = deployed(chain)
        receipts = chain.send([Call(sender, counter, word(4)), Call(sender, "0x" + "00" * 19 + "08", b"\x01")])
        assert [receipt.status for receipt in receipts] == [True, False]
        assert count(chain, counter) == 4
    assert replay(tmp_path).differences == []


def test_asking_changes_nothing() -> None:
    chain = EmbeddedChain()
    sender, counter = deployed(chain)
    head = chain.head
    good, bad = chain.query([Call(sender, counter, word(3)), Call(sender, counter, word(0))])
    assert (good.status, bad.status, bad.output) == (True, False, word(0))
    assert (count(chain, counter), chain.head) == (0, head)


@pytest.mark.parametrize("seed", range(4))
def test_a_killed_process_loses_no_block_that_it_reported(tmp_path: Path, seed: int) -> None:
    program = textwrap.dedent(
        """
        import sys
        from pathlib import Path
        from tests_of_counter import INSTALLER, COUNTER
        from skyrelay.chain.chain import Call
        from skyrelay.chain.embedded.chain import EmbeddedChain

        chain = EmbeddedChain(Path(sys.argv[1]))
        sender = chain.account("someone")
        counter = chain.send([Call(sender, None, INSTALLER + COUNTER)])[0].created
        while True:
            chain.send([Call(sender, counter, (1).to_bytes(32, "big"))] * 3)
            print(chain.block_number, counter, flush=True)
        """
    )
    (tmp_path / "tests_of_counter.py").write_text(f"INSTALLER = {INSTALLER!r}\nCOUNTER = {COUNTER!r}\n")
    folder = tmp_path / "chain"
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(folder)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
    )
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(3 + seed)]
    time.sleep(0.003 * seed)
    process.send_signal(signal.SIGKILL)
    lines += process.stdout.readlines()
    process.wait()
    reported, counter = lines[-1].split() if lines[-1].endswith("\n") else lines[-2].split()
    with EmbeddedChain(folder) as chain:
        assert chain.block_number >= int(reported)
        assert count(chain, counter) == 3 * (chain.block_number - 1)
        chain.send([Call(chain.account("someone"), counter, word(1))])
    assert replay(folder).differences == []
