"""A suite played: who plays (`entrants`), every task by each (`play`), and how they stand (`standings`).

A folder of it holds, beside what every experiment leaves (`skyrelay.experiments.runner`), ``standings.json``,
``standings.csv`` and ``marl-eval.json``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from skyrelay.airspace.maps import ENERGY_MAPS, OBSTACLE_MAPS
from skyrelay.baselines.catalogue import BASELINES
from skyrelay.core import aggregates
from skyrelay.core.entities import FloatArray
from skyrelay.core.errors import UsageError
from skyrelay.core.files import atomic_path, write_text
from skyrelay.core.names import WITH_ENERGY
from skyrelay.core.progress import Progress
from skyrelay.core.statistics import interval
from skyrelay.experiments.runner import Experiment, Row, Task, run
from skyrelay.experiments.suite_tasks import GameTask, Suite, plays
from skyrelay.policy import Policy
from skyrelay.policy.card import Card
from skyrelay.policy.runtime import builtin_policies
from skyrelay.store.cid import cid_of

REFERENCE = "cover"
"""The rule that everybody is held against."""
AUTO = "auto"
"""In each task the shipped policy that sees what its games have, as a run chooses."""
NOT_FLOWN = ("pso-placed", "clairvoyant")
"""Rules that no team can follow: put in place at once, or told the future."""
THRESHOLDS = np.linspace(0.0, 1.1, 221)
"""At which performance profiles are given."""
MEASURES = ("return", "coverage", "connectivity")
STANDINGS, TABLE, MARL_EVAL = "standings.json", "standings.csv", "marl-eval.json"
MOST_FILES = 1000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}")


@dataclass(frozen=True)
class Entrant:
    """Who plays.

    Attributes:
        name: of the method.
        files: of its policies, or names of shipped ones: one, or one for each run; none for a rule.
        cards: theirs.
        cids: theirs.
        shipped: comes with the package, and plays what it was made for; what the user names plays every task.
    """

    name: str
    files: tuple[str, ...] = ()
    cards: tuple[Card, ...] = ()
    cids: tuple[str, ...] = ()
    shipped: bool = True

    def runs(self, suite: Suite) -> int:
        """One for each training where there are several."""
        return suite.runs if len(self.files) < 2 else len(self.files)

    def within(self, task: GameTask) -> bool:
        """Whether the task is of the sizes that the policy was trained for; of a rule always."""
        return all(
            card.uavs[0] <= task.uavs <= card.uavs[1]
            and (task.trace is not None or card.vehicles[0] <= task.vehicles)
            and task.vehicles <= card.vehicles[1]
            for card in self.cards
        )

    def plays(self, task: GameTask) -> bool:
        """Whether it plays a task at all."""
        if not self.files:
            return plays(self.name, task)
        if not self.shipped:
            return True
        own = set(self.cards[0].maps)
        strange = (task.games != "obstacles" and own & set(OBSTACLE_MAPS)) or (
            task.games not in WITH_ENERGY and own & set(ENERGY_MAPS)
        )
        return not strange and self.within(task)


def entrants(suite: Suite, given: Sequence[str] = (), only: Sequence[str] = ()) -> list[Entrant]:
    """Every shipped policy, every rule of the suite, and what the user names.

    Args:
        given: ``NAME=FILE[,FILE...]``; a folder stands for the ``policy.onnx`` in it, or in each of its folders.
        only: names of the shipped policies and rules that play; empty for all.
    Raises:
        UsageError: a name is unknown, taken or none, or there are more files than the suite has runs.
        ModelError: a file is no policy.
    """
    rules = suite.rules if suite.rules is not None else tuple(rule for rule in BASELINES if rule not in NOT_FLOWN)
    shipped = {name: _policies(name, (name,), shipped=True) for name in builtin_policies()}
    known = shipped | {rule: Entrant(rule) for rule in rules}
    for name in only:
        if name not in known:
            raise UsageError("--only", name, "one of: " + ", ".join(known))
    playing = [entrant for name, entrant in known.items() if not only or name in only]
    for text in given:
        name, equals, files = text.partition("=")
        if not equals or not _NAME.fullmatch(name):
            raise UsageError("--policy", text, "NAME=FILE[,FILE...], the name of letters, digits, '.', '_' and '-'")
        if name in (AUTO, *BASELINES, *builtin_policies()) or any(name == other.name for other in playing):
            raise UsageError("--policy", name, "a name that nobody else has")
        found = [file for part in files.split(",") for file in _files(part)]
        if not 0 < len(found) <= suite.runs:
            raise UsageError(f"--policy {name}", len(found), f"1 to {suite.runs} files, one for each run of the suite")
        playing.append(_policies(name, tuple(found), shipped=False))
    return playing


def _policies(name: str, files: tuple[str, ...], *, shipped: bool) -> Entrant:
    loaded = [Policy.named(file) for file in files]
    cids = tuple(str(cid_of(policy.content)) for policy in loaded)
    return Entrant(name, files, tuple(policy.card for policy in loaded), cids, shipped)


def _files(part: str) -> list[str]:
    folder = Path(part)
    if not folder.is_dir():
        return [part]
    own = folder / "policy.onnx"
    found = [own] if own.exists() else sorted(folder.glob("*/policy.onnx"), key=_number)
    if not found:
        raise UsageError("--policy", part, "a folder with policy.onnx in it, or in its folders")
    return [str(file) for file in found[: MOST_FILES + 1]]


def _number(file: Path) -> tuple[int, str]:
    """seed-2 is before seed-10."""
    digits = re.search(r"(\d{1,9})$", file.parent.name)
    return int(digits[1]) if digits else 0, file.parent.name


def experiment(suite: Suite, playing: Sequence[Entrant]) -> Experiment:
    """One task for each game and each of those that play it."""
    tasks = [
        Task(
            f"{task.name}-{entrant.name}",
            {
                "method": entrant.name,
                "files": list(entrant.files),
                "cids": list(entrant.cids),
                "runs": entrant.runs(suite),
                "episodes": suite.episodes,
            }
            | task.settings,
        )
        for task in suite.tasks
        for entrant in playing
        if entrant.plays(task)
    ]
    packages = ("numpy", "jax", "jaxlib", "equinox", "onnxruntime")
    return Experiment(suite.name, "skyrelay.experiments.suite_tasks:play", tasks, packages)


def play(
    suite: Suite,
    playing: Sequence[Entrant],
    folder: Path,
    *,
    ray: str | None = None,
    progress: Progress | None = None,
    command: str | None = None,
) -> dict[str, Any]:
    """Play what is not yet played of a suite, and write how everybody stands.

    Args:
        ray, progress, command: as in `skyrelay.experiments.runner.run`.
    Returns: `standings`.
    Raises:
        RunFolderError, UsageError, ModelError: as there, and as `skyrelay.experiments.suite_tasks.play`.
    """
    table = run(experiment(suite, playing), folder, ray=ray, progress=progress, command=command)
    rows: list[Row] = table.to_pylist()
    told = standings(suite, playing, rows)
    write_text(folder / STANDINGS, json.dumps(told, indent=1, allow_nan=False) + "\n")
    with atomic_path(folder / TABLE) as beside:
        pa_csv.write_csv(pa.Table.from_pylist(_by_task(told)), beside)
    write_text(folder / MARL_EVAL, json.dumps(marl_eval(suite, playing, rows), allow_nan=False) + "\n")
    return told


class Played:
    """What was played, by method, task, run and episode.

    Args:
        rows: of `experiment`.
    """

    def __init__(self, suite: Suite, playing: Sequence[Entrant], rows: Sequence[Row]) -> None:
        self.suite = suite
        self._rows: dict[tuple[str, str], dict[int, list[Row]]] = {}
        for row in rows:
            runs = self._rows.setdefault((row["method"], row["task"]), {})
            runs.setdefault(row["run"], []).append(row)
        for task, method in _chosen(suite, playing).items():
            self._rows[AUTO, task] = self._rows[method, task]
        self.methods = list(dict.fromkeys(method for method, _ in self._rows))

    def runs(self, method: str, task: str) -> list[list[Row]]:
        """The episodes of each run; empty where the method has not played the task."""
        runs = self._rows.get((method, task), {})
        return [runs[number] for number in sorted(runs)]

    def means(self, method: str, task: str, measure: str) -> FloatArray:
        """[runs] means over the episodes."""
        return np.array([np.mean([row[measure] for row in run]) for run in self.runs(method, task)])

    def scores(self, method: str) -> FloatArray | None:
        """[runs, tasks] of one method; None where it has not played all tasks."""
        columns = [self.means(method, task.name, task.measure) for task in self.suite.tasks]
        if not all(len(column) for column in columns):
            return None
        return np.stack([task.score(one) for task, one in zip(self.suite.tasks, columns, strict=True)], axis=1)


def _chosen(suite: Suite, playing: Sequence[Entrant]) -> dict[str, str]:
    """For each task the shipped policy that looks at most of what its games have: who plays for `AUTO`.

    None where that is one and the same policy everywhere, or a shipped policy does not play.
    """
    shipped = [entrant for entrant in playing if entrant.files and entrant.shipped]
    chosen = {
        task.name: max(fitting, key=lambda one: len(one.cards[0].maps)).name
        for task in suite.tasks
        if (fitting := [entrant for entrant in shipped if entrant.plays(task)])
    }
    return chosen if len(shipped) == len(builtin_policies()) and len(set(chosen.values())) > 1 else {}


def standings(suite: Suite, playing: Sequence[Entrant], rows: Sequence[Row]) -> dict[str, Any]:
    """How everybody stands, the best first; who has not played all tasks is at the end, without figures over all.

    Scores are normalised task by task (`GameTask.score`). A run's score in a task is the mean over its episodes.

    Args:
        rows: of `experiment`.
    Returns: for JSON, without NaN.
    """
    played = Played(suite, playing, rows)
    entered = {entrant.name: entrant for entrant in playing}
    scores = {method: played.scores(method) for method in played.methods}
    reference = scores.get(REFERENCE)
    told: list[dict[str, Any]] = []
    for method, matrix in scores.items():
        entrant = entered.get(method)
        found: dict[str, Any] = {
            "name": method,
            "kind": "policy" if entrant is None or entrant.files else "rule",
            "trainings": len(entrant.files) if entrant is not None else 0,
            "runs": max(len(played.runs(method, task.name)) for task in suite.tasks),
            "complete": matrix is not None,
        }
        if matrix is not None:
            found |= _of_all(matrix, None if method == REFERENCE else reference)
        told.append(found | {"tasks": _tasks_of(played, method, entrant)})
    told.sort(key=lambda one: (not one["complete"], -one["iqm"]["mean"] if one["complete"] else 0.0, one["name"]))
    return {
        "suite": suite.name,
        "title": suite.title,
        "runs": suite.runs,
        "episodes": suite.episodes,
        "reference": REFERENCE if reference is not None else None,
        "thresholds": np.round(THRESHOLDS, 6).tolist(),
        "tasks": [_told_task(task) for task in suite.tasks],
        "methods": told,
    }


def marl_eval(suite: Suite, playing: Sequence[Entrant], rows: Sequence[Row]) -> dict[str, Any]:
    """The episodes in the format of marl-eval: environment, task, algorithm, run, step, measure, episodes.

    That format wants the same tasks and as many runs of everybody: who has not played all tasks is left out, and of
    those with more runs the first count. A finished method has a single step, of which marl-eval wants a tenth of the
    episodes, and all of them as its absolute metrics.

    Source: R. Gorsane et al., "Towards a standardised performance evaluation protocol for cooperative MARL", NeurIPS
    2022, and the package id-marl-eval.
    """
    played = Played(suite, playing, rows)
    methods = [method for method in played.methods if played.scores(method) is not None]
    steps = {entrant.name: entrant.cards[0].steps for entrant in playing if entrant.cards}
    kept = min((len(played.runs(method, suite.tasks[0].name)) for method in methods), default=0)
    found: dict[str, Any] = {}
    for task in suite.tasks:
        for method in methods:
            for number, run_rows in enumerate(played.runs(method, task.name)[:kept]):
                values = {"score": [_short(task.score(row[task.measure])) for row in run_rows]}
                values |= {name: [_short(row[name]) for row in run_rows] for name in MEASURES}
                first = {name: episodes[: -(-len(run_rows) // 10)] for name, episodes in values.items()}
                found.setdefault(task.name, {}).setdefault(method, {})[f"run_{number}"] = {
                    "step_1": {"step_count": steps.get(method, 0)} | first,
                    "absolute_metrics": values,
                }
    return {f"skyrelay-{suite.name}": found}


def _of_all(scores: FloatArray, reference: FloatArray | None) -> dict[str, Any]:
    """Figures over all tasks, and how they compare with the reference's."""
    value, low, high = aggregates.profile_with_band(scores, THRESHOLDS)
    lines = {"share": value, "low": low, "high": high}
    told: dict[str, Any] = {
        "iqm": aggregates.with_interval(aggregates.interquartile_mean, scores).closed(),
        "mean": aggregates.with_interval(aggregates.mean, scores).closed(),
        "optimality_gap": aggregates.with_interval(aggregates.optimality_gap, scores).closed(),
        "profile": {name: np.round(line, 6).tolist() for name, line in lines.items()},
    }
    if reference is not None:
        both = min(len(scores), len(reference))
        told["improvement"] = aggregates.improvement_with_interval(scores, reference).closed()
        # The same seed gives both the same episodes: run by run, most of the chance in them cancels.
        told["ahead"] = interval((scores[:both] - reference[:both]).mean(1)).closed()
    return told


