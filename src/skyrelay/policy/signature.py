"""Who vouches for a policy: a signature and an attestation that travel inside the ONNX file.

Both are Sigstore bundles of DSSE envelopes, signed by an elliptic-curve key (P-256), without any service. The first is
what OpenSSF model signing 1.0 makes of the file; the second is an in-toto statement of what made it and how long it
may be flown. They lie in one metadata entry at the file's end. Protocol buffers join what is appended, so that any
reader of ONNX still reads the file, and what was signed is the bytes before.

Source: DSSE v1, in-toto Statement v1, OpenSSF model signing v1.0 (``docs/decisions/0085-signed-models.md``).
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from skyrelay.core.errors import ModelError
from skyrelay.core.untrusted import parse_json

ENTRY = "skyrelay.signature"
"""Name of the metadata entry."""
MAX_ENTRY = 1 << 20
MAX_KEY_FILE = 1 << 16
MAX_FIELDS = 10_000
"""Of the file's outermost message; a policy has about ten."""
MAX_VALIDITY = timedelta(days=3660)
SKEW = timedelta(minutes=5)
"""By how much the signer's clock may be ahead of ours."""

_STATEMENT = "https://in-toto.io/Statement/v1"
_PAYLOAD = "application/vnd.in-toto+json"
_BUNDLE = "application/vnd.dev.sigstore.bundle.v0.3+json"
_SIGNATURE = "https://model_signing/signature/v1.0"
_ATTESTATION = "urn:skyrelay:attestation:1"


@dataclass(frozen=True, slots=True)
class Attested:
    """What a signed policy says of itself, and who says so.

    Attributes:
        key: SHA-256 of the public key's PEM, hexadecimal.
        issued, expires: from when till when it may be flown.
        provenance: commit, command, seeds, versions and evaluation, as the signer has written them.
    """

    key: str
    issued: datetime
    expires: datetime
    provenance: Mapping[str, Any]

    def require_valid(self, now: datetime, place: str) -> None:
        """The time is between both.

        Raises:
            ModelError: it is not.
        """
        if now >= self.expires:
            raise ModelError(f"{place}: signature", f"expired {_text(self.expires)}", "one that is still valid")
        if now < self.issued - SKEW:
            raise ModelError(f"{place}: signature", f"valid from {_text(self.issued)}", "one that is valid already")


def sign(
    content: bytes,
    name: str,
    key: ec.EllipticCurvePrivateKey,
    provenance: Mapping[str, Any],
    issued: datetime,
    expires: datetime,
) -> bytes:
    """The file with its signature; a signature that it had is replaced.

    Args:
        content: of the file.
        name: that the statements give it.
        key: on P-256.
        provenance: commit, command, seeds, evaluation: what JSON can say.
    Raises:
        ModelError: the file's protocol buffer cannot be read, or the times do not fit.
    """
    if not issued < expires <= issued + MAX_VALIDITY:
        raise ModelError("expiry", _text(expires), f"a time within {MAX_VALIDITY.days} days from {_text(issued)}")
    body, _ = split(content, name)
    attested = {"provenance": dict(provenance), "issued": _text(issued), "expires": _text(expires)}
    entry = {
        "signature": json.loads(openssf_bundle(body, name, key)),
        "attestation": _bundle(_statement(body, name, _ATTESTATION, attested), key),
    }
    value = json.dumps(entry, separators=(",", ":")).encode()
    if len(value) > MAX_ENTRY:
        raise ModelError(f"{name}: signature", f"{len(value)} bytes", f"an attestation of at most {MAX_ENTRY} bytes")
    return body + _field(14, _field(1, ENTRY.encode()) + _field(2, value))


