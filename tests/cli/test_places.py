"""Places that may not be written: one line and status 2 in every command; and what JAX keeps between commands."""

import os
import subprocess
import sys

import pytest
from PIL import Image
from PIL.GifImagePlugin import GifImageFile

from skyrelay.cli.entry import CACHE_BYTES, keep_programs


@pytest.fixture
def blocked(tmp_path):
    """A path under a file: nobody, not even root, can make a folder there."""
    (tmp_path / "file").write_text("a file")
    return tmp_path / "file" / "below"


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "--out"],
        ["run", "--seeds", "2", "--out"],
        ["train", "--steps", "10", "--out"],
        ["reproduce", "gas", "--scale", "smoke", "--out"],
        ["record", "--out"],
        ["up", "--out"],
        ["report"],
        ["audit"],
        ["compare"],
        ["explain"],
    ],
)
def test_a_place_that_cannot_be(skyrelay, blocked, arguments):
    ended = skyrelay(*arguments, blocked)
    assert ended.status == 2
    lines = [line for line in ended.err.splitlines() if line.startswith("skyrelay: ")]
    assert len(lines) == 1
    assert "Traceback" not in ended.err


def test_what_is_compiled_is_kept_unless_told_otherwise(tmp_path):
    told = {"XDG_CACHE_HOME": str(tmp_path)}
    keep_programs(told)
    assert told["JAX_COMPILATION_CACHE_DIR"].endswith("compiled")
    assert told["JAX_COMPILATION_CACHE_MAX_SIZE"] == str(CACHE_BYTES)
    for environment in ({"SKYRELAY_COMPILED": "off"}, {"JAX_COMPILATION_CACHE_DIR": "mine"}):
        asked = dict(environment)
        keep_programs(asked)
        assert asked == environment
    placed = {"SKYRELAY_COMPILED": str(tmp_path / "here")}
    keep_programs(placed)
    assert placed["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path / "here")


def test_the_next_command_finds_what_this_one_compiled(tmp_path):
    """And an episode is drawn as an animation meanwhile."""
    options = ["--episodes", "2", "--uavs", "2", "--vehicles", "3", "--gif", str(tmp_path / "flight.gif")]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}
    environment |= {"SKYRELAY_COMPILED": str(tmp_path / "kept"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    code = "from skyrelay.cli.entry import main; main()"
    command = [sys.executable, "-c", code, "evaluate", "generalist", *options]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    kept = {path.name for path in (tmp_path / "kept").iterdir() if path.name.endswith("-cache")}
    assert kept
    with Image.open(tmp_path / "flight.gif") as animation:
        assert isinstance(animation, GifImageFile)
        assert animation.n_frames > 50
        assert animation.size == (480, 480)
    subprocess.run(command[:-2], env=environment, check=True, capture_output=True)
    assert {path.name for path in (tmp_path / "kept").iterdir() if path.name.endswith("-cache")} == kept


OWN = """
from skyrelay.baselines.player import Static


class Still(Static):
    pass


number = 3
"""


def test_an_own_baseline(tmp_path, skyrelay, monkeypatch):
    (tmp_path / "own_players.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    options = ["--episodes", "3", "--uavs", "2", "--vehicles", "3", "--json"]
    own, static = (skyrelay("baseline", name, *options) for name in ("own_players:Still", "static"))
    assert own.status == static.status == 0
    assert own.out.replace("own_players:Still", "static") == static.out
    assert "of skyrelay.baselines.player.Player" in skyrelay("baseline", "own_players:number", *options).err
