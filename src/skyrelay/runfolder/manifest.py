"""The manifest of a run folder: every file's SHA-256 and size, signed by the run's coordinator where it has a key."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrelay.core.errors import RunFolderError
from skyrelay.core.files import write_text
from skyrelay.core.untrusted import read_json

MANIFEST = "manifest.json"
_MAX_BYTES = 64 * 2**20

Signer = Callable[[bytes], tuple[str, bytes]]
"""From a message to the address that signs it and its signature."""


class Entry(BaseModel):
    """A file."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    bytes: Annotated[int, Field(ge=0)]


class Manifest(BaseModel):
    """``manifest.json``."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    files: dict[str, Entry]
    signer: str | None
    signature: Annotated[str, Field(pattern=r"^[0-9a-f]{130}$")] | None

    @property
    def message(self) -> bytes:
        """What is signed: the files, in one spelling."""
        files = {name: entry.model_dump() for name, entry in self.files.items()}
        return b"skyrelay run folder " + json.dumps(files, sort_keys=True, separators=(",", ":")).encode()


def write_manifest(folder: Path, sign: Signer | None) -> None:
    """Write the manifest of a folder that is complete; ``sign`` is None where the run's chain has no keys."""
    unsigned = Manifest(files=entries(folder), signer=None, signature=None)
    signed = unsigned
    if sign is not None:
        address, signature = sign(unsigned.message)
        signed = Manifest(files=unsigned.files, signer=address, signature=signature.hex())
    write_text(folder / MANIFEST, json.dumps(signed.model_dump(), indent=1) + "\n")


def read_manifest(folder: Path) -> Manifest:
    """The manifest as it lies there.

    Raises:
        RunFolderError: it is missing, too long, or no manifest.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise RunFolderError(path, None, "a file of the run folder; it is not there")
    try:
        return Manifest.model_validate(read_json(path, size=_MAX_BYTES))
    except ValidationError as error:
        fault = error.errors()[0]
        raise RunFolderError(f"{path}: {'.'.join(map(str, fault['loc']))}", None, fault["msg"]) from None
    except (OSError, ValueError) as error:
        raise RunFolderError(path, None, f"a readable manifest ({error})") from error


def entries(folder: Path) -> dict[str, Entry]:
    """Every file of the folder but the manifest, by its path there."""
    found: dict[str, Entry] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != MANIFEST:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            found[name] = Entry(sha256=digest, bytes=path.stat().st_size)
    return found
