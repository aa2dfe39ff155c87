"""One runner under every experiment: independent tasks, a manifest, a journal that survives a kill, Parquet at the end.

A folder of results holds

- ``manifest.json``: what is run, task by task, with the versions it is run with; it is written first;
- ``journal.jsonl``: a line for each finished task; after a kill the run goes on from it;
- ``results.parquet``: the rows of all tasks in the order of the manifest, whoever finished first.

Numbers pass through JSON, which keeps every digit of a double, so results are the same wherever a task ran.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import json
import logging
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from io import BufferedRandom
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from skyrelay.core.errors import RunFolderError, UsageError
from skyrelay.core.files import atomic_path, write_text
from skyrelay.core.folders import LOCK, sole_writer
from skyrelay.core.progress import Progress, Silent
from skyrelay.core.untrusted import parse_json, read_json

Row = dict[str, Any]

MANIFEST, JOURNAL, RESULTS = "manifest.json", "journal.jsonl", "results.parquet"


@dataclass(frozen=True)
class Task:
    """One independent piece of work.

    Attributes:
        name: unique in its experiment.
        settings: keyword arguments of the experiment's function; JSON values only.
    """

    name: str
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class Experiment:
    """What a folder of results is made from.

    Attributes:
        name: of the figure or sweep.
        function: ``package.module:name`` of a function that takes a task's settings and returns rows (a list of
            dictionaries of JSON scalars). Its result may depend on nothing else.
        tasks: at least one, with distinct names.
        packages: distributions whose versions the results depend on.
    """

    name: str
    function: str
    tasks: Sequence[Task]
    packages: tuple[str, ...] = ("numpy", "scipy")

    def manifest(self) -> dict[str, Any]:
        """What identifies the results; settings that all tasks share stand there once."""
        first = dict(self.tasks[0].settings)
        common = {key: first[key] for key in first if all(task.settings.get(key) == first[key] for task in self.tasks)}
        return {
            "experiment": self.name,
            "function": self.function,
            "versions": {
                "skyrelay": version("skyrelay"),
                "python": platform.python_version(),
                **{package: importlib.metadata.version(package) for package in self.packages},
            },
            "common_settings": common,
            "tasks": {
                task.name: {key: value for key, value in task.settings.items() if key not in common}
                for task in self.tasks
            },
        }


def run(
    experiment: Experiment,
    folder: Path,
    *,
    ray: str | None = None,
    progress: Progress | None = None,
    command: str | None = None,
) -> pa.Table:
    """Run what is not yet done of an experiment, and write its results.

    Args:
        folder: of the results; one that an equal run left half-done is completed.
        ray: address of a Ray cluster that has this package on every node, or ``local`` for one of this machine's
            cores; left out: one task after the other in this process.
        command: how to repeat this; kept in the manifest.
    Returns: the rows of all tasks, in the order of the experiment's tasks.
    Raises:
        RunFolderError: the folder belongs to another experiment or to other versions, or is in use, or is damaged.
        UsageError: Ray is not installed, or there is no cluster at the address.
    """
    shown = progress or Silent()
    _check_names(experiment)
    with _claimed(experiment, folder, command) as journal:
        done = _finished(journal, folder / JOURNAL, {task.name for task in experiment.tasks})
        todo = [task for task in experiment.tasks if task.name not in done]
        shown.stage(experiment.name, len(experiment.tasks))
        shown.advance(len(done))
        for task, rows in _work(experiment.function, todo, ray):
            journal.write(json.dumps({"task": task.name, "rows": rows}).encode() + b"\n")
            journal.flush()
            os.fsync(journal.fileno())
            done[task.name] = rows
            shown.advance()
        table = _table([row for task in experiment.tasks for row in done[task.name]])
        with atomic_path(folder / RESULTS) as beside:
            pq.write_table(table, beside)
    return table


def _check_names(experiment: Experiment) -> None:
    names = [task.name for task in experiment.tasks]
    if not names:
        raise UsageError(f"experiment {experiment.name}", "no task", "at least one task")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise UsageError(f"experiment {experiment.name}: task", twice, "a name that no other task has")


@contextmanager
def _claimed(experiment: Experiment, folder: Path, command: str | None) -> Iterator[BufferedRandom]:
    """The folder's journal, for this process alone."""
    with sole_writer(folder):
        _claim(experiment, folder, command)
        with (folder / JOURNAL).open("a+b") as journal:
            yield journal


