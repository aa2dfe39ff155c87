"""The journal of signed transactions: what a client was told is taken is on the disk."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Sequence
from pathlib import Path

from skyrelay.chain.signed import SignedTransaction, read_signed
from skyrelay.core.errors import ChainError


class Journal:
    """Signed transactions in the order of arrival, one hexadecimal line each; only ever appended to."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("a+b", buffering=0)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ChainError(
                path, None, f"a file of this process alone that can be written ({error.strerror})"
            ) from None

    def entries(self) -> list[SignedTransaction]:
        """All of them; an unfinished last line, of one that nobody was told of, is cut off."""
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        self._file.truncate(whole)
        found = []
        for number, line in enumerate(content[:whole].splitlines(), 1):
            try:
                found.append(read_signed(bytes.fromhex(line.decode("ascii"))))
            except (ValueError, ChainError) as error:
                raise ChainError(f"{self._path}:{number}", None, "a signed transaction") from error
        return found

    def append(self, transactions: Sequence[SignedTransaction]) -> None:
        """Add them; they are on the disk when this returns.

        Raises:
            ChainError: the disk took less than all.
        """
        content = b"".join(transaction.raw.hex().encode() + b"\n" for transaction in transactions)
        end = os.fstat(self._file.fileno()).st_size
        try:
            written = 0
            while written < len(content):
                written += os.write(self._file.fileno(), content[written:])
            os.fsync(self._file.fileno())
        except OSError as error:
            self._file.truncate(end)
            raise ChainError(self._path, None, f"room for more transactions ({error.strerror})") from error

    def close(self) -> None:
        """Let others open it."""
        self._file.close()
