"""Every command's help shows how it is called."""

from __future__ import annotations

import pytest
import typer

from skyrelay.cli.main import app


def commands(group, words=("skyrelay",)):
    """Names of all commands, with those of the groups before them."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*words, name))
        else:
            yield " ".join((*words, name)), command


COMMANDS = dict(commands(typer.main.get_command(app)))


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_has_an_example(line):
    assert line in COMMANDS[line].help


def test_all_commands_are_found():
    assert {"skyrelay run", "skyrelay train", "skyrelay models pin", "skyrelay chain gas"} <= set(COMMANDS)
    assert all(isinstance(command.help, str) for command in COMMANDS.values())