def _claim(experiment: Experiment, folder: Path, command: str | None) -> None:
    """Write the manifest, or find the same one there."""
    wanted = json.loads(json.dumps(experiment.manifest()))
    path = folder / MANIFEST
    if not path.exists():
        if any(entry.name != LOCK for entry in folder.iterdir()):
            raise RunFolderError(folder, None, f"an empty folder, or one with a {MANIFEST}")
        write_text(path, _pretty({"command": command, **wanted}))
        return
    try:
        found = read_json(path)
    except (OSError, ValueError) as error:
        raise RunFolderError(path, None, f"a readable manifest ({error})") from error
    for key, value in wanted.items():
        if not isinstance(found, dict) or _in_order(found.get(key)) != _in_order(value):
            there = found.get(key) if isinstance(found, dict) else found
            wish = f"{_brief(key, value)} as of this run; remove the folder or name another"
            raise RunFolderError(f"{path}: {key}", _brief(key, there), wish)


def _in_order(value: object) -> object:
    """So that dictionaries compare with their order: it is that of the results."""
    return list(value.items()) if isinstance(value, dict) else value


def _pretty(manifest: Mapping[str, Any]) -> str:
    """JSON with a line for each task."""
    head = {key: value for key, value in manifest.items() if key != "tasks"}
    lines = (f"  {json.dumps(name)}: {json.dumps(settings)}" for name, settings in manifest["tasks"].items())
    return json.dumps(head, indent=1)[:-2] + ',\n "tasks": {\n' + ",\n".join(lines) + "\n }\n}\n"


def _brief(key: str, value: object) -> str:
    """A manifest's value in few words; tasks by their number and digest."""
    if key == "tasks" and isinstance(value, Mapping):
        digest = hashlib.sha256(json.dumps(list(value.items())).encode()).hexdigest()[:12]
        return f"{len(value)} tasks ({digest})"
    return json.dumps(value)


def _finished(journal: BufferedRandom, path: Path, names: set[str]) -> dict[str, list[Row]]:
    """Rows by finished task; a last line that a kill has cut off is removed from the file."""
    journal.seek(0)
    text = journal.read()
    whole = text.rfind(b"\n") + 1
    journal.truncate(whole)
    done: dict[str, list[Row]] = {}
    for number, line in enumerate(text[:whole].splitlines(), start=1):
        try:
            entry = parse_json(line)
            name, rows = entry["task"], entry["rows"]
        except (ValueError, KeyError, TypeError):
            raise RunFolderError(
                f"{path}: line {number}", line[:60].decode(errors="replace"), "a finished task"
            ) from None
        if name not in names:
            raise RunFolderError(f"{path}: line {number}: task", name, "a task of the manifest")
        done[name] = rows
    return done


def _work(function: str, tasks: Sequence[Task], ray: str | None) -> Iterator[tuple[Task, list[Row]]]:
    """Tasks with their rows, as they are finished."""
    if not tasks:
        return
    if ray is None:
        for task in tasks:
            yield task, call(function, dict(task.settings))
        return
    yield from _work_on_ray(function, tasks, ray)


def call(function: str, settings: dict[str, Any]) -> list[Row]:
    """Call ``package.module:name`` with a task's settings; the rows as JSON has them."""
    module, _, name = function.partition(":")
    rows = getattr(importlib.import_module(module), name)(**settings)
    result: list[Row] = json.loads(json.dumps(rows))
    return result


def _work_on_ray(function: str, tasks: Sequence[Task], address: str) -> Iterator[tuple[Task, list[Row]]]:
    import ray

    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise UsageError("--ray", address, f"the address of a running Ray cluster, or 'local' ({reason})") from error
    try:
        remote = ray.remote(num_cpus=1)(call)
        running = {remote.remote(function, dict(task.settings)): task for task in tasks}
        while running:
            ready, _ = ray.wait(list(running), num_returns=1)
            for reference in ready:
                yield running.pop(reference), ray.get(reference)
    finally:
        ray.shutdown()


def _table(rows: Sequence[Row]) -> pa.Table:
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: pa.array([row.get(name) for row in rows]) for name in names})
