"""What a run folder's files are called, and where it may be put."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

from skyrelay.core.errors import RunFolderError
from skyrelay.core.folders import new_folder

SCENARIO = "scenario.toml"
SUMMARY = "summary.json"
CHAIN = "chain"
"""Folder of the embedded chain's record."""
STORE = "store"
"""Folder of the policies' blocks."""


def new_run_folder(path: Path, replace: bool = False) -> AbstractContextManager[Path]:
    """A folder to fill; on success it becomes ``path``, on any error it is removed (`skyrelay.core.folders`).

    Raises:
        RunFolderError: something is at ``path`` that must not be, or may not be, replaced, or another run is on the
            way there.
    """

    def check(place: Path) -> None:
        if not place.exists():
            return
        if not place.is_dir() or (any(place.iterdir()) and not (place / SUMMARY).is_file()):
            raise RunFolderError(place, None, "a place for a new run folder; something that is no run folder is there")
        if not replace and any(place.iterdir()):
            raise RunFolderError(
                place, None, "no run folder there yet: choose another --out, or replace it with --force"
            )

    return new_folder(path, check)
