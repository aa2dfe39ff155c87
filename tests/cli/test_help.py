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


@pytest.mark.parametrize("group", [(), ("chain",), ("models",), ("trace",)])
def test_a_group_alone_prints_its_help(skyrelay, group):
    alone, asked = skyrelay(*group), skyrelay(*group, "--help")
    assert alone.status == 0
    assert alone.err == ""
    assert alone.out == asked.out
    assert len(alone.out.splitlines()) > 8


@pytest.mark.parametrize("line", [(), ("run",), ("chain",), ("chain", "gas"), ("models", "pin"), ("trace", "inspect")])
def test_h_is_help_everywhere(skyrelay, line):
    short = skyrelay(*line, "-h")
    assert short.status == 0
    assert short.out == skyrelay(*line, "--help").out
    assert short.out.startswith(" ".join(("Usage: skyrelay", *line)))


def test_shells_can_complete(skyrelay, monkeypatch):
    assert "--install-completion" in skyrelay("--help").out
    monkeypatch.setenv("_SKYRELAY_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "skyrelay sce")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert skyrelay().out.split() == ["scenario"]


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("rnu",), "'run'"),
        (("chain", "gass"), "'gas'"),
        (("run", "--sead", "3"), "--seed"),
        (("select", "--uavz", "3"), "--uavs"),
        (("evaluate", "genralist"), "'generalist'"),
        (("run", "--set", "coordination.policy=genralist"), "'generalist'"),
    ],
)
def test_what_nearly_fits_is_suggested(skyrelay, tmp_path, monkeypatch, arguments, meant):
    monkeypatch.chdir(tmp_path)
    ended = skyrelay(*arguments)
    assert ended.status == 2
    assert meant in ended.err.splitlines()[-1]


def test_select_says_that_it_draws_and_wants_the_trace_to_exist(skyrelay):
    drawn = skyrelay("select", "--scenario", "bologna", "--vehicles", 5, "--uavs", 2)
    assert drawn.status == 0
    assert "drawn uniformly over 6000 x 6000 m" in drawn.err
    assert skyrelay("select", "--vehicles", 5, "--uavs", 2).err == ""
    missing = skyrelay("select", "--scenario", "bologna", "--set", "mobility.trace=nowhere.csv")
    assert missing.status == 2
    assert "nowhere.csv" in missing.err


@pytest.mark.parametrize(
    "option",
    [("--vehicles", 10**12), ("--uavs", 10**12), ("--vehicles", -1), ("--time-limit", "nan"), ("--time-limit", -1)],
)
def test_a_number_that_nobody_meant_is_one_line(skyrelay, option):
    ended = skyrelay("select", *option)
    assert ended.status == 2
    assert option[0] in ended.err
    assert len(ended.err.splitlines()) == 1
