"""The training loop: updates, tests, curves, checkpoints; and the policy file at its end.

A run's folder holds ``training.json`` (what was trained), ``checkpoint.npz``, ``curves.parquet`` and, once the steps
are spent, ``policy.onnx``. A training that stops early, for whatever reason, leaves a checkpoint to resume from; the
resumed one ends with the same weights, bit for bit.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import FrameType
from typing import Any

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Array, Key, PRNGKeyArray

from skyrelay.coordination.settings import Domain, Shape
from skyrelay.core.errors import TrainingError
from skyrelay.core.files import atomic_path, write_bytes, write_text
from skyrelay.learning import checkpoint
from skyrelay.learning.evaluation import UNSEEN, greedy_episodes, named, summary
from skyrelay.learning.networks import Network
from skyrelay.learning.onnx import export
from skyrelay.learning.ppo import EACH, Decider, Each, Learner, OwnReward, update
from skyrelay.learning.presets import Training
from skyrelay.policy.card import Card, Evaluation


@dataclass(frozen=True)
class Report:
    """How far a training is.

    Attributes:
        stage: "compiling", "training" or "evaluating".
        update, updates: done, and of the whole training.
        steps: of a team, done.
        seconds: spent in updates, compilation apart.
        row: the newest row of the curves; None before the first update.
    """

    stage: str
    update: int
    updates: int
    steps: int
    seconds: float
    row: dict[str, float] | None = None


@dataclass(frozen=True)
class Trained:
    """What a training leaves.

    Attributes:
        actor: the network.
        curves: one row an update.
        seconds: spent in updates, tests and compilation apart.
        compile_seconds: spent compiling.
        finished: false where it was interrupted.
        policy: path of the ONNX file; None where it was interrupted.
        evaluation: of the finished policy.
    """

    actor: Network
    curves: list[dict[str, float]]
    seconds: float
    compile_seconds: float
    finished: bool
    policy: Path | None
    evaluation: list[Evaluation]


def train(
    config: Training,
    out: Path,
    *,
    resume: bool = False,
    report: Callable[[Report], None] = lambda _: None,
    name: str | None = None,
    command: str = "skyrelay.learning.train",
    evaluation_episodes: int = 200,
    tensorboard: bool = False,
    decider: Each = EACH,
) -> Trained:
    """Train, test, keep curves and checkpoints, and export the policy.

    Args:
        config: what to train.
        out: the run's folder.
        resume: go on from the folder's checkpoint, which must be of the same training.
        report: called after each stage and update.
        name: of the policy; made from the preset and the numbers where left out.
        command: told in the model card.
        evaluation_episodes: unseen episodes that the finished policy is evaluated on.
        tensorboard: also write event files to ``out/tensorboard``.
        decider: what for; `skyrelay.learning.ppo.OwnReward` for a reward of one's own.
    Raises:
        TrainingError: a number was not finite, the folder already holds a training, or the checkpoint is of another.
    """
    return _train(
        [config],
        [out],
        resume,
        report,
        [name or default_name(config)],
        command,
        evaluation_episodes,
        tensorboard,
        decider,
    )[0]


def train_side_by_side(
    config: Training,
    seeds: Sequence[int],
    out: Path,
    *,
    report: Callable[[Report], None] = lambda _: None,
    name: str | None = None,
    command: str = "skyrelay.learning.train_side_by_side",
    evaluation_episodes: int = 200,
) -> list[Trained]:
    """Train several seeds at once, as one compiled program.

    Args:
        config: the training; its own seed is not used.
        seeds: one training each. Each leaves a folder ``out/seed-<n>`` as `train` does, which `train` can resume.
        report: called after each stage and update, with the first seed's row of the curves.
        name: of the policies, the seed after it.
        command, evaluation_episodes: as for `train`.
    Raises:
        TrainingError: a number was not finite, or a folder already holds a training.
    """
    configs = [dataclasses.replace(config, seed=seed) for seed in seeds]
    folders = [out / f"seed-{seed}" for seed in seeds]
    names = [f"{name or default_name(config)}-seed{seed}" for seed in seeds]
    return _train(configs, folders, False, report, names, command, evaluation_episodes, False)


def _train(
    configs: list[Training],
    folders: list[Path],
    resume: bool,
    report: Callable[[Report], None],
    names: list[str],
    command: str,
    evaluation_episodes: int,
    tensorboard: bool,
    decider: Each = EACH,
) -> list[Trained]:
    """Trainings that differ in nothing but their seeds, each into its folder."""
    config = configs[0]
    identities = [json.loads(json.dumps(dataclasses.asdict(one))) for one in configs]
    if isinstance(decider, OwnReward):
        identities = [one | {"reward": decider.name} for one in identities]
    for folder in folders:
        if (folder / "checkpoint.npz").exists() and not resume:
            raise TrainingError(folder, "a folder with a checkpoint", "another --out, or --resume to go on with it")
    report(Report("compiling", 0, config.updates, 0, 0.0))
    started = time.perf_counter()
    course = Course(config, [one.seed for one in configs], decider)
    if resume:
        course.resume(folders, identities)
    compile_seconds = time.perf_counter() - started
    writer = _tensorboard(folders[0]) if tensorboard else None

    def save() -> None:
        for index, folder in enumerate(folders):
            _save(folder, course.learner(index), course.curves[index], identities[index])

    with _interruptible() as interrupted:
        for folder, identity in zip(folders, identities, strict=True):
            told = {"training": identity, "versions": versions()}
            write_text(folder / "training.json", json.dumps(told, indent=2) + "\n")
        while not course.finished and not interrupted():
            rows = course.turn()
            for row, folder in zip(rows, folders, strict=True):
                _check_finite(row, folder)
            if course.test_is_due:
                course.test()
            if course.test_is_due or interrupted():
                save()
            if writer:
                for key, value in rows[0].items():
                    writer.add_scalar(key, value, course.steps)
            report(Report("training", course.done, config.updates, course.steps, course.seconds, rows[0]))
    if writer:
        writer.close()
    if not course.finished:
        save()
    else:
        report(Report("evaluating", course.done, config.updates, course.steps, course.seconds))
    results = []
    for index, (own, folder, name) in enumerate(zip(configs, folders, names, strict=True)):
        actor = course.learner(index).actor
        policy: Path | None = None
        evaluation: list[Evaluation] = []
        if course.finished:
            policy, evaluation = _finish(actor, own, folder, name, command, evaluation_episodes)
        curve = course.curves[index]
        results.append(Trained(actor, curve, course.seconds, compile_seconds, course.finished, policy, evaluation))
    return results


class Course:
    """The one loop of every training, turn by turn: seeds side by side, one of them or many.

    Attributes:
        config: what is trained; its own seed is not used.
        seeds: one learner each.
        learners: with a leading axis of seeds.
        curves: of each seed, one row an update.
        done: updates.
        seconds: spent in updates.

    Args:
        decider: who decides in a team.
    """

    def __init__(self, config: Training, seeds: Sequence[int], decider: Decider = EACH) -> None:
        self.config, self.seeds, self.decider = config, list(seeds), decider
        start, self._turn = _programs(dataclasses.replace(config, seed=0), len(self.seeds), decider)
        self.learners = start(_keys(self.seeds))
        self.curves: list[list[dict[str, float]]] = [[] for _ in self.seeds]
        self.done, self.seconds = 0, 0.0
        self._tests = max(1, config.test_every // config.hyperparameters.steps_per_update)

    @property
    def steps(self) -> int:
        """Of a team, done."""
        return self.done * self.config.hyperparameters.steps_per_update

    @property
    def finished(self) -> bool:
        """All updates are done."""
        return self.done >= self.config.updates

    @property
    def test_is_due(self) -> bool:
        """After the newest update."""
        return self.done % self._tests == 0 or self.finished

    def learner(self, index: int) -> Learner:
        """Of one seed, without the axis."""
        one: Learner = jax.tree.map(lambda leaf: leaf[index], self.learners)
        return one

    def turn(self) -> list[dict[str, float]]:
        """One update of every seed; returns its new rows of the curves."""
        began = time.perf_counter()
        self.learners, metrics = self._turn(self.learners)
        metrics = jax.device_get(metrics)
        self.seconds += time.perf_counter() - began
        self.done += 1
        rows = []
        for index, curve in enumerate(self.curves):
            row = {"update": float(self.done), "steps": float(self.steps), "seconds": self.seconds}
            row |= {name: float(values[index]) for name, values in metrics.items()}
            curve.append(row)
            rows.append(row)
        return rows

    def test(self) -> None:
        """Greedy tests into the newest rows; every test of a seed plays the same games."""
        for index, seed in enumerate(self.seeds):
            config = self.config
            key = jax.random.fold_in(jax.random.key(seed), UNSEEN - 1)
            actor = self.learner(index).actor
            found = greedy_episodes(actor, key, config.test_episodes, config.shape, config.domain, self.decider)
            means = named(list(np.mean(np.asarray(found), axis=1, dtype=np.float64)))
            self.curves[index][-1] |= {f"test_{name}": mean for name, mean in means.items()}

    def resume(self, folders: Sequence[Path], identities: Sequence[dict[str, Any]]) -> None:
        """Go on from checkpoints that are equally far, one of each seed.

        Raises:
            TrainingError: one cannot be read, or is of another training.
        """
        restored = []
        for index, (folder, identity) in enumerate(zip(folders, identities, strict=True)):
            place = folder / "checkpoint.npz"
            about = checkpoint.about(place)
            if about["training"] != identity:
                difference = _difference(about["training"], identity)
                raise TrainingError(place, None, f"a checkpoint of this training ({difference})")
            restored.append(checkpoint.load(place, self.learner(index)))
            self.done = int(restored[-1].updates)
            self.curves[index] = pq.read_table(folder / "curves.parquet").to_pylist()[: self.done]
            self.seconds = self.curves[index][-1]["seconds"] if self.curves[index] else 0.0
        self.learners = jax.tree.map(lambda *leaves: jax.numpy.stack(leaves), *restored)


_Start = Callable[[PRNGKeyArray], Learner]
_Turn = Callable[[Learner], tuple[Learner, dict[str, Any]]]


@lru_cache(maxsize=1)
def _programs(config: Training, count: int, decider: Decider) -> tuple[_Start, _Turn]:
    """How ``count`` trainings begin and how they go on, compiled once whatever their seeds.

    Of both, arguments and results have a leading axis of seeds; the second reuses the memory of its argument.
    """
    hyperparameters, domain, updates = config.hyperparameters, config.domain, config.updates

    def begin(key: PRNGKeyArray) -> Learner:
        return decider.begin(key, hyperparameters, config.shape, domain, updates)

    def go_on(learner: Learner) -> tuple[Learner, dict[str, Any]]:
        return update(learner, hyperparameters, domain, updates, decider)

    # One seed alone is not batched: a batch of one rounds differently, and weights are to be the same bit for bit.
    side_by_side = jax.vmap if count > 1 else _alone
    keys = _keys(range(count))
    begun = jax.jit(side_by_side(begin))
    learners = jax.eval_shape(begun, keys)
    start: _Start = begun.lower(keys).compile()
    turn: _Turn = jax.jit(side_by_side(go_on), donate_argnums=0).lower(learners).compile()
    return start, turn


def _alone(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """As `jax.vmap` along an axis of length 1, by taking the axis off and putting it on again."""

    def one(argument: Any) -> Any:
        return jax.tree.map(lambda leaf: leaf[None], function(jax.tree.map(lambda leaf: leaf[0], argument)))

    return one


def _keys(seeds: Sequence[int]) -> Key[Array, " seeds"]:
    keys: Key[Array, " seeds"] = jax.vmap(jax.random.key)(jax.numpy.asarray(seeds, jax.numpy.uint32))
    return keys


def estimate(config: Training) -> float:
    """Seconds that the updates of a training will take on this machine, compilation apart.

    Times a piece of one update: the same games, networks, epochs and size of minibatches (smaller ones, where there are
    few) over a short horizon. Both collecting and optimising grow with the horizon.
    """
    whole = config.hyperparameters
    horizon = max(1, whole.horizon // max(whole.minibatches, 10))
    piece = dataclasses.replace(config, hyperparameters=dataclasses.replace(whole, horizon=horizon, minibatches=1))
    start, turn = _programs(dataclasses.replace(piece, seed=0), 1, EACH)
    learners = start(_keys([config.seed]))
    began = time.perf_counter()
    jax.device_get(turn(learners)[1])
    return (time.perf_counter() - began) * whole.horizon / horizon * config.updates


def evaluate(actor: Network, config: Training, episodes: int) -> list[Evaluation]:
    """Unseen episodes: of the training's own games, and of the smallest and largest numbers where they vary."""
    key = jax.random.fold_in(jax.random.key(config.seed), UNSEEN)
    ranges = dict.fromkeys(
        [
            (config.domain.uavs, config.domain.vehicles),
            ((config.domain.uavs[0],) * 2, (config.domain.vehicles[1],) * 2),
            ((config.domain.uavs[1],) * 2, (config.domain.vehicles[1],) * 2),
        ]
    )
    result = []
    for uavs, vehicles in ranges:
        domain = dataclasses.replace(config.domain, uavs=uavs, vehicles=vehicles)
        measures = summary(greedy_episodes(actor, key, episodes, config.shape, domain))
        result.append(evaluation_entry(measures, domain, config.shape, episodes, config.seed))
    return result


