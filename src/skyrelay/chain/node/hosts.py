"""A consortium's validators on several hosts: a folder for each, with all that it starts from.

What a host needs of the others is public: addresses, the nodes' public keys, the genesis. A host that names its public
key makes and keeps its node key itself; of the others the key is made here, which is enough where one party founds the
network.
"""

from __future__ import annotations

import ipaddress
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tomli_w
from eth_keys.datatypes import PublicKey
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from skyrelay.chain.node.devnet import Validator, fresh_key, genesis_of, node_config, write_keystore, write_secret
from skyrelay.core.errors import UsageError
from skyrelay.core.files import write_text
from skyrelay.core.folders import new_folder
from skyrelay.core.untrusted import parse_toml

MAX_BYTES = 2**20
_NAME = r"^[a-z0-9]([a-z0-9.-]{0,62})$"
_Port = Annotated[int, Field(ge=1, le=65_535)]


class Host(BaseModel):
    """One host of the file; ``address`` is an IP address that the others reach, `public_key` 128 hexadecimal digits."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    name: Annotated[str, Field(pattern=_NAME)]
    address: str
    p2p_port: _Port = 30_303
    rpc_port: _Port = 8_545
    public_key: str | None = None

    @field_validator("address")
    @classmethod
    def _an_address(cls, text: str) -> str:
        try:
            one = ipaddress.ip_address(text)
        except ValueError:
            raise ValueError("an IP address (nodes do not look names up)") from None
        if one.is_unspecified or one.is_multicast or "%" in text:
            raise ValueError("the address of one host")
        return str(one)

    @field_validator("public_key")
    @classmethod
    def _a_point(cls, text: str | None) -> str | None:
        if text is None:
            return None
        digits = text.lower().removeprefix("0x")
        if not re.fullmatch(r"[0-9a-f]{128}", digits) or not _on_curve(int(digits[:64], 16), int(digits[64:], 16)):
            raise ValueError("128 hexadecimal digits of a secp256k1 public key")
        return digits


class _File(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    chain_id: Annotated[int, Field(ge=1, lt=2**32)] = 1337
    period: Annotated[int, Field(ge=1, le=60)] = 1
    host: Annotated[list[Host], Field(min_length=1, max_length=32)]


@dataclass(frozen=True, slots=True)
class Founded:
    """What was written.

    Attributes:
        chain_id: of the network.
        validators: by the host's name.
        keyless: hosts that have to put their own node key in.
    """

    chain_id: int
    validators: dict[str, Validator]
    keyless: tuple[str, ...]


def write_hosts(directory: Path, file: Path) -> Founded:
    """Write a folder for each host of ``file``, and the operator's keystore; nothing runs.

    Args:
        directory: absent or empty.
        file: TOML: ``chain_id``, ``period`` [s], and ``[[host]]`` with name, address, p2p_port, rpc_port, public_key.
    Raises:
        UsageError: the file does not fit.
        RunFolderError: the folder is not empty, or cannot be written.
    """
    told = _read(file)
    keys = {host.name: None if host.public_key else fresh_key() for host in told.host}
    nodes = []
    for host in told.host:
        key = keys[host.name]
        public = host.public_key if key is None else key.public_key
        assert public is not None  # noqa: S101
        address = PublicKey(bytes.fromhex(public)).to_checksum_address()
        nodes.append(Validator(0, address, public, host.rpc_port, host.p2p_port, 0, host.address))
    # QBFT lists the validators in the order of their addresses.
    order = sorted(range(len(nodes)), key=lambda place: nodes[place].address.lower())
    with new_folder(directory) as root:
        genesis = genesis_of("qbft", [nodes[place].address for place in order], told.chain_id, told.period)
        write_keystore(root / "accounts", "operator", fresh_key())
        for host, node in zip(told.host, nodes, strict=True):
            home = root / "hosts" / host.name
            (home / "geth").mkdir(parents=True)
            home.chmod(0o700)
            key = keys[host.name]
            if key is not None:
                write_secret(home / "geth" / "nodekey", key.secret.hex())
            write_text(home / "genesis.json", json.dumps(genesis, indent=2) + "\n")
            write_text(
                home / "config.toml", tomli_w.dumps(node_config("qbft", node, nodes, told.chain_id, told.period))
            )
            write_text(home / "start.sh", _START)
            (home / "start.sh").chmod(0o755)
            write_text(home / "skyrelay-validator.service", _UNIT.format(name=host.name, folder=_PLACE))
    validators = {host.name: node for host, node in zip(told.host, nodes, strict=True)}
    return Founded(told.chain_id, validators, tuple(host.name for host in told.host if host.public_key))


def _read(file: Path) -> _File:
    try:
        with file.open("rb") as source:
            content = source.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise UsageError(file, f"over {MAX_BYTES} bytes", "a list of hosts")
        told = _File.model_validate(parse_toml(content.decode("utf-8")))
    except OSError as error:
        raise UsageError(file, error.strerror, "a readable TOML file") from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        expected = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
        value = None if first["type"] in ("missing", "extra_forbidden") else first["input"]
        raise UsageError(f"{file}: {key}", value, expected) from None
    except ValueError as error:
        raise UsageError(file, None, f"TOML ({error})") from None
    _distinct(file, "name", [host.name for host in told.host])
    _distinct(file, "public_key", [host.public_key for host in told.host if host.public_key])
    for port in ("p2p_port", "rpc_port"):
        _distinct(file, f"address and {port}", [(host.address, getattr(host, port)) for host in told.host])
    return told


def _distinct(file: Path, what: str, values: Sequence[object]) -> None:
    for place, value in enumerate(values):
        if value in values[:place]:
            raise UsageError(f"{file}: {what}", value, "each host's own")


def _on_curve(x: int, y: int) -> bool:
    field = 2**256 - 2**32 - 977
    return x < field and y < field and (y * y - x * x * x - 7) % field == 0


_PLACE = "/var/lib/skyrelay-validator"

_START = """#!/bin/sh
# Starts this host's validator; the first start writes the genesis block. GOQUORUM names the node program.
set -eu
cd "$(dirname "$0")"
program=${GOQUORUM:-goquorum}
if [ ! -s geth/nodekey ]; then
    echo "geth/nodekey is missing: put this host's own node key there (64 hexadecimal digits)" >&2
    exit 2
fi
chmod 600 geth/nodekey
export PRIVATE_CONFIG=ignore
[ -d geth/chaindata ] || "$program" --datadir . init genesis.json
exec "$program" --datadir . --config config.toml --mine --nat none --verbosity 3
"""

_UNIT = """[Unit]
Description=SkyRelay validator {name}
After=network-online.target
Wants=network-online.target

[Service]
# The folder lies at {folder}, goquorum on PATH; where not, change the lines (Environment=GOQUORUM=...).
WorkingDirectory={folder}
ExecStart={folder}/start.sh
User=skyrelay
Restart=always
RestartSec=5
NoNewPrivileges=true
ProtectSystem=strict
ReadWritePaths={folder}

[Install]
WantedBy=multi-user.target
"""
