"""Folders appear whole or not at all: filled beside their place under a lock, then put there by one rename.

Beside a place ``run`` may lie, all of them hidden and named after it:

- ``.run.lock``: held by the one process that fills a folder for this place. The lock goes with the process; the file
  alone, left by one that was killed, means nothing.
- ``.run.<16 hex digits>.partial``: being filled, or being deleted. Without the lock's holder it is rubbish.
- ``.run.<16 hex digits>.old``: the old folder, whole, while the new one is put in by two renames. It comes back if
  that was cut short.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from skyrelay.core.errors import RunFolderError

LOCK = ".lock"
"""In a folder with a sole writer."""

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
_CANNOT_EXCHANGE = {errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP, errno.EPERM}


def _anything_empty(path: Path) -> None:
    """A place without a folder, or with an empty one, may be filled."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise RunFolderError(path, "not empty", "a folder that is absent or empty")


@contextmanager
def new_folder(path: Path, check: Callable[[Path], None] = _anything_empty) -> Iterator[Path]:
    """A folder to fill; on success it becomes ``path``, on any error it is removed.

    A process that is killed, at whatever point, leaves the old folder or the new one whole at ``path``; where the
    system cannot exchange two folders in one step, the next call for the same place puts the old one back. What killed
    processes left beside the place is removed.

    Args:
        path: the place; a link is followed.
        check: called with ``path`` before the filling and again before the new folder is put in; raises where what is
            there may not be replaced.
    Raises:
        RunFolderError: another process is filling a folder for this place, or none can be made there.
    """
    place = Path(os.path.realpath(path))
    with _named(path):
        lock = place.with_name(f".{place.name}.lock")
        place.parent.mkdir(parents=True, exist_ok=True)
    with exclusive(lock, path):
        with _named(path):
            _tidy(place)
            check(path)
            partial = _hidden(place, "partial")
            partial.mkdir()
        try:
            yield partial
            with _named(path):
                check(path)
                _put(partial, place)
        finally:
            with suppress(OSError):
                _tidy(place)


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Make ``folder`` where it is absent and be the only one who writes there: for results that grow, step by step.

    Raises:
        RunFolderError: another process writes there, or the folder cannot be made or written.
    """
    with _named(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with exclusive(folder / LOCK, folder):
        yield


@contextmanager
def exclusive(lock: Path, place: Path) -> Iterator[None]:
    """Hold ``lock``, a file that nothing is written to, for this process alone.

    Args:
        place: what the lock is for, as the error names it.
    Raises:
        RunFolderError: another process holds it, or there cannot be such a file.
    """
    with _named(place):
        descriptor = _locked(lock, place)
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink()  # while it is held: who waits for the old file sees that it is gone
        os.close(descriptor)


def _locked(lock: Path, place: Path) -> int:
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(descriptor), lock.stat()):
                return descriptor
        except BlockingIOError:
            os.close(descriptor)
            raise RunFolderError(place, "in use", "a folder that no other process is writing to") from None
        except FileNotFoundError:
            pass  # its holder removed it between the two calls
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _put(partial: Path, place: Path) -> None:
    """Put a whole folder where another one, or none, is."""
    if not place.exists() or not any(place.iterdir()):
        partial.rename(place)
        return
    try:
        _exchange(partial, place)
    except OSError as error:
        if error.errno not in _CANNOT_EXCHANGE:
            raise
        aside = _hidden(place, "old")
        place.rename(aside)
        partial.rename(place)
        aside.rename(partial)  # so that nothing called old is ever half deleted


def _exchange(one: Path, other: Path) -> None:
    """Two folders change places in one step, where Linux and the file system can (renameat2)."""
    library = ctypes.CDLL(None, use_errno=True)
    rename = getattr(library, "renameat2", None)
    if rename is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE):
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code), str(other))


def _tidy(place: Path) -> None:
    """Under the lock: bring back an old folder whose successor never arrived, delete what is left beside the place."""
    ours = re.compile(rf"\.{re.escape(place.name)}\.[0-9a-f]{{16}}\.(partial|old)")
    for leftover in sorted(place.parent.iterdir()):
        match = ours.fullmatch(leftover.name)
        if match is None:
            continue
        if match[1] == "old":
            if not place.exists():
                leftover.rename(place)
                continue
            leftover = leftover.rename(_hidden(place, "partial"))
        shutil.rmtree(leftover, ignore_errors=True)


def _hidden(place: Path, kind: str) -> Path:
    return place.with_name(f".{place.name}.{secrets.token_hex(8)}.{kind}")


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """A fault of the file system, in one line."""
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a path without a name
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise RunFolderError(path, None, f"a place where a folder can be made ({reason})") from error
