"""Beacons: what is sealed is what is let in, and nothing else is."""

import math
from dataclasses import replace

import pytest
from eth_account import Account
from eth_account.messages import encode_defunct
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrelay.chain.accounts import Keyring, SigningKey, signer
from skyrelay.core.errors import ChainError
from skyrelay.protocol.beacon import FARTHEST, FASTEST, LONGEST, MOST, BeaconGate, Dropped, Session, parse
from skyrelay.protocol.messages import Beacon

CONTRACT = ("0x" + "c0" * 20, 31337)
RING = Keyring(b"k" * 32)
UAV, MATE, VEHICLE, STRANGER = (RING.account(name) for name in ("uav", "mate", "vehicle", "stranger"))


def session(member=UAV, now=100.0, lifetime=3600.0, contract=CONTRACT, vouch=None):
    return Session(member, contract, vouch or (lambda message: RING.vouch(member, message)), now, lifetime)


def gate(**options):
    return BeaconGate(CONTRACT, {UAV, MATE}, {VEHICLE}, {1, 2}, **({"patience": 5.0, "skew": 1.0} | options))


def uav_beacon(time=100.0, zone=1):
    return Beacon(UAV, zone, None, (12.25, -3.5), time, 20.0, 87.5)


def vehicle_beacon(time=100.0, position=(1.0, 2.0)):
    return Beacon(VEHICLE, 2, UAV, position, time, 13.5)


coordinates = st.floats(-FARTHEST, FARTHEST)
beacons = st.builds(
    Beacon,
    sender=st.just(UAV),
    zone=st.integers(0, 65535),
    to=st.none() | st.binary(min_size=20, max_size=20).map(lambda raw: "0x" + raw.hex()),
    position=st.none() | st.tuples(coordinates, coordinates),
    time=st.floats(allow_nan=False, allow_infinity=False),
    speed=st.floats(0, FASTEST, width=32),
    battery=st.floats(0, 100, width=32),
    asks=st.floats(0, MOST, width=32),
)


@given(beacons)
def test_what_is_sealed_comes_out_to_the_last_digit(beacon):
    raw = session().seal(beacon)
    assert len(raw) <= LONGEST
    assert parse(raw).beacon == beacon


@given(st.binary(max_size=LONGEST + 50))
def test_any_bytes_are_dropped_and_raise_nothing(raw):
    door = gate()
    assert door.admit(raw, 100.0) is None
    assert door.dropped.total() == 1


