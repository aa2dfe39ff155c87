"""One policy for every size: the same games for all players, and differences taken episode by episode."""

from __future__ import annotations

import csv
from typing import Any

import pyarrow as pa
import pytest

from skyrelay.experiments.generalization import GENERALIST, RULES, differences, experiment, render
from skyrelay.experiments.generalization_tasks import SPECIALIST, fly
from skyrelay.store.cid import Cid

EPISODES = 4
LEVEL = {GENERALIST: 0.97, SPECIALIST: 0.96, "static": 0.5, "centroid-linked": 0.9, "cover": 0.95}


def rows(scale="smoke"):
    return [
        {key: task.settings[key] for key in ("player", "group", "uavs", "vehicles", "ratio", "drop_out")}
        | {"trace": task.settings["trace"] or "", "episode": number, "return": -3.0}
        | dict.fromkeys(
            ("coverage", "connectivity", "connectivity_neighbor"), LEVEL[task.settings["player"]] + 0.001 * number
        )
        for task in experiment(scale).tasks
        for number in range(EPISODES)
    ]


@pytest.mark.parametrize("scale", ["smoke", "fast", "paper"])
def test_every_group_has_the_generalist_and_what_it_is_held_against(scale):
    tasks = experiment(scale).tasks
    assert len({task.name for task in tasks}) == len(tasks)
    against = {
        group: {t.settings["player"] for t in tasks if t.settings["group"] == group}
        for group in ("sizes", "scales", "trace", "drop-outs")
    }
    assert against["sizes"] == {GENERALIST, SPECIALIST}
    assert against["scales"] == {GENERALIST, SPECIALIST, *RULES}
    assert against["trace"] == against["drop-outs"] == {GENERALIST, *RULES}
    for task in tasks:
        assert (task.settings["cid"] is not None) == (task.settings["player"] == GENERALIST)
    Cid.parse(next(task.settings["cid"] for task in tasks if task.settings["cid"]))


def test_differences_are_taken_episode_by_episode(tmp_path):
    difference = differences(rows(), "sizes", 2, 5, 2.0, "coverage")
    assert difference.mean == pytest.approx(1.0)
    assert difference.high - difference.low == pytest.approx(0.0, abs=1e-9)
    rendered = render(pa.Table.from_pylist(rows()), tmp_path)
    assert {path.name for path in rendered.files} == {
        "summary.csv",
        "against-specialists.csv",
        "generalization.pdf",
        "generalization.png",
    }
    with (tmp_path / "summary.csv").open() as file:
        players = {row["player"] for row in csv.DictReader(file)}
    assert players == {GENERALIST, SPECIALIST, *RULES}


def test_a_policy_and_a_rule_fly_the_same_games():
    games: dict[str, Any] = {
        "group": "drop-outs",
        "uavs": 2,
        "vehicles": 5,
        "ratio": 2.0,
        "drop_out": 0.01,
        "trace": None,
        "episodes": 3,
        "steps": 1,
    }
    cid = next(task.settings["cid"] for task in experiment("smoke").tasks if task.settings["cid"])
    policy, rule = fly(GENERALIST, cid=cid, **games), fly("static", cid=None, **games)
    assert [row["episode"] for row in policy] == [row["episode"] for row in rule] == [0, 1, 2]
    assert sum(row["coverage"] for row in policy) > sum(row["coverage"] for row in rule)
