"""Training that can be trusted: the same seed, resuming, interruption, numbers that are none."""

from __future__ import annotations

import dataclasses
import os
import signal
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

from skyrelay.airspace.maps import PAPER_MAPS
from skyrelay.core.errors import TrainingError, UsageError
from skyrelay.learning import checkpoint, training
from skyrelay.learning.presets import training as preset
from skyrelay.learning.training import Report, train, train_side_by_side
from skyrelay.policy import Policy


@pytest.fixture(scope="module")
def finished(tiny, tmp_path_factory):
    """A whole training, its folder and its reports."""
    folder, reports = tmp_path_factory.mktemp("whole"), []
    return train(tiny, folder, report=reports.append, evaluation_episodes=4), folder, reports


def weights(network):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(eqx.filter(network, eqx.is_array))]


def assert_same(one, two):
    for a, b in zip(weights(one), weights(two), strict=True):
        np.testing.assert_array_equal(a, b)


def stop_after(updates):
    """A report that presses Ctrl-C once."""

    def report(now: Report) -> None:
        if now.stage == "training" and now.update == updates:
            os.kill(os.getpid(), signal.SIGINT)

    return report


def test_what_a_training_leaves(finished, tiny):
    result, folder, reports = finished
    assert result.finished
    assert [report.update for report in reports if report.stage == "training"] == [1, 2, 3, 4]
    curves = pq.read_table(folder / "curves.parquet").to_pydict()
    assert curves["steps"] == [20.0, 40.0, 60.0, 80.0]
    assert [value is not None for value in curves["test_return"]] == [False, True, False, True]
    policy = Policy.load(folder / "policy.onnx")
    assert policy.card.uavs == (1, 2)
    assert policy.card.seeds == [3]
    assert policy.card.steps == 80
    low, mean, high = (getattr(policy.card.evaluation[0].episode_return, part) for part in ("low", "mean", "high"))
    assert low <= mean <= high
    assert mean <= 0
    maps = np.random.default_rng(0).uniform(0, 2, (9, 6, 5, 5)).astype(np.float32)
    np.testing.assert_allclose(policy.logits(maps), result.actor(jnp.asarray(maps)), atol=1e-5)


def test_an_interrupted_training_resumes_bit_for_bit(finished, tiny, tmp_path):
    result, folder, _ = finished
    first = train(tiny, tmp_path, report=stop_after(3), evaluation_episodes=4)
    assert not first.finished
    assert len(first.curves) == 3
    assert not (tmp_path / "policy.onnx").exists()
    second = train(tiny, tmp_path, resume=True, evaluation_episodes=4)
    assert second.finished
    assert_same(result.actor, second.actor)
    whole, resumed = (pq.read_table(path / "curves.parquet").drop(["seconds"]) for path in (folder, tmp_path))
    assert whole.equals(resumed)


def test_another_seed_gives_other_weights(finished, tiny, tmp_path):
    other = train(dataclasses.replace(tiny, seed=4, steps=20), tmp_path, evaluation_episodes=2)
    assert any(not np.array_equal(a, b) for a, b in zip(weights(finished[0].actor), weights(other.actor), strict=True))


def test_a_folder_is_not_overwritten(finished, tiny):
    with pytest.raises(TrainingError, match="--resume"):
        train(tiny, finished[1])


def test_a_checkpoint_of_another_training_is_refused(finished, tiny):
    with pytest.raises(TrainingError, match="seed is 3 there, 5 here"):
        train(dataclasses.replace(tiny, seed=5), finished[1], resume=True)


def test_a_number_that_is_none_stops_with_a_clear_error(tiny, tmp_path):
    wild = dataclasses.replace(tiny.hyperparameters, learning_rate=1e38, anneal=False)
    with pytest.raises(TrainingError, match=r"update \d: .*finite number"):
        train(dataclasses.replace(tiny, hyperparameters=wild), tmp_path)
    assert not (tmp_path / "policy.onnx").exists()


def test_an_estimate_scales_a_piece_of_an_update_to_the_whole(tiny, monkeypatch):
    clock = iter([100.0, 101.0])  # the piece, 1 of 5 steps of each game, takes a second
    monkeypatch.setattr("skyrelay.learning.training.time.perf_counter", lambda: next(clock))
    assert training.estimate(tiny) == pytest.approx(1.0 * 5 * tiny.updates)


