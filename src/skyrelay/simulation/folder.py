"""A run folder appears whole: it is filled beside its place, then renamed."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from skyrelay.core.errors import RunFolderError

MARK = "summary.json"


@contextmanager
def new_run_folder(path: Path, replace: bool = False) -> Iterator[Path]:
    """A folder to fill; on success it becomes ``path``, on any error it is removed.

    Raises:
        RunFolderError: something is at ``path`` that must not be, or may not be, replaced.
    """
    _check(path, replace)
    beside = path.parent / f".{path.name}.partial"
    try:
        shutil.rmtree(beside, ignore_errors=True)  # left by a run that was killed
        beside.mkdir(parents=True)
    except OSError as error:
        raise RunFolderError(path, None, f"a place where a folder can be made ({error.strerror})") from error
    try:
        yield beside
        if path.exists():
            shutil.rmtree(path)
        beside.rename(path)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _check(path: Path, replace: bool) -> None:
    if not path.exists():
        return
    if not path.is_dir() or (any(path.iterdir()) and not (path / MARK).is_file()):
        raise RunFolderError(path, None, "a place for a new run folder; something that is no run folder is there")
    if not replace and any(path.iterdir()):
        raise RunFolderError(path, None, "no run folder there yet: choose another --out, or replace it with --force")
