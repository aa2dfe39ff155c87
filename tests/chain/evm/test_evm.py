"""The EVM alone: gas by the EIPs' own tables, arithmetic against Python's, and how frames end."""

from __future__ import annotations

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrelay.chain import evm
from skyrelay.chain.evm.words import signed
from skyrelay.core.errors import ChainError

BLOCK = evm.BlockContext(number=7, timestamp=99, gas_limit=30_000_000, chain_id=5, block_hash=lambda n: 1000 + n)
SENDER, TARGET = 0xAAAA, 0xBBBB
words = st.one_of(
    st.integers(0, evm.WORD),
    st.integers(0, 300),
    st.integers(0, 300).map(lambda n: evm.WORD - n),
    st.integers(0, 255).map(lambda n: 1 << n),
)


def run(code: bytes, data: bytes = b"", gas: int = 1_000_000, storage: dict[int, int] | None = None) -> evm.Outcome:
    state = evm.WorldState()
    state.set_code(TARGET, code)
    state.storage[TARGET] = dict(storage or {})
    return evm.transact(state, BLOCK, sender=SENDER, to=TARGET, data=data, gas=gas)


def push(value: int) -> bytes:
    return bytes([0x7F]) + value.to_bytes(32, "big")


def result_of(opcode: int, *operands: int) -> int:
    """The opcode's result, the first operand being on top."""
    code = b"".join(push(operand) for operand in reversed(operands)) + bytes([opcode])
    outcome = run(code + bytes.fromhex("60005260206000f3"))
    assert outcome.status
    return int.from_bytes(outcome.output, "big")


# EIP-3529's table (EIP-2200's cases under London): code, original value, gas used by it, refund.
EIP_3529 = [
    ("60006000556000600055", 0, 212, 0),
    ("60006000556001600055", 0, 20112, 0),
    ("60016000556000600055", 0, 20112, 19900),
    ("60016000556002600055", 0, 20112, 0),
    ("60016000556001600055", 0, 20112, 0),
    ("60006000556000600055", 1, 3012, 4800),
    ("60006000556001600055", 1, 3012, 2800),
    ("60006000556002600055", 1, 3012, 0),
    ("60026000556000600055", 1, 3012, 4800),
    ("60026000556003600055", 1, 3012, 0),
    ("60026000556001600055", 1, 3012, 2800),
    ("60026000556002600055", 1, 3012, 0),
    ("60016000556000600055", 1, 3012, 4800),
    ("60016000556002600055", 1, 3012, 0),
    ("60016000556001600055", 1, 212, 0),
    ("600160005560006000556001600055", 0, 40118, 19900),
    ("600060005560016000556000600055", 1, 5918, 7600),
]


