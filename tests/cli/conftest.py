import sys
from dataclasses import dataclass

import pytest

from skyrelay.cli.main import main


@dataclass
class Ended:
    status: int | str | None
    out: str
    err: str


@pytest.fixture
def skyrelay(capsys, monkeypatch):
    """Run the command as the console script does, in this process."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["skyrelay", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return Ended(ended.value.code, captured.out, captured.err)

    return run
