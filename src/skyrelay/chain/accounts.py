"""Keys of a node's members: one encrypted file, from whose secret every member's key is derived by its name."""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
from pathlib import Path
from typing import Any

import coincurve
from eth_hash.auto import keccak

from skyrelay.core.errors import ChainError
from skyrelay.core.recursion import recursion_limit_kept

with recursion_limit_kept():  # py_ecc, which comes along, raises it to 100,000
    from eth_account import Account
    from eth_account.messages import SignableMessage
    from eth_account.signers.local import LocalAccount

PASSWORD = "SKYRELAY_KEYSTORE_PASSWORD"  # noqa: S105  (the variable's name)
PASSWORD_FILE = "SKYRELAY_KEYSTORE_PASSWORD_FILE"  # noqa: S105


class Keyring:
    """Signs for the members of this host.

    Args:
        secret: 32 bytes; whoever has them has every member's key.
    """

    def __init__(self, secret: bytes) -> None:
        if len(secret) != 32:
            raise ChainError("keyring", f"{len(secret)} bytes", "a secret of 32 bytes")
        self._secret = secret
        self._by_name: dict[str, LocalAccount] = {}
        self._by_address: dict[str, LocalAccount] = {}

    @classmethod
    def ephemeral(cls) -> Keyring:
        """Keys that nobody will have again."""
        return cls(secrets.token_bytes(32))

    @classmethod
    def create(cls, path: Path, password: str) -> Keyring:
        """Write a new keystore file, readable by its owner only.

        Raises:
            ChainError: there is a file already, or it cannot be written.
        """
        secret = secrets.token_bytes(32)
        text = json.dumps(Account.encrypt(secret, password))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        except OSError as error:
            raise ChainError(path, None, f"a place for a new keystore ({error.strerror})") from error
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        return cls(secret)

    @classmethod
    def open(cls, path: Path, password: str | None = None) -> Keyring:
        """Open a keystore file (Web3 Secret Storage).

        Args:
            password: left out: from the environment, as `keystore_password`.
        Raises:
            ChainError: the file is none, or the password is another's.
        """
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ChainError(path, None, "a keystore file that can be read") from error
        given = keystore_password() if password is None else password
        try:
            secret = bytes(Account.decrypt(text, given))
        except (ValueError, KeyError, TypeError, AttributeError):
            # Without the cause: what the library says may quote what it was given.
            raise ChainError(path, None, "a Web3 keystore and its password") from None
        return cls(secret)

    def account(self, name: str) -> str:
        """The address of a member."""
        if name not in self._by_name:
            key = hmac.digest(self._secret, b"skyrelay member " + name.encode(), hashlib.sha256)
            account: LocalAccount = Account.from_key(key)
            self._by_name[name] = account
            self._by_address[account.address.lower()] = account
        return self._by_name[name].address.lower()

    def sign(self, sender: str, to: str | None, data: bytes, gas: int, nonce: int, chain_id: int) -> tuple[str, bytes]:
        """Hash and bytes of a signed legacy transaction of no value at gas price 0.

        Raises:
            ChainError: ``sender`` is no account of this ring.
        """
        account = self._by_address.get(sender)
        if account is None:
            raise ChainError("sender", sender, "an account of this host's keyring")
        fields: dict[str, Any] = {"nonce": nonce, "gasPrice": 0, "gas": gas, "value": 0, "data": data}
        fields["chainId"] = chain_id
        if to is not None:
            fields["to"] = bytes.fromhex(to[2:])
        signed = account.sign_transaction(fields)
        return "0x" + bytes(signed.hash).hex(), bytes(signed.raw_transaction)

    def vouch(self, member: str, message: bytes) -> bytes:
        """A member's signature of a message that is no transaction; see `SigningKey.sign`.

        Raises:
            ChainError: ``member`` is no account of this ring.
        """
        account = self._by_address.get(member)
        if account is None:
            raise ChainError("member", member, "an account of this host's keyring")
        return SigningKey(bytes(account.key)).sign(message)

    def sign_message(self, sender: str, message: SignableMessage) -> bytes:
        """r, s and v of a member's signature of a message (EIP-191, EIP-712).

        Raises:
            ChainError: ``sender`` is no account of this ring.
        """
        account = self._by_address.get(sender)
        if account is None:
            raise ChainError("sender", sender, "an account of this host's keyring")
        return bytes(account.sign_message(message).signature)

    def __repr__(self) -> str:
        return f"Keyring({len(self._by_name)} accounts)"


class SigningKey:
    """A key that signs messages.

    Args:
        secret: 32 bytes; left out: a new key that nobody will have again.
    """

    def __init__(self, secret: bytes | None = None) -> None:
        self._key = coincurve.PrivateKey(secret)
        self.address = _address(self._key.public_key)

    def sign(self, message: bytes) -> bytes:
        """[65] the signature, from which `signer` works out the address.

        What is signed is EIP-191's personal message, so that no signature of a message can pass for a transaction's.
        """
        return self._key.sign_recoverable(_personal(message), hasher=None)

    def __repr__(self) -> str:
        return f"SigningKey({self.address})"


def signer(message: bytes, signature: bytes) -> str | None:
    """The address whose key has signed the message; None where the 65 bytes are no signature.

    Any other bytes give another address: whoever asks has to know whom to expect.
    """
    return recovered(_personal(message), signature)


def recovered(digest: bytes, signature: bytes) -> str | None:
    """The address whose key has signed a digest: r, s and the parity, 65 bytes; None where they are no signature."""
    try:
        return _address(coincurve.PublicKey.from_signature_and_message(signature, digest, hasher=None))
    except ValueError:
        return None


def _personal(message: bytes) -> bytes:
    return keccak(b"\x19Ethereum Signed Message:\n" + str(len(message)).encode() + message)


def _address(key: coincurve.PublicKey) -> str:
    return "0x" + keccak(key.format(compressed=False)[1:])[12:].hex()


def keystore_password() -> str:
    """The password from the environment: itself, or the name of a file that has it on its first line.

    Raises:
        ChainError: neither variable is set, or the file cannot be read.
    """
    if PASSWORD in os.environ:
        return os.environ[PASSWORD]
    name = os.environ.get(PASSWORD_FILE)
    if name is None:
        raise ChainError("environment", None, f"{PASSWORD} or {PASSWORD_FILE}, to open the keystore")
    try:
        return Path(name).read_text(encoding="utf-8").split("\n", 1)[0]
    except (OSError, UnicodeDecodeError) as error:
        raise ChainError(PASSWORD_FILE, name, "a file that can be read, with the password on its first line") from error
