"""Suites: who plays what, the same episodes for everybody, how they stand, and the export."""

import dataclasses
import hashlib
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from skyrelay.baselines.catalogue import BASELINES
from skyrelay.core import aggregates
from skyrelay.core.errors import SkyRelayError, UsageError
from skyrelay.experiments import suite as suites
from skyrelay.experiments import suite_tasks
from skyrelay.experiments.suite_tasks import GameTask, Suite, suite_of

POLICIES = files("skyrelay.data") / "policies"
KEPT = Path(__file__).parents[2] / "results" / "suite-all-v1"
SMALL = GameTask("small", 2, 3)


def rows_of(suite, method, runs, value):
    """Made-up rows: ``value`` of the task's number, run and episode."""
    return [
        {"task": task.name, "method": method, "run": run, "episode": episode, "coverage": 0.5, "connectivity": 1.0}
        | {"return": value(number, run, episode), "carried": 0.5}
        for number, task in enumerate(suite.tasks)
        for run in range(runs)
        for episode in range(suite.episodes)
    ]


@pytest.fixture(scope="module")
def three():
    tasks = tuple(GameTask(f"t{number}", 2, 5, hovering=-10.0, best=0.0) for number in range(3))
    return Suite("three-v1", "Three", tasks, 4, 2)


def test_a_version_stays_as_it_is():
    """Whoever changes a task or its scale makes another version."""
    digest = hashlib.sha256((files("skyrelay.data") / "suites" / "v1.toml").read_bytes()).hexdigest()
    assert digest == "9537dfbbeab61fc6af19885809225521b5d5a3c4d4a4be7f6b36eed2ddb1b1ae"


def test_a_name_without_a_version_is_the_newest():
    assert suite_of("sizes") is suite_of("sizes-v1")
    for suite in suite_tasks.suites().values():
        assert len(suite.tasks) == len({task.name for task in suite.tasks}) > 0
        assert all(task.best > task.hovering for task in suite.tasks)
    with pytest.raises(UsageError, match=r"--suite.*'size'.*sizes-v1"):
        suite_of("size")


def test_files_that_look_at_other_maps_are_no_trainings_of_one_method():
    mixed = [str(POLICIES / f"{name}.onnx") for name in ("generalist", "energy")]
    with pytest.raises(UsageError, match="maps"):
        suite_tasks.play("mixed", mixed, [], 2, 1, **SMALL.settings)


def test_a_run_is_of_its_seed_whatever_other_runs_there_are():
    both, _ = suite_tasks.games_of_runs(SMALL, 2, 3, 11, 2)
    second, _ = suite_tasks.games_of_runs(SMALL, 1, 3, 11, 2, first=1)
    np.testing.assert_array_equal(both.uavs[3:], second.uavs)
    assert (both.uavs[:3] != second.uavs).any()


def test_who_plays_what():
    suite = suite_of("all")
    playing = {entrant.name: entrant for entrant in suites.entrants(suite)}
    assert {"static", "cover", "planner", "generalist", "obstacles", "energy"} <= set(playing)
    assert not {"pso-placed", "clairvoyant"} & set(playing)
    whom = {name: [task.name for task in suite.tasks if one.plays(task)] for name, one in playing.items()}
    everything = [task.name for task in suite.tasks]
    assert whom["cover"] == whom["generalist"] == everything
    assert whom["energy"] == whom["recharge"] == ["energy-u2-v10", "energy-u4-v20"]
    assert whom["obstacles"] == ["obstacles-u2-v10"]
    assert set(everything) - set(whom["planner"]) == {"obstacles-u2-v10", "radio-u4-v20", "backhaul-u4-v20"}
    replayed = GameTask("replayed", 2, 5, trace="bologna")
    assert playing["cover"].plays(replayed)
    assert not playing["planner"].plays(replayed)


def test_files_are_trainings_of_one_method(tmp_path):
    suite = suite_of("sizes")
    for seed in (10, 2, 1):
        (tmp_path / f"seed-{seed}").mkdir()
        (tmp_path / f"seed-{seed}" / "policy.onnx").write_bytes((POLICIES / "energy.onnx").read_bytes())
    *shipped, mine = suites.entrants(suite, [f"mine={tmp_path}"], ["cover"])
    assert [entrant.name for entrant in shipped] == ["cover"]
    assert [Path(file).parent.name for file in mine.files] == ["seed-1", "seed-2", "seed-10"]
    assert mine.runs(suite) == 3
    assert all(mine.plays(task) for task in suite.tasks)  # whoever is named plays all, if outside of its card
    assert {task.name for task in suite.tasks if not mine.within(task)} == {"u5-v5", "u5-v20", "u8-v40"}


