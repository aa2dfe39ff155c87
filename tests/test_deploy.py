"""Container files and services say what the command line takes; no engine runs them here."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from skyrelay.cli.main import app

ROOT = Path(__file__).parents[1]
UNITS = sorted((ROOT / "deploy" / "systemd").glob("*.service"))


def takes(words):
    """Whether the command line has such a command with such options."""
    command: Any = typer.main.get_command(app)
    while words and words[0] in getattr(command, "commands", {}):
        command, words = command.commands[words[0]], words[1:]
    known = {option for parameter in command.params for option in parameter.opts}
    return not hasattr(command, "commands") and {word for word in words if word.startswith("--")} <= known


def compose():
    return yaml.safe_load((ROOT / "compose.yaml").read_text())


def test_the_services_call_commands_that_exist():
    services = compose()["services"]
    assert set(services) == {"validators", "kubo", "agents", "page"}
    assert takes(services["validators"]["command"][1:])
    assert takes(services["validators"]["healthcheck"]["test"][2:])
    assert takes(services["agents"]["command"])
    assert takes(services["page"]["command"])


def test_the_services_hang_together():
    whole = compose()
    for service in whole["services"].values():
        assert set(service.get("depends_on", ())) <= set(whole["services"])
        assert {volume.split(":")[0] for volume in service.get("volumes", ())} <= set(whole["volumes"])
        assert service["read_only"]
        assert service["cap_drop"] == ["ALL"]
        if "build" in service:
            assert (ROOT / service["build"]["dockerfile"]).exists()


@pytest.mark.parametrize("name", ["Dockerfile", "Dockerfile.nodes"])
def test_what_an_image_copies_is_in_the_context(name):
    allowed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    for line in re.findall(r"^COPY (?!--from)(.*)$", (ROOT / "deploy" / name).read_text(), re.MULTILINE):
        for source in line.split()[:-1]:
            assert source in allowed, source
            assert (ROOT / source).exists(), source


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_calls_a_command_that_exists(unit):
    (line,) = re.findall(r"^ExecStart=/opt/skyrelay/bin/skyrelay (.*)$", unit.read_text(), re.MULTILINE)
    assert takes(line.split())
    assert "RestartPreventExitStatus=2" in unit.read_text()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_takes_the_units(tmp_path):
    for unit in UNITS:
        # The program is not installed where the tests run.
        text = unit.read_text().replace("/opt/skyrelay/bin/skyrelay", shutil.which("true") or "")
        (tmp_path / unit.name.replace("@.", "@uav.")).write_text(text)
    line = ["systemd-analyze", "verify", *map(str, sorted(tmp_path.iterdir()))]
    told = subprocess.run(line, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr
    assert str(tmp_path) not in told.stderr  # a complaint names the unit


@pytest.mark.parametrize(
    "form", sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml")), ids=lambda form: form.stem
)
def test_issue_forms_are_well_formed(form):
    told = yaml.safe_load(form.read_text())
    if form.stem == "config":
        return
    assert told["name"]
    assert told["description"]
    ids = [field["id"] for field in told["body"]]
    assert len(ids) == len(set(ids))
    assert all(field["type"] in ("input", "textarea") and field["attributes"]["label"] for field in told["body"])
