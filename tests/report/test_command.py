"""The command draws a run folder again."""

from __future__ import annotations

import shutil
from pathlib import Path

import typer
from typer.testing import CliRunner

from skyrelay.cli.report import command


def test_draws_everything_again(recorded: Path, tmp_path: Path) -> None:
    run = shutil.copytree(recorded, tmp_path / "run")
    app = typer.Typer()
    app.command()(command)
    result = CliRunner().invoke(app, [str(run)])
    assert result.exit_code == 0
    printed = [Path(line) for line in result.output.split()]
    assert len(printed) == 11
    assert all(path.stat().st_size > 1000 for path in printed)
    assert printed[-1] == run / "report.html"