@pytest.mark.parametrize(
    ("given", "only", "parts"),
    [
        (["mine"], [], ["--policy", "NAME=FILE"]),
        (["a,b=x.onnx"], [], ["--policy", "letters"]),
        (["cover=x.onnx"], [], ["'cover'", "nobody else"]),
        (["mine=nowhere.onnx"], [], ["nowhere.onnx"]),
        ([], ["covr"], ["--only", "'covr'", "generalist"]),
    ],
)
def test_entrants_that_do_not_fit(given, only, parts):
    with pytest.raises(SkyRelayError) as fault:
        suites.entrants(suite_of("sizes"), given, only)
    for part in parts:
        assert part in str(fault.value)


def test_standings_are_the_aggregates_of_the_rows(three):
    playing = [suites.Entrant(name) for name in ("static", "cover", "centroid")]
    random = np.random.default_rng(0)
    noise = random.normal(0, 0.5, (3, 4, 2))
    rows = rows_of(three, "static", 4, lambda task, run, episode: -9.0 + noise[task, run, episode])
    rows += rows_of(three, "cover", 4, lambda task, run, episode: -1.0 + noise[task, run, episode])
    rows += rows_of(three, "centroid", 4, lambda *_: -2.0)[:16]  # two of three tasks
    told = suites.standings(three, playing, rows)
    json.dumps(told, allow_nan=False)
    assert [method["name"] for method in told["methods"]] == ["cover", "static", "centroid"]
    cover, static, centroid = told["methods"]
    scores = (10.0 - 1.0 + noise.mean(-1).T) / 10.0
    assert cover["iqm"] == pytest.approx(aggregates.with_interval(aggregates.interquartile_mean, scores).closed())
    assert static["improvement"]["mean"] == 0.0
    assert static["ahead"]["mean"] == pytest.approx(-0.8)
    assert static["ahead"]["high"] - static["ahead"]["low"] == pytest.approx(0.0, abs=1e-9)  # paired: the noise is gone
    assert "improvement" not in cover
    assert not centroid["complete"]
    assert "iqm" not in centroid
    assert centroid["tasks"]["t1"]["score"]["mean"] == pytest.approx(0.8)
    assert set(centroid["tasks"]) == {"t0", "t1"}


def test_auto_is_in_each_task_the_policy_that_sees_most_of_it():
    suite = suite_of("all")
    playing = suites.entrants(suite, only=["generalist", "obstacles", "energy"])
    rows = []
    for number, entrant in enumerate(playing):
        own = dataclasses.replace(suite, tasks=tuple(task for task in suite.tasks if entrant.plays(task)))
        rows += rows_of(own, entrant.name, 2, lambda *_, number=number: -float(number))
    for row in rows:
        row["delivered"] = 0.5
    played = suites.Played(suite, playing, rows)
    names = [entrant.name for entrant in playing]
    by = {task.name: names[int(-played.means("auto", task.name, "return")[0])] for task in suite.tasks}
    assert by["obstacles-u2-v10"] == "obstacles"
    assert by["energy-u4-v20"] == "energy"
    assert by["u8-v40"] == by["radio-u4-v20"] == "generalist"


def test_the_export_has_all_episodes_of_those_who_played_everything(three):
    three = dataclasses.replace(three, episodes=20)
    playing = [suites.Entrant("cover"), suites.Entrant("static"), suites.Entrant("random")]
    rows = rows_of(three, "cover", 4, lambda task, run, episode: -float(episode))
    rows += rows_of(three, "static", 3, lambda *_: -10.0)
    rows += rows_of(three, "random", 4, lambda *_: -20.0)[:80]
    (environment,) = suites.marl_eval(three, playing, rows).values()
    assert set(environment) == {"t0", "t1", "t2"}
    for task in environment.values():
        assert set(task) == {"cover", "static"}
        for runs in task.values():
            assert list(runs) == ["run_0", "run_1", "run_2"]  # as many of everybody
            for run in runs.values():
                assert len(run["absolute_metrics"]["score"]) == 10 * len(run["step_1"]["score"]) == 20
    run = environment["t1"]["cover"]["run_2"]
    assert run["absolute_metrics"]["return"][:3] == [0.0, -1.0, -2.0]
    assert run["absolute_metrics"]["score"][:3] == [1.0, 0.9, 0.8]
    assert run["step_1"]["step_count"] == 0


def test_the_scale_is_what_hovering_and_the_best_rule_had_in_the_kept_run():
    suite = suite_of("all")
    table = pq.read_table(KEPT / "results.parquet").to_pylist()
    rules = [name for name in {row["method"] for row in table} if name in BASELINES]
    played = suites.Played(suite, [], table)
    for task in suite.tasks:
        means = {
            rule: float(played.means(rule, task.name, task.measure).mean())
            for rule in rules
            if played.runs(rule, task.name)
        }
        best = max(means, key=means.__getitem__)
        assert task.best_by == best, task.name
        assert task.best == pytest.approx(means[best], rel=1e-4)
        assert task.hovering == pytest.approx(means["static"], rel=1e-4)
