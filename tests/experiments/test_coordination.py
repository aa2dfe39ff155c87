import json
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pytest

from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.statistics import Interval
from skyrelay.experiments.claims import CLAIMS
from skyrelay.experiments.coordination import BASELINES, GENERALIST, experiment, render
from skyrelay.experiments.coordination_findings import findings
from skyrelay.experiments.coordination_results import Results
from skyrelay.experiments.coordination_tasks import (
    CENTRALIZED,
    EVALUATION_SEED,
    OURS,
    count,
    fly_policy,
    learn,
    play_baseline,
)
from skyrelay.experiments.plotting import panels, points
from skyrelay.learning.evaluation import MEASURES, policy_episodes, starts, unseen_key
from skyrelay.policy import Policy

UAVS, VEHICLES, SEEDS, EPISODES = (2, 3, 5), (5, 20), 3, 24


def rows(ours=-4.5, centralized=-20.0, connected_step=3, placed_loss=0.2):
    """What the tasks would return, with known levels."""
    curves, episodes = [], []
    for uavs in UAVS:
        for vehicles in VEHICLES:
            trainings = [(OURS, ours)] + [(CENTRALIZED, centralized)] * (uavs in (2, 3) and vehicles == 20)
            for method, level in trainings:
                for seed in range(SEEDS):
                    for step in range(1, 9):
                        # More vehicles are learned later; each seed has a level of its own.
                        climb = min(1.0, step / (3 + vehicles // 10))
                        value = -80.0 + climb * (level + 80.0 + 0.01 * seed)
                        common = {"kind": "curve", "method": method, "uavs": uavs, "vehicles": vehicles}
                        measures = dict(zip(MEASURES, (value, 0.9, 0.9, 0.9), strict=True))
                        curves.append({**common, "seed": seed, "steps": 1000 * step, **measures})
                    for flown in VEHICLES if vehicles == 20 and uavs in (2, 3) else (vehicles,):
                        labels = {"method": method, "uavs": uavs, "seed": seed, "trained_vehicles": vehicles}
                        episodes += _episodes({**labels, "vehicles": flown}, level, 1.0 + level / 100, connected_step)
            for name in (GENERALIST, *BASELINES):
                coverage = 0.95 - placed_loss * (vehicles == 20)
                episodes += _episodes({"method": name, "uavs": uavs, "vehicles": vehicles}, -10.0, coverage, 0)
    nullable = {"seed": None, "trained_vehicles": None}
    networks = count([2, 3, 4, 5])
    everything = [*networks, *curves, *({**nullable, **row} for row in episodes)]
    return pa.Table.from_pylist(everything, schema=_schema(everything)).to_pylist()


def _schema(everything):
    names = dict.fromkeys(name for row in everything for name in row)
    return pa.schema([pa.field(name, pa.array([row.get(name) for row in everything]).type) for name in names])


def _episodes(labels, level, coverage, step):
    return [
        {
            "kind": "episode",
            **labels,
            "episode": number,
            "return": level + 0.01 * (number % 5),
            "coverage": coverage + 0.001 * (number % 5),
            "connectivity": 1.0 if labels["method"] == "pso-placed" else coverage,
            "connectivity_neighbor": coverage,
            "connected_step": step,
            "linked_and_covered_step": None if number == 0 else step,
        }
        for number in range(EPISODES)
    ]


def verdicts(**levels):
    return {
        finding.claim.removeprefix("coordination."): finding.verdict for finding in findings(Results(rows(**levels)))
    }


def test_every_claim_about_coordination_is_measured():
    claims = {claim.key.removeprefix("coordination.") for claim in CLAIMS if claim.key.startswith("coordination.")}
    assert set(verdicts()) == claims


def test_verdicts_follow_the_measurements():
    good = verdicts()
    bad = verdicts(ours=-20.0, centralized=-4.5, connected_step=30, placed_loss=-0.02)
    assert {claim: (good[claim], bad[claim]) for claim in good} == {
        "converges": ("holds", "does not hold"),
        "slower": ("holds", "holds"),
        "steps": ("holds", "does not hold"),
        # Behind at both sizes, by the same at both: "the more the larger the team" does not show.
        "centralized": ("holds in part", "does not hold"),
        "parameters": ("holds in part", "holds in part"),
        "flops": ("does not hold", "does not hold"),
        "coverage": ("holds", "does not hold"),
        "connectivity": ("holds", "does not hold"),
        "connected": ("holds", "does not hold"),
        "placement": ("holds", "does not hold"),
        "placement-connected": ("holds", "holds"),
    }


def test_counts_are_beside_the_papers(tmp_path):
    rendered = render(pa.Table.from_pylist(rows()), tmp_path)
    table = pa_csv.read_csv(tmp_path / "networks.csv").to_pylist()
    ours = next(row for row in table if row["preset"] == "paper" and row["method"] == OURS and row["uavs"] == 2)
    assert (ours["parameters"], ours["paper_parameters"]) == (1_692_969, "1.692M")
    names = {path.name for path in rendered.files}
    for stem in ("learning-curves", "centralised", "coverage-connectivity", "steps-to-connectivity"):
        assert {f"{stem}.pdf", f"{stem}.png"} <= names
    assert all(path.stat().st_size > 0 for path in rendered.files)
    measured = pa_csv.read_csv(tmp_path / "coverage-connectivity.csv").to_pylist()
    assert {row["experiments"] for row in measured} == {20, EPISODES}
    assert {row["method"] for row in measured} == {OURS, CENTRALIZED, GENERALIST, *BASELINES}


def test_experiments_are_the_same_episodes_for_all_methods():
    results = Results(rows())
    few, many = (results.experiment_values(OURS, 20, "return", number) for number in (20, EPISODES))
    assert few == many[:20]
    ours, theirs = (results.experiment_values(method, 20, "return", EPISODES) for method in (OURS, "static"))
    differences = {round(a - b, 6) for a, b in zip(ours, theirs, strict=True)}
    assert differences == {5.5}


def test_the_step_of_connection_counts_only_episodes_that_get_there():
    results = Results(rows(connected_step=7))
    assert results.over_seeds(OURS, 5, 20, "linked_and_covered_step").mean == 7.0
    assert results.share_reached(OURS, 5, 20, "linked_and_covered_step") == pytest.approx(1 - 1 / EPISODES)


@pytest.mark.parametrize("scale", ["smoke", "fast", "paper"])
def test_tasks_are_whole_and_say_so_in_json(scale):
    tasks = experiment(scale).tasks
    assert len({task.name for task in tasks}) == len(tasks)
    json.dumps([dict(task.settings) for task in tasks])
    sizes = {(task.settings["method"], task.settings["uavs"]) for task in tasks if task.settings["kind"] == "learn"}
    assert {(CENTRALIZED, 2), (CENTRALIZED, 3)} <= sizes
    if scale != "smoke":
        assert {(OURS, uavs) for uavs in (2, 3, 4, 5)} <= sizes
        assert len({task.settings["seed"] for task in tasks if task.settings["kind"] == "learn"}) >= 5


@pytest.mark.parametrize("method", [OURS, CENTRALIZED])
def test_a_training_repeats_and_its_episodes_pair_with_a_baselines(method):
    settings: dict[str, Any] = {
        "preset": "fast",
        "uavs": 2,
        "vehicles": 3,
        "steps": 6400,
        "test_every": 3200,
        "test_episodes": 2,
        "flown": [3],
        "episodes": 3,
    }
    first, again, other = (learn(method, seed=seed, **settings) for seed in (4, 4, 5))
    assert first == again
    assert first != other
    curve = [row for row in first if row["kind"] == "curve"]
    steps = [row["steps"] for row in curve]
    assert len(steps) >= 2
    assert steps == sorted(set(steps))
    assert steps[-1] >= settings["steps"]
    flown = [row for row in first if row["kind"] == "episode"]
    static = play_baseline("static", 2, 3, 3)
    assert [row["episode"] for row in flown] == [row["episode"] for row in static] == [0, 1, 2]
    # A team that starts connected is so at step 0 under any player: these are the same episodes.
    assert [row["connected_step"] == 0 for row in flown] == [row["connected_step"] == 0 for row in static]
    assert set(flown[0]) - set(static[0]) == {"seed", "trained_vehicles"}


def test_a_shipped_policy_flies_the_same_episodes():
    flown, static = fly_policy(GENERALIST, "its cid", 3, 5, 4), play_baseline("static", 3, 5, 4)
    assert [set(row) for row in flown] == [set(row) for row in static]
    assert [row["connected_step"] == 0 for row in flown] == [row["connected_step"] == 0 for row in static]
    games = starts(unseen_key(EVALUATION_SEED), 4, Shape(3, 5, n=11, zoom=3), physical((3, 3), (5, 5)))
    measures = policy_episodes(Policy.builtin(GENERALIST), games)
    assert [[row[name] for name in MEASURES] for row in flown] == measures.T.tolist()


def test_points_of_shares_stay_within_one_and_beside_each_other():
    _, (axis,) = panels(1, 1, "")
    values = [Interval(0.99, 0.97, 1.01, 5), Interval(1.0, 1.0, 1.0, 5)]
    for style, shift in ((0, -1.0), (1, 1.0)):
        points(axis, [5, 10], values, f"method {style}", style, shift)
    bars = [container[2][0].get_segments() for container in axis.containers]
    for segments, shift in zip(bars, (-1.0, 1.0), strict=True):
        ends = np.array(segments)
        np.testing.assert_allclose(ends[:, :, 0], [[5 + shift] * 2, [10 + shift] * 2])
        np.testing.assert_allclose(ends[0, :, 1], [0.97, 1.0])
        assert ends[:, :, 1].max() <= 1.0