def evaluation_entry(
    measures: dict[str, dict[str, float]], domain: Domain, shape: Shape, episodes: int, seed: int
) -> Evaluation:
    """One entry of a model card from `evaluation.summary`."""
    fields: dict[str, Any] = dict(measures)
    fields["episode_return"] = fields.pop("return")
    return Evaluation(
        uavs=domain.uavs, vehicles=domain.vehicles, episodes=episodes, steps=shape.steps, seed=seed, **fields
    )


def make_card(config: Training, name: str, command: str, evaluation: list[Evaluation]) -> Card:
    """The model card of a finished training."""
    domain = config.domain
    return Card(
        name=name,
        n=config.shape.n,
        maps=config.shape.maps,
        zoom=config.shape.zoom,
        uavs=domain.uavs,
        vehicles=domain.vehicles,
        ratio=domain.ratio,
        uav_step=domain.uav_step,
        steps=config.updates * config.hyperparameters.steps_per_update,
        seeds=[config.seed],
        preset=config.preset,
        command=command,
        versions=versions(),
        evaluation=evaluation,
        limits=(
            "Trained on synthetic vehicles in a flat square zone; where its team and its own vehicles are must be "
            "known at every step. Outside the numbers above it flies, but nothing is promised."
        ),
    )


def default_name(config: Training) -> str:
    """E.g. fast-u3-v5to20."""
    parts = [
        letter + (f"{low}" if low == high else f"{low}to{high}")
        for letter, (low, high) in (("u", config.domain.uavs), ("v", config.domain.vehicles))
    ]
    return "-".join([config.preset, *parts])


