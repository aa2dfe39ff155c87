"""A signed policy: what was signed, by whom, till when; every change is found, and no network is asked."""

import base64
import json
import shutil
import subprocess
from contextlib import suppress
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrelay.core.errors import ModelError
from skyrelay.core.scenario import load_scenario
from skyrelay.policy import Policy, signature
from skyrelay.simulation.consortium import Hangar

NOW = datetime(2027, 3, 1, tzinfo=UTC)
LATER = NOW + timedelta(days=30)
CONTENT = Policy.builtin("generalist").content
MADE_BY = {"commit": "1f2e3d4", "command": "skyrelay train", "seeds": [1, 2], "evaluation": []}


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys")
    pairs = []
    for name in ("ours", "theirs"):
        public = signature.new_key(folder / name, "a password")
        pairs.append((signature.private_key(folder / name, "a password"), signature.public_key(public), public))
    return pairs


@pytest.fixture(scope="module")
def signed(keys):
    return signature.sign(CONTENT, "generalist.onnx", keys[0][0], MADE_BY, NOW, LATER)


def test_a_signed_policy_says_who_made_it_how_and_till_when_and_flies(keys, signed):
    told = signature.verify(signed, [keys[1][1], keys[0][1]], NOW + timedelta(days=1), "policy")
    assert (told.key, told.issued, told.expires) == (signature.key_id(keys[0][1]), NOW, LATER)
    assert told.provenance == MADE_BY
    assert signed.startswith(CONTENT)
    assert Policy.load(signed).card == Policy.builtin("generalist").card, "any reader of ONNX reads it"
    again = signature.sign(signed, "generalist.onnx", keys[1][0], MADE_BY, NOW, LATER)
    assert signature.split(again, "")[0] == CONTENT, "another signature takes the first one's place"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda _, __: CONTENT, "without a signature"),
        (lambda signed, _: signed + b"\x08\x07", "without a signature"),  # a field behind it is none of what was signed
        (lambda signed, _: signed[:-1], "protobuf cannot be read"),
        (lambda _, __: b"\x08\x01" * 1_000_000, "protobuf cannot be read"),  # a second of looking at each, or more
        (lambda signed, _: b"\x08\x07" + signed, "of other bytes"),
        (lambda signed, _: signed.replace(b"skyrelay.card", b"skyrelay.cart", 1), "of other bytes"),
        (lambda signed, _: signed.replace(b"sigstore", b"sigstars"), "two bundles that"),
        (lambda signed, theirs: signed.replace(b'"tlogEntries"', b'"tlogEntriez"') and theirs, "by the key"),
    ],
)
def test_what_was_changed_or_is_of_another_key_is_refused(keys, signed, change, told):
    theirs = signature.sign(CONTENT, "generalist.onnx", keys[1][0], MADE_BY, NOW, LATER)
    with pytest.raises(ModelError, match=told):
        signature.verify(change(signed, theirs), [keys[0][1]], NOW, "policy")


def test_a_policy_expires_and_is_not_valid_beforehand(keys, signed):
    for time, told in ((LATER, "expired 2027-03-31"), (NOW - timedelta(hours=1), "valid from 2027-03-01")):
        with pytest.raises(ModelError, match=told):
            signature.verify(signed, [keys[0][1]], time, "policy")
    with pytest.raises(ModelError, match="a time within 3660 days"):
        signature.sign(CONTENT, "x", keys[0][0], {}, NOW, NOW)


def entry_of(content):
    return json.loads(signature.split(content, "")[1] or b"")


def with_entry(entry):
    return CONTENT + signature._field(
        14, signature._field(1, signature.ENTRY.encode()) + signature._field(2, json.dumps(entry).encode())
    )