def verify(content: bytes, keys: Sequence[ec.EllipticCurvePublicKey], now: datetime, place: str) -> Attested:
    """Check a file's signature and attestation; no network is asked.

    Args:
        keys: whose signature counts, both statements by the same one.
        now: with a time zone.
    Raises:
        ModelError: there is none, it is another key's, the file was changed, or it is not valid at this time.
    """
    body, value = split(content, place)
    if value is None:
        raise ModelError(place, "without a signature", "one by a trusted key (`skyrelay models sign`)")
    try:
        entry = parse_json(value, size=MAX_ENTRY)
        by_key = {key_id(key): key for key in keys}
        signed, signer = _opened(entry["signature"], by_key, place)
        told, attester = _opened(entry["attestation"], by_key, place)
        if signer != attester:
            raise ModelError(f"{place}: signature", "by two keys", "one key for signature and attestation")
        if signed["predicateType"] != _SIGNATURE or told["predicateType"] != _ATTESTATION:
            raise ValueError  # noqa: TRY301
        digest = hashlib.sha256(body).hexdigest()
        listed = [(one["algorithm"], one["digest"]) for one in signed["predicate"]["resources"]]
        root = hashlib.sha256(bytes.fromhex(digest)).hexdigest()
        stated = [one["digest"] for one in (*signed["subject"], *told["subject"])]
        if listed != [("sha256", digest)] or stated != [{"sha256": root}, {"sha256": digest}]:
            raise ModelError(f"{place}: signature", "of other bytes", "that of this file: it was changed since")
        predicate = told["predicate"]
        issued, expires = (_time(predicate[name]) for name in ("issued", "expires"))
        provenance = predicate["provenance"]
        if not isinstance(provenance, dict) or not issued < expires <= issued + MAX_VALIDITY:
            raise ValueError  # noqa: TRY301
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError):
        raise ModelError(f"{place}: signature", None, "two bundles that `skyrelay models sign` has written") from None
    attested = Attested(signer, issued, expires, provenance)
    attested.require_valid(now, place)
    return attested


def openssf_bundle(body: bytes, name: str, key: ec.EllipticCurvePrivateKey) -> str:
    """What OpenSSF model signing makes of a model of one file, as JSON."""
    digest = hashlib.sha256(body).digest()
    predicate = {
        "serialization": {"method": "files", "hash_type": "sha256", "allow_symlinks": False, "ignore_paths": []},
        "resources": [{"name": name, "algorithm": "sha256", "digest": digest.hex()}],
    }
    # Its subject is the hash of all files' hashes.
    return json.dumps(_bundle(_statement(digest, name, _SIGNATURE, predicate), key))


def split(content: bytes, place: str) -> tuple[bytes, bytes | None]:
    """What is signed, and the metadata entry behind it; None where there is none.

    Raises:
        ModelError: the protocol buffer cannot be read.
    """
    start = at = fields = 0
    try:
        while at < len(content):
            start, fields = at, fields + 1
            if fields > MAX_FIELDS:
                raise ValueError  # noqa: TRY301
            tag, at = _varint(content, at)
            kind = tag & 7
            if kind == 2:
                length, at = _varint(content, at)
                at += length
            elif kind in (0, 1, 5):
                at = _varint(content, at)[1] if kind == 0 else at + (8 if kind == 1 else 4)
            else:
                raise ValueError  # noqa: TRY301
        if at != len(content):
            raise ValueError  # noqa: TRY301
        head = _field(1, ENTRY.encode())
        tag, after = _varint(content, start)
        length, after = _varint(content, after) if tag == 14 << 3 | 2 else (0, after)
        if tag != 14 << 3 | 2 or not content.startswith(head, after):
            return content, None
        second, after = _varint(content, after + len(head))
        length, after = _varint(content, after)
        if second != 2 << 3 | 2 or after + length != len(content):
            raise ValueError  # noqa: TRY301
    except (IndexError, ValueError):
        raise ModelError(place, None, "an ONNX file (its protobuf cannot be read)") from None
    return content[:start], content[after:]


def key_id(key: ec.EllipticCurvePublicKey) -> str:
    """SHA-256 of a public key's PEM, as OpenSSF model signing names keys."""
    return hashlib.sha256(_pem(key)).hexdigest()


