"""A run's record: what its files are called and hold, how they are written, and how they are read by who trusts none.

Whoever writes a run's record does it through `writer`, whoever reads it through `reader`; `schema` alone knows the
columns and keys, and docs/reference/run-folder.md says the same for people.
"""

from skyrelay.runfolder.folder import new_run_folder
from skyrelay.runfolder.reader import Run, read_rows, read_run

__all__ = ["Run", "new_run_folder", "read_rows", "read_run"]