def test_a_statement_of_another_file_or_key_is_refused(keys, signed):
    other = signature.sign(CONTENT + b"\x08\x07", "other.onnx", keys[0][0], MADE_BY, NOW, LATER)
    theirs = signature.sign(CONTENT, "generalist.onnx", keys[1][0], MADE_BY, NOW, LATER)
    trusted = [keys[0][1], keys[1][1]]
    for entry, told in (
        ({**entry_of(signed), "attestation": entry_of(other)["attestation"]}, "of other bytes"),
        ({**entry_of(signed), "signature": entry_of(other)["signature"]}, "of other bytes"),
        ({**entry_of(signed), "attestation": entry_of(theirs)["attestation"]}, "by two keys"),
        ({**entry_of(signed), "attestation": entry_of(signed)["signature"]}, "two bundles"),
        ({"signature": entry_of(signed)["signature"]}, "two bundles"),
        ([], "two bundles"),
    ):
        with pytest.raises(ModelError, match=told):
            signature.verify(with_entry(entry), trusted, NOW, "policy")
    lengthened = entry_of(signed)
    envelope = lengthened["attestation"]["dsseEnvelope"]
    payload = base64.b64decode(envelope["payload"]).replace(b"2027-03-31", b"2029-03-31")
    envelope["payload"] = base64.b64encode(payload).decode()
    with pytest.raises(ModelError, match="not that key's"):
        signature.verify(with_entry(lengthened), trusted, NOW, "policy")


@settings(max_examples=200, deadline=None)
@given(at=st.integers(0, 2_600), bit=st.integers(0, 7))
def test_no_bit_of_the_signature_can_be_changed_and_still_say_something_else(keys, signed, at, bit):
    changed = bytearray(signed)
    changed[min(len(CONTENT) - 600 + at, len(signed) - 1)] ^= 1 << bit
    told = None
    with suppress(ModelError):
        told = signature.verify(bytes(changed), [keys[0][1]], NOW, "policy")
    if told is not None:  # what nothing is read from, such as a key id that DSSE leaves free
        assert (told.expires, told.provenance) == (LATER, MADE_BY)
        assert signature.split(bytes(changed), "")[0] == CONTENT


@given(st.binary(max_size=300))
def test_any_bytes_are_refused_in_one_line(keys, content):
    with pytest.raises(ModelError):
        signature.verify(content, [keys[0][1]], NOW, "policy")


def test_uavs_that_trust_keys_refuse_what_nobody_signed_and_what_expires_in_the_air(keys, signed):
    now = [NOW]
    scenario = load_scenario("bologna", [f"store.trusted_keys=['{keys[0][2]}']"])
    hangar = Hangar(scenario, lambda: now[0])
    policy = hangar.load(signed)
    assert hangar.load(policy.content) is policy
    with pytest.raises(ModelError, match="without a signature"):
        hangar.load(CONTENT)
    now[0] = LATER
    with pytest.raises(ModelError, match="expired"):
        hangar.load(policy.content)
    assert Hangar(load_scenario("bologna")).load(CONTENT).card == policy.card, "without keys any policy flies"


def test_keys_are_private_and_what_is_none_is_one_line(keys, tmp_path):
    secret = keys[0][2].with_suffix("")
    assert secret.stat().st_mode & 0o077 == 0
    assert b"ENCRYPTED" in secret.read_bytes()
    with pytest.raises(ModelError, match="and its password"):
        signature.private_key(secret, "another")
    with pytest.raises(ModelError, match="a public key on P-256"):
        signature.public_key(secret)
    with pytest.raises(ModelError, match="a place for a new key"):
        signature.new_key(secret, "a password")
    (tmp_path / "half.pub").write_text("somebody's")
    with pytest.raises(ModelError, match="a place for a new key"):
        signature.new_key(tmp_path / "half", "a password")
    assert [path.name for path in tmp_path.glob("half*")] == ["half.pub"], "nothing half-written"
    with pytest.raises(ModelError, match="a readable key"):
        signature.public_key(tmp_path / "none")


def test_openssl_agrees_with_the_signature(keys, tmp_path):
    """Another implementation's word: OpenSSL checks the envelope's signature under the public key."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl is not installed")
    envelope = json.loads(signature.openssf_bundle(CONTENT, "generalist.onnx", keys[0][0]))["dsseEnvelope"]
    payload = base64.b64decode(envelope["payload"])
    kind = envelope["payloadType"].encode()
    (tmp_path / "sig").write_bytes(base64.b64decode(envelope["signatures"][0]["sig"]))
    (tmp_path / "pae").write_bytes(b" ".join([b"DSSEv1", b"%d" % len(kind), kind, b"%d" % len(payload), payload]))
    command = [openssl, "dgst", "-sha256", "-verify", keys[0][2], "-signature", tmp_path / "sig", tmp_path / "pae"]
    assert subprocess.run(command, capture_output=True, text=True).stdout == "Verified OK\n"
