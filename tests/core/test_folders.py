import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from skyrelay.core.errors import RunFolderError
from skyrelay.core.folders import exclusive, new_folder, sole_writer

KILLS = Path(__file__).with_name("folder_kills.py")
FILL = """
import sys
from pathlib import Path
from skyrelay.core.folders import new_folder
with new_folder(Path(sys.argv[1])) as folder:
    (folder / "mine").write_text("first")
    print("filling", flush=True)
    sys.stdin.readline()
"""


def kills(tmp_path, way):
    done = subprocess.run([sys.executable, KILLS, tmp_path, way], capture_output=True, text=True, check=True)
    points = [json.loads(line) for line in done.stdout.splitlines()]
    assert points[-1]["end"]
    assert len(points) > 50  # lines, not operations: every operation of the way is between two of them
    return points


def test_killed_at_any_point_the_old_or_the_new_folder_is_whole_at_its_place(tmp_path):
    points = kills(tmp_path, "exchange")
    assert {point["killed"] for point in points} == {"old", "new"}
    assert points[-1]["killed"] == "new"
    assert all(point["next"] == point["killed"] and not point["beside"] for point in points)


def test_where_folders_cannot_be_exchanged_the_next_call_brings_the_old_one_back(tmp_path):
    points = kills(tmp_path, "renames")
    seen = Counter(point["killed"] for point in points)
    assert set(seen) == {"old", "new", "absent"}
    assert seen["absent"] <= 3  # between the two renames
    for point in points:
        assert point["next"] == ("old" if point["killed"] == "absent" else point["killed"])
        assert not point["beside"]


def test_of_two_at_once_the_second_is_told_and_the_first_goes_on(tmp_path):
    place = tmp_path / "run"
    first = subprocess.Popen(
        [sys.executable, "-c", FILL, place], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with first:
        assert first.stdout.readline() == "filling\n"
        with pytest.raises(RunFolderError, match="in use"), new_folder(place):
            pytest.fail("the second was let in")
        with new_folder(tmp_path / "run2") as other:  # another place, beside the first one's
            (other / "mine").write_text("second")
        first.communicate("\n")
    assert first.returncode == 0
    assert (place / "mine").read_text() == "first"
    assert (tmp_path / "run2" / "mine").read_text() == "second"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "run2"]


def test_what_a_killed_process_left_is_removed_but_not_what_another_place_needs(tmp_path):
    first = subprocess.Popen([sys.executable, "-c", FILL, tmp_path / "run"], stdin=subprocess.PIPE, stdout=-1)
    with first:
        assert first.stdout.readline() == b"filling\n"
        first.kill()
    left = {path.name for path in tmp_path.iterdir()}
    assert len(left) == 2  # the folder that it filled, and the file that it had locked
    with new_folder(tmp_path / "run2") as folder:
        (folder / "mine").write_text("second")
    assert {path.name for path in tmp_path.iterdir()} == left | {"run2"}
    with new_folder(tmp_path / "run") as folder:
        (folder / "mine").write_text("again")
    assert {path.name for path in tmp_path.iterdir()} == {"run", "run2"}


def test_what_came_to_the_place_meanwhile_is_not_replaced(tmp_path):
    def fill():
        with new_folder(tmp_path / "run") as folder:
            (folder / "mine").write_text("new")
            (tmp_path / "run").mkdir()
            (tmp_path / "run" / "thesis.tex").write_text("dear")

    with pytest.raises(RunFolderError, match="not empty"):
        fill()
    assert (tmp_path / "run" / "thesis.tex").read_text() == "dear"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_link_is_followed_and_stays(tmp_path):
    (tmp_path / "latest").symlink_to(tmp_path / "run-7")
    with new_folder(tmp_path / "latest") as folder:
        (folder / "mine").write_text("new")
    assert (tmp_path / "latest").is_symlink()
    assert (tmp_path / "run-7" / "mine").read_text() == "new"


def test_a_lock_file_that_somebody_left_means_nothing(tmp_path):
    (tmp_path / ".lock").write_text("")
    with sole_writer(tmp_path), pytest.raises(RunFolderError, match="in use"), sole_writer(tmp_path):
        pytest.fail("the second was let in")
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file" / "run", tmp_path / ("n" * 250), Path("/")):
        with pytest.raises(RunFolderError, match="a place where a folder can be made"), new_folder(place):
            pytest.fail("there is no such place")
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RunFolderError), exclusive(tmp_path / "link", tmp_path):
        pytest.fail("a lock is no link")