def _tasks_of(played: Played, method: str, entrant: Entrant | None) -> dict[str, Any]:
    """By task: the score, and what was measured, over the runs."""
    told: dict[str, Any] = {}
    for task in played.suite.tasks:
        if not played.runs(method, task.name):
            continue
        measured = {name: played.means(method, task.name, name) for name in dict.fromkeys((task.measure, *MEASURES))}
        found: dict[str, Any] = {"score": interval(task.score(measured[task.measure])).closed()}
        found |= {name: interval(values).closed() for name, values in measured.items()}
        told[task.name] = found | {"within": entrant is None or entrant.within(task)}
    return told


def _told_task(task: GameTask) -> dict[str, Any]:
    scale = {name: getattr(task, name) for name in ("measure", "hovering", "best", "best_by")}
    return {"name": task.name} | {key: value for key, value in task.settings.items() if key != "game"} | scale


def _by_task(told: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row for each method and task."""
    measures = {task["name"]: task["measure"] for task in told["tasks"]}
    rows = []
    for method in told["methods"]:
        for name, found in method["tasks"].items():
            measured = found[measures[name]]
            row = {"task": name, "method": method["name"], "runs": method["runs"], "measure": measures[name]}
            row |= {bound: measured[bound] for bound in ("mean", "low", "high")}
            rows.append(row | {f"score_{bound}": found["score"][bound] for bound in ("mean", "low", "high")})
    return rows


def _short(value: float) -> float:
    return float(f"{value:.6g}")