def test_seeds_side_by_side_are_the_seeds_alone(finished, tiny, tmp_path):
    together = train_side_by_side(tiny, [3, 8], tmp_path, evaluation_episodes=4)
    assert [Policy.load(str(result.policy)).card.seeds for result in together] == [[3], [8]]
    # One program for several seeds rounds differently: the same experience to begin with, then a little apart.
    alone, same = (
        {name: row[name] for name in ("reward", "coverage")} for row in (finished[0].curves[0], together[0].curves[0])
    )
    assert same == pytest.approx(alone, rel=1e-4)
    assert together[1].curves[0]["reward"] != pytest.approx(alone["reward"], rel=1e-4)
    curves = pq.read_table(tmp_path / "seed-8" / "curves.parquet").to_pydict()
    assert curves["steps"] == [20.0, 40.0, 60.0, 80.0]
    with pytest.raises(TrainingError, match="--resume"):
        train_side_by_side(tiny, [3, 8], tmp_path)


def test_a_seed_of_several_resumes_by_itself(tiny, tmp_path):
    stopped = train_side_by_side(tiny, [3, 8], tmp_path, report=stop_after(3))
    assert not any(result.finished for result in stopped)
    resumed = train(dataclasses.replace(tiny, seed=8), tmp_path / "seed-8", resume=True, evaluation_episodes=4)
    assert resumed.finished
    assert [row["reward"] for row in resumed.curves[:3]] == [row["reward"] for row in stopped[1].curves]


def test_checkpoints_that_are_none(finished, tiny, tmp_path):
    learner = training.Course(tiny, [tiny.seed]).learner(0)
    for content in (b"", b"not a checkpoint", b"PK\x03\x04 nor this"):
        (tmp_path / "checkpoint.npz").write_bytes(content)
        with pytest.raises(TrainingError, match="a checkpoint of skyrelay train"):
            checkpoint.load(tmp_path / "checkpoint.npz", learner)
        with pytest.raises(TrainingError, match="a checkpoint of skyrelay train"):
            checkpoint.about(tmp_path / "checkpoint.npz")
    with pytest.raises(TrainingError, match="arrays"):
        checkpoint.load(finished[1] / "checkpoint.npz", learner.actor)


def test_a_checkpoint_holds_no_pickle(finished):
    with np.load(finished[1] / "checkpoint.npz", allow_pickle=False) as archive:
        assert all(archive[name].dtype != object for name in archive.files)


def test_presets():
    paper = preset("paper", (3, 3), (20, 20))
    assert paper.hyperparameters.actor.parameters == 1_692_969
    assert paper.hyperparameters.steps_per_update == 4000
    assert (paper.steps, paper.hyperparameters.epochs, paper.hyperparameters.learning_rate) == (1_000_000, 20, 3e-4)
    assert (paper.hyperparameters.gamma, paper.hyperparameters.decay, paper.hyperparameters.clip) == (0.99, 0.95, 0.2)
    assert not paper.hyperparameters.own_credit
    assert not paper.hyperparameters.shaping
    cases: list[tuple[Any, dict[str, Any]]] = [("fast", {}), ("generalist", {"games": "varied"})]
    for name, options in [*cases, ("fast", {"games": "obstacles"})]:
        looks = preset(name, (3, 3), (20, 20), **options)
        assert looks.hyperparameters.actor.maps == looks.shape.maps
        assert looks.shape.maps[-2:] == ("safe_moves", "cover_nearby")
        plain = preset(name, (3, 3), (20, 20), **options, paper_maps=True)
        assert plain.hyperparameters.actor.maps == plain.shape.maps == looks.shape.maps[:-2]
    authors = preset("authors", (3, 3), (20, 20))
    assert authors.hyperparameters.actor == paper.hyperparameters.actor
    assert authors.hyperparameters.steps_per_update == paper.hyperparameters.steps_per_update
    assert authors.shape.maps == preset("paper", (3, 3), (20, 20)).shape.maps == PAPER_MAPS
    assert not preset("fast", (3, 3), (20, 20), games="energy").shape.outlook
    with pytest.raises(UsageError, match=r"training\.steps"):
        preset("fast", (3, 3), (20, 20), steps=0)
