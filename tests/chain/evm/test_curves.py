"""alt_bn128: laws that hold of any pairing, what is no point, and that no call can take for ever."""

import pytest
from py_ecc import optimized_bn128 as curve

from skyrelay.chain.chain import Call
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.evm import alt_bn128
from skyrelay.chain.evm.precompiles import _ON_A_CURVE, precompiled
from skyrelay.chain.evm.state import MAX_PAIRS

ORDER, FIELD = curve.curve_order, curve.field_modulus


def number(value):
    return (value % 2**256).to_bytes(32, "big")


def point(times):
    return alt_bn128.multiply(number(1) + number(2) + number(times))


def twisted(times):
    x, y = curve.normalize(curve.multiply(curve.G2, times))
    return b"".join(number(int(part)) for half in (x, y) for part in reversed(half.coeffs))


def paired(points):
    found = alt_bn128.pairing(points)
    assert found is not None
    return int.from_bytes(found, "big")


def test_the_group_is_one():
    assert alt_bn128.add(point(5) + point(7)) == point(12)
    assert alt_bn128.add(point(5) + point(ORDER - 5)) == bytes(64)
    assert alt_bn128.add(b"") == bytes(64), "missing input is zero"
    assert alt_bn128.add(point(3)) == point(3)
    assert point(ORDER) == bytes(64)
    assert point(ORDER + 2) == point(2)


def test_a_pairing_is_linear_in_both():
    assert paired(point(6) + twisted(5) + point(ORDER - 10) + twisted(3)) == 1
    assert paired(point(6) + twisted(5) + point(ORDER - 10) + twisted(4)) == 0
    assert paired(b"") == 1
    assert paired(bytes(64) + twisted(3)) == 1


@pytest.mark.parametrize(
    ("address", "data"),
    [
        (6, number(1) + number(3)),
        (6, number(FIELD) + number(0)),
        (7, number(1) + number(3) + number(2)),
        (8, number(1) + number(2) + number(1) * 4),
        (8, number(1) + number(2) + twisted(1)[:-1]),
    ],
)
def test_what_is_no_point_ends_the_call(address, data):
    assert precompiled(address, data, 10**9, 8) == "no points of the curve"


def test_a_point_outside_the_group_of_prime_order_is_none():
    # On the twist, found by trying x = 1, 2, ...; of nearly all points there the order is not the prime one.
    for x in range(1, 100):
        a, b = (int(part) for part in (curve.FQ2([x, 0]) ** 3 + curve.b2).coeffs)
        norm = pow(a * a + b * b, (FIELD + 1) // 4, FIELD)
        for half in (a + norm, a - norm):
            real = pow(half * pow(2, -1, FIELD), (FIELD + 1) // 4, FIELD)
            imaginary = b * pow(2 * real, -1, FIELD) % FIELD
            if ((real * real - imaginary * imaginary - a) % FIELD, (2 * real * imaginary - b) % FIELD) == (0, 0):
                data = number(0) + number(x) + number(imaginary) + number(real)
                assert alt_bn128.pairing(number(1) + number(2) + data) is None
                return
    raise AssertionError("no such point among the first hundred")


def test_a_transaction_pairs_a_few_points_and_no_more(monkeypatch):
    told = "more pairings than a transaction may ask of this machine"
    assert precompiled(8, bytes(192 * 9), 10**9, 8) == told
    paired = []
    monkeypatch.setitem(_ON_A_CURVE, 8, (lambda data: paired.append(len(data)) or number(1), 45_000))
    # One pairing after the other, as long as the gas lasts: JUMPDEST, a static call of 8 with 192 bytes, a jump back.
    loop = "5b" + "6020" + "6000" + "60c0" + "6000" + "6008" + "62ffffff" + "fa" + "50" + "6000" + "56"
    chain = EmbeddedChain()
    sender = chain.account("anyone")
    code = bytes.fromhex(loop)
    creation = bytes.fromhex(f"60{len(code):02x}600c60003960{len(code):02x}6000f3") + code
    made = chain.send([Call(sender, None, creation, 1_000_000)])[0]
    spent = chain.send([Call(sender, made.created, b"", 5_000_000)])[0]
    assert not spent.status
    assert len(paired) == MAX_PAIRS


def test_prices_are_those_of_berlin_and_are_paid_first(monkeypatch):
    assert precompiled(6, b"", 150, 8) == (150, bytes(64))
    assert precompiled(7, b"", 6_000, 8) == (6_000, bytes(64))
    assert precompiled(8, bytes(192), 79_000, 1)[0] == 79_000
    monkeypatch.setattr(alt_bn128, "pairing", pytest.fail)
    for address, cost in ((6, 150), (7, 6_000), (8, 45_000)):
        assert precompiled(address, b"", cost - 1, 8) == "out of gas"
