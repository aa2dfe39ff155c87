"""`skyrelay reproduce` as a user calls it."""

import json

import pytest
import typer
from typer.testing import CliRunner

from skyrelay.cli import reproduce
from skyrelay.core.errors import RunFolderError, UsageError
from skyrelay.experiments import selection

app = typer.Typer()
app.command()(reproduce.command)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(selection, "_SCALES", {"smoke": ((20,), 2)})


def test_figures_are_listed():
    assert "selection-weights" in CliRunner().invoke(app, ["--list"]).stdout


def test_json_names_folder_files_and_findings_and_another_scale_is_refused_there(tmp_path, monkeypatch):
    arguments = ["selection", "--scale", "smoke", "--out", str(tmp_path), "--json"]
    result = json.loads(CliRunner().invoke(app, arguments, catch_exceptions=False).stdout)
    assert result["selection"]["folder"] == str(tmp_path / "selection-smoke")
    assert {finding["verdict"] for finding in result["selection"]["findings"]} <= {
        "holds",
        "holds in part",
        "does not hold",
    }
    assert (tmp_path / "claims.md").read_text().startswith("# The paper's claims, measured")
    manifest = json.loads((tmp_path / "selection-smoke" / "manifest.json").read_text())
    assert manifest["command"] == "skyrelay reproduce selection --scale smoke"
    monkeypatch.setattr(selection, "_SCALES", {"smoke": ((20,), 3)})
    with pytest.raises(RunFolderError, match=r"manifest\.json: tasks"):
        CliRunner().invoke(app, arguments, catch_exceptions=False)


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["selectoin"], UsageError),
        (["selection", "--scale", "tiny"], UsageError),
        (["selection", "nothing"], UsageError),
    ],
)
def test_bad_input_is_refused_before_anything_is_written(tmp_path, arguments, fault):
    with pytest.raises(fault):
        CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")], catch_exceptions=False)
    assert not (tmp_path / "out").exists()