def new_key(path: Path, password: str) -> Path:
    """Write a new private key, encrypted and for its owner alone, and beside it ``.pub`` with the public one.

    Returns: the public key's path.
    Raises:
        ModelError: there is a file already, or it cannot be written.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    secret = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(password.encode()),
    )
    public = path.with_name(path.name + ".pub")
    written: list[Path] = []
    try:
        for place, data, mode in ((path, secret, 0o600), (public, _pem(key.public_key()), 0o644)):
            with os.fdopen(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
                written.append(place)
                file.write(data)
    except OSError as error:
        for place in written:
            place.unlink(missing_ok=True)
        raise ModelError(error.filename or path, None, f"a place for a new key ({error.strerror})") from None
    return public


def private_key(path: Path, password: str | None) -> ec.EllipticCurvePrivateKey:
    """Read a private key on P-256 (PEM); the password where it is encrypted.

    Raises:
        ModelError: it is none, or the password is another's.
    """
    try:
        key = serialization.load_pem_private_key(_key_file(path), password.encode() if password else None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise ModelError(path, None, "a private key on P-256 (PEM), and its password") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not isinstance(key.curve, ec.SECP256R1):
        raise ModelError(path, None, "a private key on P-256 (PEM)")
    return key


def public_key(path: Path) -> ec.EllipticCurvePublicKey:
    """Read a public key on P-256 (PEM).

    Raises:
        ModelError: it is none.
    """
    try:
        key = serialization.load_pem_public_key(_key_file(path))
    except (ValueError, UnsupportedAlgorithm):
        raise ModelError(path, None, "a public key on P-256 (PEM)") from None
    if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
        raise ModelError(path, None, "a public key on P-256 (PEM)")
    return key


def _key_file(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(MAX_KEY_FILE)
    except (OSError, ValueError) as error:
        raise ModelError(path, None, f"a readable key ({getattr(error, 'strerror', error)})") from None


def _statement(body: bytes, name: str, kind: str, predicate: Mapping[str, Any]) -> bytes:
    subject = [{"name": name, "digest": {"sha256": hashlib.sha256(body).hexdigest()}}]
    told = {"_type": _STATEMENT, "subject": subject, "predicateType": kind, "predicate": predicate}
    return json.dumps(told).encode()


def _bundle(payload: bytes, key: ec.EllipticCurvePrivateKey) -> dict[str, Any]:
    signature = key.sign(_encoded(payload), ec.ECDSA(hashes.SHA256()))
    return {
        "mediaType": _BUNDLE,
        "verificationMaterial": {"publicKey": {"hint": key_id(key.public_key())}, "tlogEntries": []},
        "dsseEnvelope": {
            "payload": base64.b64encode(payload).decode(),
            "payloadType": _PAYLOAD,
            "signatures": [{"sig": base64.b64encode(signature).decode(), "keyid": ""}],
        },
    }


def _opened(bundle: Any, keys: Mapping[str, ec.EllipticCurvePublicKey], place: str) -> tuple[dict[str, Any], str]:
    """The statement of a bundle, and the key that signed it."""
    envelope = bundle["dsseEnvelope"]
    hint = bundle["verificationMaterial"]["publicKey"]["hint"]
    key = keys.get(hint)
    if key is None:
        raise ModelError(f"{place}: signature", f"by the key {str(hint)[:64]}", "one by a trusted key")
    if bundle["mediaType"] != _BUNDLE or envelope["payloadType"] != _PAYLOAD or len(envelope["signatures"]) != 1:
        raise ValueError
    payload = base64.b64decode(envelope["payload"], validate=True)
    try:
        signature = base64.b64decode(envelope["signatures"][0]["sig"], validate=True)
        key.verify(signature, _encoded(payload), ec.ECDSA(hashes.SHA256()))
    except (InvalidSignature, binascii.Error):
        raise ModelError(f"{place}: signature", "not that key's", "one by a trusted key") from None
    statement = parse_json(payload, size=MAX_ENTRY)
    if statement["_type"] != _STATEMENT or not isinstance(statement["predicate"], dict):
        raise ValueError
    return statement, hint


def _encoded(payload: bytes) -> bytes:
    """DSSE's pre-authentication encoding."""
    return f"DSSEv1 {len(_PAYLOAD)} {_PAYLOAD} {len(payload)} ".encode() + payload


def _pem(key: ec.EllipticCurvePublicKey) -> bytes:
    return key.public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)


def _text(time: datetime) -> str:
    return time.astimezone(UTC).isoformat(timespec="seconds")


def _time(text: str) -> datetime:
    time = datetime.fromisoformat(text)
    if time.tzinfo is None:
        raise ValueError
    return time


def _field(number: int, data: bytes) -> bytes:
    return _number(number << 3 | 2) + _number(len(data)) + data


def _number(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes((*out, value))


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for place in range(10):
        byte = data[at + place]
        value |= (byte & 127) << 7 * place
        if byte < 128:
            return value, at + place + 1
    raise ValueError
