"""What the docs say of the code is what the code says of itself."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer

from skyrelay.cli.main import app
from skyrelay.core.scenario import load_scenario, to_commented_toml
from skyrelay.protocol.sequence import UAV, VEHICLE, ZONE, UavState, VehicleState, ZoneState, to_mermaid
from skyrelay.runfolder.schema import SCHEMAS

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def page(name):
    return (ROOT / "docs" / name).read_text()


def test_the_scenario_page_shows_every_key_with_its_default():
    assert to_commented_toml(load_scenario()) in page("reference/scenario.md")


def test_the_run_folder_page_names_every_table_and_column():
    text = page("reference/run-folder.md")
    for name, schema in SCHEMAS.items():
        (row,) = re.findall(rf"^\| `{name}\.parquet` .*$", text, re.MULTILINE)
        for field in schema:
            assert f"`{field.name}`" in row


@pytest.mark.parametrize(
    ("table", "start"), [(VEHICLE, VehicleState.NEW), (UAV, UavState.NEW), (ZONE, ZoneState.COLLECTING)]
)
def test_the_sequence_page_shows_the_tables(table, start):
    assert to_mermaid(table, start) in page("reference/sequence.md")


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(path):
    for target in re.findall(r"\]\(([^)#\s]+)", path.read_text()):
        if not target.startswith(("http://", "https://", "mailto:")):
            assert (path.parent / target).exists(), f"{path.name} links to {target}"


def test_every_path_of_the_paper_map_exists():
    for target in re.findall(r"`((?:src|contracts|tests|benchmarks)/[^`]+)`", page("paper-map.md")):
        assert (ROOT / target).exists(), target


def _snippets(path):
    return re.findall(r"^```python\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("path", [pytest.param(path, id=path.stem) for path in PAGES if _snippets(path)])
def test_every_python_snippet_runs(path, tmp_path):
    # Those of a page one after the other, as a reader would type them.
    line = [sys.executable, "-c", "\n".join(_snippets(path))]
    ended = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def _commands():
    """Every `skyrelay ...` line of the shell blocks of every page."""
    for path in PAGES:
        for block in re.findall(r"^```(?:sh)?\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL):
            for line in block.replace("\\\n", " ").splitlines():
                if line.startswith("skyrelay "):
                    yield path.relative_to(ROOT), line.split(" > ")[0].split(" #")[0]


@pytest.mark.parametrize(("path", "line"), [pytest.param(*both, id=both[1]) for both in _commands()])
def test_every_command_in_the_docs_exists_with_its_options(path, line):
    command: Any = typer.main.get_command(app)
    words = re.sub(r"[\[\]|]", " ", line).split()[1:]  # [--optional] options as a usage line shows them
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]
    assert not hasattr(command, "commands"), f"{path}: no such command: {line}"
    known = {option for parameter in command.params for option in parameter.opts}
    for word in words:
        if word.startswith("--"):
            assert word.partition("=")[0] in known, f"{path}: {word}"