@pytest.mark.parametrize(("code", "original", "gas", "refund"), EIP_3529)
def test_storage_costs_what_eip_3529_lists(code: str, original: int, gas: int, refund: int) -> None:
    # The table counts a warm slot; a cold one costs 2100 more, once.
    outcome = run(bytes.fromhex(code), storage={0: original})
    spent = evm.INTRINSIC_GAS + gas + 2100
    assert outcome.gas_used == spent - min(refund, spent // 5)


def test_slots_are_cold_again_in_the_next_transaction() -> None:
    state = evm.WorldState()
    state.set_code(TARGET, bytes.fromhex("60005450"))
    used = [evm.transact(state, BLOCK, sender=SENDER, to=TARGET, data=b"", gas=100_000).gas_used for _ in range(2)]
    assert used == [21_000 + 3 + 2100 + 2] * 2


def test_data_costs_by_its_zeros() -> None:
    assert evm.intrinsic_gas(b"\0\0\1", creates=False) == 21_000 + 4 + 4 + 16
    assert evm.intrinsic_gas(b"", creates=True) == 53_000


@given(words, words)
def test_arithmetic_is_pythons_modulo_two_to_the_256(a: int, b: int) -> None:
    sa, sb = signed(a), signed(b)
    quotient = 0 if b == 0 else abs(sa) // abs(sb) * (1 if (sa < 0) == (sb < 0) else -1)
    remainder = 0 if b == 0 else sa - sb * quotient
    expected = {
        0x01: a + b,
        0x02: a * b,
        0x03: a - b,
        0x04: a // b if b else 0,
        0x05: quotient,
        0x06: a % b if b else 0,
        0x07: remainder,
        0x10: int(a < b),
        0x11: int(a > b),
        0x12: int(sa < sb),
        0x13: int(sa > sb),
        0x14: int(a == b),
        0x16: a & b,
        0x17: a | b,
        0x18: a ^ b,
        0x1A: b.to_bytes(32, "big")[a] if a < 32 else 0,
        0x1B: b << a if a < 256 else 0,
        0x1C: b >> a if a < 256 else 0,
        0x1D: sb >> a if a < 256 else (-1 if sb < 0 else 0),
    }
    for opcode, value in expected.items():
        assert result_of(opcode, a, b) == value & evm.WORD, hex(opcode)


@given(words, words, words)
def test_modular_arithmetic_does_not_wrap_between(a: int, b: int, n: int) -> None:
    assert result_of(0x08, a, b, n) == ((a + b) % n if n else 0)
    assert result_of(0x09, a, b, n) == ((a * b) % n if n else 0)


@given(words, st.integers(0, 40))
def test_sign_extension(value: int, size: int) -> None:
    kept = value % (1 << 8 * (size + 1)) if size < 31 else value
    if size < 31 and kept >> (8 * (size + 1) - 1):
        kept -= 1 << 8 * (size + 1)
    assert result_of(0x0B, size, value) == kept & evm.WORD


def test_a_halt_spends_all_gas_and_keeps_only_the_nonce() -> None:
    state = evm.WorldState()
    state.set_code(TARGET, bytes.fromhex("6001600055600060006000a1fe"))
    outcome = evm.transact(state, BLOCK, sender=SENDER, to=TARGET, data=b"", gas=80_000)
    assert (outcome.status, outcome.gas_used, outcome.logs) == (False, 80_000, ())
    assert outcome.halt == "invalid opcode 0xfe"
    assert state.storage[TARGET].get(0, 0) == 0
    assert state.nonces == {SENDER: 1}


def test_a_revert_keeps_its_data_and_the_rest_of_the_gas() -> None:
    outcome = run(bytes.fromhex("602a60005260206000fd"))
    assert not outcome.status
    assert outcome.halt is None
    assert int.from_bytes(outcome.output, "big") == 42
    assert outcome.gas_used < 22_000


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("01", "stack underflow"),
        ("600456", "bad jump"),
        ("60016004575b", "bad jump"),  # 4 is inside a push
        ("61ffff600052620fffff51", "out of gas"),
        ("5b60006000565b", "stack overflow"),
        ("60016000f3", None),
    ],
)
def test_how_frames_end(code: str, reason: str | None) -> None:
    # The stack overflows after about a thousand turns of the loop, each 13 gas.
    outcome = run(bytes.fromhex(code), gas=200_000)
    assert outcome.halt == reason


def test_a_full_stack_is_not_yet_an_overflow() -> None:
    full = b"\x60\x01" * 1024
    assert run(full + b"\x50" * 1024).status
    assert run(full + b"\x60\x01").halt == "stack overflow"
    # A jump out before the overflow is no overflow either, though the trace goes on behind it.
    jump = full[:-4] + bytes.fromhex("6001") + b"\x61" + (2046 + 1 + 3 + 2).to_bytes(2, "big") + b"\x57"
    assert run(jump + b"\x60\x01" + b"\x5b\x00").status


def test_calls_within_calls_stop_at_depth_1024() -> None:
    # Calls itself with all gas and returns one more than what came back: the count of frames.
    state = evm.WorldState()
    state.set_code(TARGET, bytes.fromhex("60206000600060006000305af15060005160010160005260206000f3"))
    outcome = evm.query(state, BLOCK, sender=SENDER, to=TARGET, data=b"", gas=10**14)
    assert int.from_bytes(outcome.output, "big") == 1025


def test_a_static_call_may_not_write() -> None:
    state = evm.WorldState()
    writer = 0xCCCC
    state.set_code(writer, bytes.fromhex("6001600055"))
    state.set_code(TARGET, bytes.fromhex("600060006000600061cccc5afa60005260206000f3"))
    outcome = evm.transact(state, BLOCK, sender=SENDER, to=TARGET, data=b"", gas=200_000)
    assert outcome.status
    assert int.from_bytes(outcome.output, "big") == 0
    assert state.storage.get(writer, {}).get(0, 0) == 0


def test_a_destroyed_contract_is_an_empty_account() -> None:
    state = evm.WorldState()
    state.set_code(0xCCCC, bytes.fromhex("6000ff"))
    state.nonces[0xCCCC] = 1
    evm.transact(state, BLOCK, sender=SENDER, to=0xCCCC, data=b"", gas=100_000)
    state.set_code(TARGET, bytes.fromhex("61cccc3f60005260206000f3"))
    outcome = evm.transact(state, BLOCK, sender=SENDER, to=TARGET, data=b"", gas=100_000)
    assert int.from_bytes(outcome.output, "big") == 0  # EXTCODEHASH of no account, not of empty code