def versions() -> dict[str, str]:
    """Of the libraries that a training depends on."""
    return {name: importlib.metadata.version(name) for name in ("skyrelay", "jax", "equinox", "optax", "onnx")}


def _finish(
    actor: Network, config: Training, out: Path, name: str, command: str, episodes: int
) -> tuple[Path, list[Evaluation]]:
    """Evaluate and export a trained policy; returns the file's path and what its card says."""
    evaluation = evaluate(actor, config, episodes)
    policy = out / "policy.onnx"
    write_bytes(policy, export(actor, make_card(config, name, command, evaluation)))
    return policy, evaluation


def _check_finite(row: dict[str, float], out: Path) -> None:
    for name, value in row.items():
        if not math.isfinite(value):
            raise TrainingError(
                f"training: update {row['update']:.0f}: {name}",
                value,
                f"a finite number; the last good checkpoint is in {out}; a smaller learning rate may help",
            )


def _save(out: Path, learner: Learner, curves: list[dict[str, float]], identity: dict[str, Any]) -> None:
    """Curves first: a checkpoint never is ahead of them."""
    names = dict.fromkeys(name for row in curves for name in row)
    table = pa.table({name: pa.array([row.get(name) for row in curves], pa.float64()) for name in names})
    with atomic_path(out / "curves.parquet") as beside:
        pq.write_table(table, beside)
    checkpoint.save(out / "checkpoint.npz", learner, {"training": identity})


def _difference(theirs: dict[str, Any], ours: dict[str, Any]) -> str:
    """The first setting that differs."""
    for key, value in ours.items():
        other = theirs.get(key)
        if isinstance(value, dict) and isinstance(other, dict):
            if value != other:
                return f"{key}.{_difference(other, value)}"
        elif other != value:
            return f"{key} is {other} there, {value} here"
    return "another training"


@contextmanager
def _interruptible() -> Iterator[Callable[[], bool]]:
    """While inside, the first Ctrl-C only asks to stop after the update in progress; the second one stops at once."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set
        return

    def ask(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 (the signal module's form)
        if asked.is_set():
            signal.signal(signal.SIGINT, before)
            signal.raise_signal(signal.SIGINT)
        asked.set()

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield asked.is_set
    finally:
        signal.signal(signal.SIGINT, before)


def _tensorboard(out: Path) -> Any:
    from tensorboardX import SummaryWriter

    return SummaryWriter(str(out / "tensorboard"))