@settings(max_examples=300)
@given(st.data())
def test_no_bit_of_a_beacon_can_be_changed(data):
    raw = bytearray(session().seal(uav_beacon()))
    place = data.draw(st.integers(0, 8 * len(raw) - 1))
    raw[place // 8] ^= 1 << place % 8
    door = gate()
    assert door.admit(bytes(raw), 100.0) is None
    assert door.dropped.total() == 1
    assert door.admit(session().seal(uav_beacon()), 100.0) == uav_beacon()


def test_members_are_let_in_and_counted():
    door, uav, vehicle = gate(), session(), session(VEHICLE)
    for second in range(3):
        assert door.admit(uav.seal(uav_beacon(100.0 + second)), 100.0 + second) == uav_beacon(100.0 + second)
    assert door.admit(vehicle.seal(vehicle_beacon(102.0, None)), 102.5) == vehicle_beacon(102.0, None)
    assert (door.admitted, door.dropped.total()) == (4, 0)


def reasons(door):
    return dict(door.dropped)


def test_a_beacon_is_stale_beyond_the_stated_age_and_early_beyond_the_stated_skew():
    door, uav = gate(), session()
    assert door.admit(uav.seal(uav_beacon(100.0)), 105.0)
    assert door.admit(uav.seal(uav_beacon(100.0)), 105.001) is None
    assert reasons(door) == {Dropped.STALE: 1}
    assert door.admit(uav.seal(uav_beacon(106.0)), 105.0)
    assert door.admit(uav.seal(uav_beacon(106.001)), 105.0) is None
    assert reasons(door) == {Dropped.STALE: 1, Dropped.EARLY: 1}


def test_a_beacon_counts_once_and_an_older_one_no_more():
    door, uav = gate(), session()
    first, second = uav.seal(uav_beacon(100.0)), uav.seal(uav_beacon(101.0))
    assert door.admit(second, 101.0)
    assert door.admit(second, 101.0) is None
    assert door.admit(first, 101.0) is None
    assert reasons(door) == {Dropped.REPLAYED: 2}


def test_a_member_that_starts_again_is_heard_at_once_and_its_old_session_no_more():
    door, old, new = gate(), session(now=100.0), session(now=101.0)
    assert door.admit(old.seal(uav_beacon(100.5)), 101.0)
    assert door.admit(new.seal(uav_beacon(101.0)), 101.0)
    assert door.admit(old.seal(uav_beacon(101.5)), 101.5) is None
    assert reasons(door) == {Dropped.REPLAYED: 1}


def test_one_whose_clock_was_ahead_is_heard_again_when_it_is_right():
    """An onlooker cannot tell at once who is ahead: it lets such beacons in, and does not go by them."""
    door, ahead, right = gate(), session(now=9000.0), session(now=100.0)
    for second in range(3):
        assert door.admit(ahead.seal(uav_beacon(9000.0 + second)), 9000.0 + second, remember=False)
    first = right.seal(uav_beacon(100.0))
    assert door.admit(first, 100.0)
    assert door.admit(first, 100.0) is None
    assert reasons(door) == {Dropped.REPLAYED: 1}


def test_nobody_speaks_for_another():
    door = gate()
    by_itself = session(vouch=lambda message: SigningKey().sign(message))
    by_another = session(vouch=lambda message: RING.vouch(MATE, message))
    elsewhere = session(contract=("0x" + "c1" * 20, 31337))
    other_chain = session(contract=(CONTRACT[0], 1))
    nonsense = session(vouch=lambda message: bytes(65))
    for impostor in (by_itself, by_another, elsewhere, other_chain, nonsense):
        assert door.admit(impostor.seal(uav_beacon()), 100.0) is None
    assert reasons(door) == {Dropped.FORGED: 5}


def test_a_certificate_serves_no_other_session_key():
    door, thief, certificate = gate(), session(vouch=lambda message: bytes(65)), session().certificate
    assert door.admit(session(now=99.0).seal(uav_beacon(99.5)), 100.0)
    thief.certificate = certificate  # another's, while the beacon is signed by the thief
    assert door.admit(thief.seal(uav_beacon(101.0)), 101.0) is None
    thief.certificate = replace(certificate, key=thief._key.address)  # the thief's key in another's certificate
    assert door.admit(thief.seal(uav_beacon(101.0)), 101.0) is None
    assert reasons(door) == {Dropped.FORGED: 2}


def test_a_session_ends():
    door, short = gate(), session(now=100.0, lifetime=2.0)
    assert door.admit(short.seal(uav_beacon(102.0)), 102.0)
    assert door.admit(short.seal(uav_beacon(102.5)), 102.5) is None
    ahead = session(now=110.0)
    assert door.admit(ahead.seal(uav_beacon(102.5)), 102.5) is None
    assert reasons(door) == {Dropped.EXPIRED: 2}


def test_only_members_of_their_own_kind_and_zone():
    door = gate()
    assert door.admit(session(STRANGER).seal(replace(uav_beacon(), sender=STRANGER)), 100.0) is None
    assert door.admit(session(VEHICLE).seal(replace(uav_beacon(), sender=VEHICLE)), 100.0) is None
    assert door.admit(session().seal(replace(vehicle_beacon(), sender=UAV, to=MATE)), 100.0) is None
    assert door.admit(session().seal(uav_beacon(zone=3)), 100.0) is None
    assert reasons(door) == {Dropped.UNKNOWN: 3, Dropped.FOREIGN: 1}


def test_what_a_gate_remembers_does_not_grow_by_what_it_drops():
    door = gate()
    for number in range(50):
        name = RING.account(f"stranger {number}")
        door.admit(session(name).seal(replace(uav_beacon(), sender=name)), 100.0)
        door.admit(session(vouch=lambda message: bytes(65)).seal(uav_beacon()), 100.0)
    assert not door._certificates
    assert not door._last


@pytest.mark.parametrize(
    "wrong",
    [
        {"position": (math.nan, 0.0)},
        {"position": (0.0, 2 * FARTHEST)},
        {"speed": -1.0},
        {"battery": 100.5},
        {"zone": 65536},
        {"time": math.inf},
        {"sender": MATE},
    ],
)
def test_what_fits_no_beacon_is_not_sealed(wrong):
    with pytest.raises(ValueError):
        session().seal(replace(uav_beacon(), **wrong))


def test_signatures_are_those_of_ethereum_wallets():
    message = b"certificate of something"
    account = Account.create()
    theirs = bytes(account.sign_message(encode_defunct(message)).signature)
    ours = SigningKey(bytes(account.key)).sign(message)
    assert theirs == ours[:64] + bytes([ours[64] + 27])
    assert signer(message, ours) == account.address.lower()


def test_a_ring_vouches_for_its_own_members_only():
    with pytest.raises(ChainError, match="an account of this host's keyring"):
        RING.vouch("0x" + "00" * 20, b"x")


@pytest.mark.parametrize(("sender", "reason"), [(VEHICLE, None), (UAV, Dropped.UNKNOWN)])
def test_a_vehicle_without_a_uav_asks_its_zone_and_no_uav_does(sender, reason):
    door = gate()
    asking = Beacon(sender, 2, None, (1.0, 2.0), 100.0, 13.5, asks=2500.0)
    assert door.admit(session(sender).seal(asking), 100.0) == (None if reason else asking)
    assert door.dropped == ({reason: 1} if reason else {})