def test_blocks_are_seen_from_inside() -> None:
    assert result_of(0x42) == 99
    assert result_of(0x43) == 7
    assert result_of(0x46) == 5
    assert result_of(0x40, 6) == 1006
    assert result_of(0x40, 7) == 0  # the block itself has no hash yet


def precompiled(address: int, data: bytes, gas: int = 500_000) -> tuple[bool, bytes]:
    """What a precompiled contract answers, by a call that copies the transaction's data to it."""
    code = bytes.fromhex("36600060003760006000366000") + b"\x60" + bytes([address]) + b"\x5a\xfa"
    code += bytes.fromhex("3d600060003e3d6000f3")
    outcome = run(code, data, gas)
    return outcome.status, outcome.output


def test_precompiled_hashes_and_identity() -> None:
    data = b"sky relay" * 9
    assert precompiled(2, data)[1] == hashlib.sha256(data).digest()
    assert precompiled(3, b"abc")[1].hex() == "00" * 12 + "8eb208f7e05d987a9b044a8e98c6b087f15a0bfc"
    assert precompiled(4, data)[1] == data


def test_precompiled_recovery_and_powers() -> None:
    from eth_keys.datatypes import PrivateKey

    key = PrivateKey(b"\7" * 32)
    digest = hashlib.sha256(b"message").digest()
    signature = key.sign_msg_hash(digest)
    data = digest + b"".join(n.to_bytes(32, "big") for n in (signature.v + 27, signature.r, signature.s))
    assert precompiled(1, data)[1][12:] == key.public_key.to_canonical_address()
    assert precompiled(1, data[:63] + b"\x09" + data[64:])[1] == b""
    sizes = b"".join(n.to_bytes(32, "big") for n in (2, 1, 2))
    assert precompiled(5, sizes + (777).to_bytes(2, "big") + b"\x0b" + (1009).to_bytes(2, "big"))[1] == pow(
        777, 11, 1009
    ).to_bytes(2, "big")


@pytest.mark.parametrize("address", [9])
def test_a_precompiled_contract_that_is_missing_ends_the_call_and_no_more(address: int) -> None:
    # Calls it with 5,000 gas and returns what CALL said, and a one behind it.
    state = evm.WorldState()
    state.set_code(TARGET, bytes.fromhex(f"6000600060006000600060{address:02x}611388f1600052600160205260406000f3"))
    outcome = evm.transact(state, BLOCK, sender=SENDER, to=TARGET, data=b"", gas=100_000)
    assert (outcome.status, outcome.output) == (True, bytes(63) + b"\x01")
    straight = evm.transact(state, BLOCK, sender=SENDER, to=address, data=b"", gas=100_000)
    assert (straight.status, straight.gas_used) == (False, 100_000)
    assert straight.halt == f"precompiled contract {address} is not part of this machine"


def test_a_contract_begins_with_no_storage() -> None:
    state = evm.WorldState()
    created = evm.contract_address(SENDER, 0)
    state.storage[created] = {1: 7}
    # Its constructor returns what it finds at 1.
    outcome = evm.transact(
        state, BLOCK, sender=SENDER, to=None, data=bytes.fromhex("60015460005260206000f3"), gas=99_999
    )
    assert (outcome.status, outcome.output) == (True, bytes(32))
    failed = evm.WorldState()
    failed.storage[created] = {1: 7}
    assert not evm.transact(failed, BLOCK, sender=SENDER, to=None, data=b"\xfe", gas=99_999).status
    assert failed.storage[created] == {1: 7}


def test_a_contract_is_created_where_ethereum_puts_it() -> None:
    # The known address of the first contract of this account (Ethereum's documentation of CREATE uses it).
    sender = 0x6AC7EA33F8831EA9DCC53393AAA88B25A785DBF0
    addresses = [evm.contract_address(sender, nonce) for nonce in range(2)]
    assert [f"{address:040x}" for address in addresses] == [
        "cd234a471b72ba2f1ccf0a70fcaba648a5eecd8d",
        "343c43a37d37dff08ae8c4a11544c718abb4fcf8",
    ]


def test_too_little_gas_for_the_transaction_itself() -> None:
    with pytest.raises(ChainError, match="at least 21000"):
        run(b"", gas=20_999)
