"""A run that was killed goes on: it is played again from its own scenario, and must mine the same blocks again.

A run is a function of its scenario, so that nothing but the scenario is needed to go on; what the killed run had mined
is the check that it is the same run, of the same version (docs/decisions/0056).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from skyrelay.chain.embedded.ledger import FILE_NAME
from skyrelay.core.errors import RunFolderError
from skyrelay.core.scenario import Scenario, load_scenario
from skyrelay.runfolder.folder import CHAIN, SCENARIO

MAX_BYTES = 1 << 30
"""No record of a run that is gone on with is longer."""


@dataclass(frozen=True)
class KilledRun:
    """What a killed run left.

    Attributes:
        scenario: that it played.
        record: the blocks that it had mined, the last perhaps in part.
    """

    scenario: Scenario
    record: bytes

    def check(self, folder: Path) -> None:
        """Whether a run's record begins with what this one had mined.

        Raises:
            RunFolderError: it does not.
        """
        with (folder / CHAIN / FILE_NAME).open("rb") as file:
            again = file.read(len(self.record))
        whole = self.record.rfind(b"\n") + 1
        if again[:whole] != self.record[:whole]:
            pairs = zip(self.record.splitlines(), again.splitlines(), strict=False)
            block = next((number for number, (one, other) in enumerate(pairs) if one != other), "its end")
            raise RunFolderError(
                "--resume",
                f"another block {block}",
                "the blocks that the killed run had mined: inputs changed",
            )


def killed_run(place: Path) -> KilledRun:
    """What a run to ``place`` left beside it when it was killed.

    Raises:
        RunFolderError: nothing is there, or it cannot be gone on with.
    """
    left = [path for path in place.parent.glob(f".{place.name}.*.partial") if (path / SCENARIO).is_file()]
    if not left:
        raise RunFolderError(place, None, "what a killed run to this place left; there is nothing to go on with")
    folder = max(left, key=lambda path: path.stat().st_mtime)
    scenario = load_scenario(folder / SCENARIO)
    if scenario.chain.url is not None:
        raise RunFolderError(
            place, f"a run on {scenario.chain.url}", "one on the embedded chain: a node's blocks cannot be mined again"
        )
    path = folder / CHAIN / FILE_NAME
    if not path.is_file() or path.stat().st_size > MAX_BYTES:
        raise RunFolderError(path, None, f"the killed run's blocks, at most {MAX_BYTES} bytes")
    return KilledRun(scenario, path.read_bytes())
