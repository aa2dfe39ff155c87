"""The runner: resume after a kill, refusal of foreign folders, equal results in-process and on Ray."""

import json
import math
import subprocess
import sys

import pyarrow.parquet as pq
import pytest

from skyrelay.core.errors import RunFolderError, UsageError
from skyrelay.experiments.runner import Experiment, Task, run


def experiment(count=5, function="runner_tasks:draw", name="sample", **settings):
    tasks = [Task(f"seed-{seed}", {"seed": seed, **settings}) for seed in range(count)]
    return Experiment(name, function, tasks)


class Seen:
    """A progress that remembers what it was told."""

    def __init__(self):
        self.calls = []

    def stage(self, name, total):
        self.calls.append((name, total))

    def advance(self, steps=1):
        self.calls.append(steps)


def test_rows_of_all_tasks_in_their_order(tmp_path):
    seen = Seen()
    table = run(experiment(), tmp_path / "out", progress=seen)
    assert table["seed"].to_pylist() == [seed for seed in range(5) for _ in range(3)]
    assert seen.calls == [("sample", 5), 0, 1, 1, 1, 1, 1]
    assert pq.read_table(tmp_path / "out" / "results.parquet").equals(table)


def test_every_kind_of_number_survives(tmp_path):
    row = run(experiment(1, "runner_tasks:special"), tmp_path / "out").to_pylist()[0]
    assert math.isnan(row.pop("nan"))
    assert row == {"seed": 0, "missing": None, "tiny": 5e-324, "third": 1 / 3, "whole": 2**53 + 1}


def test_a_finished_folder_runs_nothing_again(tmp_path):
    marks = tmp_path / "marks"
    marks.mkdir()
    same = experiment(4, "runner_tasks:leave_a_mark", folder=str(marks))
    first = run(same, tmp_path / "out")
    assert run(same, tmp_path / "out").equals(first)
    assert len(list(marks.iterdir())) == 4


def test_a_killed_run_goes_on_where_it_was(tmp_path):
    switch = tmp_path / "switch"
    switch.touch()
    fatal = experiment(6, "runner_tasks:die_at", fatal=3, switch=str(switch))
    code = (
        "import sys; from pathlib import Path; from skyrelay.experiments.runner import *; "
        f"run(Experiment('sample', 'runner_tasks:die_at', [Task(f'seed-{{s}}', dict(seed=s, fatal=3, "
        f"switch={str(switch)!r})) for s in range(6)]), Path(sys.argv[1]))"
    )
    killed = subprocess.run([sys.executable, "-c", code, str(tmp_path / "out")], check=False)
    assert killed.returncode == -9
    journal = tmp_path / "out" / "journal.jsonl"
    assert [json.loads(line)["task"] for line in journal.read_text().splitlines()] == ["seed-0", "seed-1", "seed-2"]
    assert not (tmp_path / "out" / "results.parquet").exists()
    with journal.open("a") as file:
        file.write('{"task": "seed-3", "ro')  # a line that the kill has cut off
    switch.unlink()
    seen = Seen()
    resumed = run(fatal, tmp_path / "out", progress=seen)
    assert seen.calls == [("sample", 6), 3, 1, 1, 1]
    assert resumed.equals(run(experiment(6), tmp_path / "whole"))


def test_the_folder_of_another_experiment_is_refused(tmp_path):
    run(experiment(3), tmp_path / "out")
    with pytest.raises(RunFolderError, match=r"manifest.json: tasks: is '3 tasks .*expected 4 tasks"):
        run(experiment(4), tmp_path / "out")
    with pytest.raises(RunFolderError, match=r"manifest\.json: experiment"):
        run(experiment(3, name="other"), tmp_path / "out")


def test_the_manifest_says_what_is_run(tmp_path):
    run(experiment(2), tmp_path / "out", command="skyrelay reproduce it")
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["command"] == "skyrelay reproduce it"
    assert manifest["function"] == "runner_tasks:draw"
    assert set(manifest["versions"]) == {"skyrelay", "python", "numpy", "scipy"}
    assert manifest["tasks"] == {"seed-0": {"seed": 0}, "seed-1": {"seed": 1}}


def test_settings_that_all_tasks_share_stand_in_the_manifest_once():
    shared = Experiment(
        "sample", "m:f", [Task("a", {"seed": 1, "v": [5]}), Task("b", {"seed": 2, "v": [5]})]
    ).manifest()
    assert shared["common_settings"] == {"v": [5]}
    assert shared["tasks"] == {"a": {"seed": 1}, "b": {"seed": 2}}


def test_a_folder_with_other_files_is_refused_and_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(RunFolderError, match="expected an empty folder"):
        run(experiment(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("file", "content", "place"),
    [
        ("manifest.json", "{", "manifest.json"),
        ("manifest.json", "[]", "manifest.json: experiment"),
        ("journal.jsonl", "{}\n", "journal.jsonl: line 1"),
        ("journal.jsonl", '{"task": "seed-9", "rows": []}\n', "journal.jsonl: line 1: task"),
    ],
)
def test_a_damaged_folder_is_named(tmp_path, file, content, place):
    run(experiment(), tmp_path / "out")
    (tmp_path / "out" / file).write_text(content)
    with pytest.raises(RunFolderError) as fault:
        run(experiment(), tmp_path / "out")
    assert fault.value.place.endswith(place)


def test_two_processes_cannot_write_to_one_folder(tmp_path):
    run(experiment(), tmp_path / "out")
    code = (
        "import fcntl, sys, time; f = open(sys.argv[1], 'a'); fcntl.flock(f, fcntl.LOCK_EX); "
        "print('held', flush=True); time.sleep(60)"
    )
    holder = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "out" / ".lock")], stdout=subprocess.PIPE)
    try:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(RunFolderError, match="in use"):
            run(experiment(), tmp_path / "out")
        with pytest.raises(RunFolderError, match="in use"):
            run(Experiment("other", "runner_tasks:draw", [Task("a", {"seed": 1})]), tmp_path / "out")
    finally:
        holder.kill()
        holder.wait()


def test_a_task_that_fails_stops_the_run_and_keeps_what_was_done(tmp_path):
    failing = Experiment("sample", "runner_tasks:refuse", [Task("a", {"seed": 1})])
    with pytest.raises(RuntimeError, match="no luck with seed 1"):
        run(failing, tmp_path / "out")
    assert not (tmp_path / "out" / "results.parquet").exists()


@pytest.mark.parametrize("tasks", [[], [Task("a", {"seed": 1}), Task("a", {"seed": 2})]])
def test_tasks_need_distinct_names(tmp_path, tasks):
    with pytest.raises(UsageError):
        run(Experiment("sample", "runner_tasks:draw", tasks), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_ray_gives_the_same_to_the_last_digit(tmp_path, cluster):
    here = run(experiment(8), tmp_path / "here")
    there = run(experiment(8), tmp_path / "there", ray=cluster)
    assert there.equals(here)
    assert (tmp_path / "there" / "results.parquet").read_bytes() == (tmp_path / "here" / "results.parquet").read_bytes()


def test_a_failure_on_ray_is_the_tasks_own(tmp_path, cluster):
    failing = Experiment("sample", "runner_tasks:refuse", [Task("a", {"seed": 1})])
    with pytest.raises(RuntimeError, match="no luck with seed 1"):
        run(failing, tmp_path / "out", ray=cluster)


def test_an_address_without_a_cluster_is_named(tmp_path):
    pytest.importorskip("ray")
    with pytest.raises(UsageError, match="--ray: is 'nonsense'"):
        run(experiment(), tmp_path / "out", ray="nonsense")
