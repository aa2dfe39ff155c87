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
from pathlib import Path
from types import FrameType
from typing import Any

import equinox as eqx
import jax
import pyarrow as pa
import pyarrow.parquet as pq

from skyrelay.coordination.settings import Domain, Shape
from skyrelay.core.errors import TrainingError
from skyrelay.core.files import atomic_path, write_bytes, write_text
from skyrelay.learning import checkpoint
from skyrelay.learning.evaluation import UNSEEN, greedy_episodes, summary
from skyrelay.learning.networks import Network
from skyrelay.learning.onnx import export
from skyrelay.learning.ppo import Learner, begin, update
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
    Raises:
        TrainingError: a number was not finite, the folder already holds a training, or the checkpoint is of another.
    """
    place = out / "checkpoint.npz"
    identity = json.loads(json.dumps(dataclasses.asdict(config)))
    if place.exists() and not resume:
        raise TrainingError(out, "a folder with a checkpoint", "another --out, or --resume to go on with it")
    report(Report("compiling", 0, config.updates, 0, 0.0))
    started = time.perf_counter()
    learner = _begin(config)
    curves: list[dict[str, float]] = []
    seconds = 0.0
    if resume:
        about = checkpoint.about(place)
        if about["training"] != identity:
            raise TrainingError(
                place, None, f"a checkpoint of this training ({_difference(about['training'], identity)})"
            )
        learner = checkpoint.load(place, learner)
        curves = pq.read_table(out / "curves.parquet").to_pylist()[: int(learner.updates)]
        seconds = curves[-1]["seconds"] if curves else 0.0
    turn = compiled_update(config, learner)
    compile_seconds = time.perf_counter() - started
    write_text(out / "training.json", json.dumps({"training": identity, "versions": versions()}, indent=2) + "\n")
    writer = _tensorboard(out) if tensorboard else None

    tests = max(1, config.test_every // config.hyperparameters.steps_per_update)
    done = int(learner.updates)
    with _interruptible() as interrupted:
        while done < config.updates and not interrupted():
            began = time.perf_counter()
            learner, metrics = turn(learner)
            metrics = jax.device_get(metrics)
            seconds += time.perf_counter() - began
            done += 1
            steps = done * config.hyperparameters.steps_per_update
            row = {"update": float(done), "steps": float(steps), "seconds": seconds}
            row |= {name: float(value) for name, value in metrics.items()}
            _check_finite(row, out)
            if done % tests == 0 or done == config.updates:
                row |= {f"test_{name}": measure["mean"] for name, measure in test(learner.actor, config).items()}
            curves.append(row)
            if done % tests == 0 or done == config.updates or interrupted():
                _save(out, learner, curves, identity)
            if writer:
                for key, value in row.items():
                    writer.add_scalar(key, value, steps)
            report(Report("training", done, config.updates, steps, seconds, row))
    if writer:
        writer.close()
    if done < config.updates:
        _save(out, learner, curves, identity)
        return Trained(learner.actor, curves, seconds, compile_seconds, False, None, [])

    report(Report("evaluating", done, config.updates, done * config.hyperparameters.steps_per_update, seconds))
    policy, evaluation = _finish(learner.actor, config, out, name or default_name(config), command, evaluation_episodes)
    return Trained(learner.actor, curves, seconds, compile_seconds, True, policy, evaluation)


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
    identities = [json.loads(json.dumps(dataclasses.asdict(one))) for one in configs]
    folders = [out / f"seed-{seed}" for seed in seeds]
    for folder in folders:
        if (folder / "checkpoint.npz").exists():
            raise TrainingError(
                folder, "a folder with a checkpoint", "another --out, or --resume to go on with it alone"
            )
    report(Report("compiling", 0, config.updates, 0, 0.0))
    started = time.perf_counter()
    keys = jax.vmap(jax.random.key)(jax.numpy.asarray(seeds, jax.numpy.uint32))
    learners: Learner = eqx.filter_jit(eqx.filter_vmap(lambda key: _begin_with(config, key)))(keys)
    turn = compiled_update(config, learners, side_by_side=True)
    compile_seconds = time.perf_counter() - started
    for folder, identity in zip(folders, identities, strict=True):
        write_text(
            folder / "training.json", json.dumps({"training": identity, "versions": versions()}, indent=2) + "\n"
        )

    curves: list[list[dict[str, float]]] = [[] for _ in seeds]
    tests = max(1, config.test_every // config.hyperparameters.steps_per_update)
    seconds, done, steps = 0.0, 0, 0

    def save() -> None:
        for index, folder in enumerate(folders):
            _save(folder, _of_seed(learners, index), curves[index], identities[index])

    with _interruptible() as interrupted:
        while done < config.updates and not interrupted():
            began = time.perf_counter()
            learners, metrics = turn(learners)
            metrics = jax.device_get(metrics)
            seconds += time.perf_counter() - began
            done += 1
            steps = done * config.hyperparameters.steps_per_update
            due = done % tests == 0 or done == config.updates
            for index, folder in enumerate(folders):
                row = {"update": float(done), "steps": float(steps), "seconds": seconds}
                row |= {measure: float(values[index]) for measure, values in metrics.items()}
                _check_finite(row, folder)
                if due:
                    measures = test(_of_seed(learners, index).actor, configs[index])
                    row |= {f"test_{measure}": found["mean"] for measure, found in measures.items()}
                curves[index].append(row)
            if due or interrupted():
                save()
            report(Report("training", done, config.updates, steps, seconds, curves[0][-1]))
    actors = [_of_seed(learners, index).actor for index in range(len(seeds))]
    if done < config.updates:
        save()
        pairs = zip(actors, curves, strict=True)
        return [Trained(actor, curve, seconds, compile_seconds, False, None, []) for actor, curve in pairs]

    report(Report("evaluating", done, config.updates, steps, seconds))
    results = []
    for actor, own, folder, curve in zip(actors, configs, folders, curves, strict=True):
        title = f"{name or default_name(config)}-seed{own.seed}"
        policy, evaluation = _finish(actor, own, folder, title, command, evaluation_episodes)
        results.append(Trained(actor, curve, seconds, compile_seconds, True, policy, evaluation))
    return results


def compiled_update(
    config: Training, learner: Learner, *, side_by_side: bool = False
) -> Callable[[Learner], tuple[Learner, dict[str, Any]]]:
    """`ppo.update` of this training, compiled for ``learner``; its argument's memory is reused.

    Args:
        side_by_side: the learner has a leading axis of seeds, and so have the results.
    """

    def one(learner: Learner) -> tuple[Learner, dict[str, Any]]:
        return update(learner, config.hyperparameters, config.domain, config.updates)

    jitted: Any = eqx.filter_jit(eqx.filter_vmap(one) if side_by_side else one, donate="all")
    compiled: Callable[[Learner], tuple[Learner, dict[str, Any]]] = jitted.lower(learner).compile()
    return compiled


def estimate(config: Training) -> float:
    """Seconds that the updates of a training will take on this machine, compilation apart.

    Times a piece of one update: the same games, networks, epochs and size of minibatches over a short horizon. Both
    collecting and optimising grow with the horizon.
    """
    whole = config.hyperparameters
    horizon = max(1, whole.horizon // whole.minibatches)
    piece = dataclasses.replace(config, hyperparameters=dataclasses.replace(whole, horizon=horizon, minibatches=1))
    learner = _begin(piece)
    turn = compiled_update(piece, learner)
    began = time.perf_counter()
    jax.device_get(turn(learner)[1])
    return (time.perf_counter() - began) * whole.horizon / horizon * config.updates


def test(actor: Network, config: Training) -> dict[str, dict[str, float]]:
    """The greedy test of a training: the same games at every test."""
    key = _test_key(config)
    return summary(greedy_episodes(actor, key, config.test_episodes, config.shape, config.domain))


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


def _begin(config: Training) -> Learner:
    learner: Learner = eqx.filter_jit(lambda key: _begin_with(config, key))(jax.random.key(config.seed))
    return learner


def _begin_with(config: Training, key: jax.Array) -> Learner:
    return begin(key, config.hyperparameters, config.shape, config.domain, config.updates)


def _of_seed(learners: Learner, row: int) -> Learner:
    """One of several learners that are trained side by side."""
    one: Learner = jax.tree.map(lambda leaf: leaf[row] if eqx.is_array(leaf) else leaf, learners)
    return one


def _finish(
    actor: Network, config: Training, out: Path, name: str, command: str, episodes: int
) -> tuple[Path, list[Evaluation]]:
    """Evaluate and export a trained policy; returns the file's path and what its card says."""
    evaluation = evaluate(actor, config, episodes)
    policy = out / "policy.onnx"
    write_bytes(policy, export(actor, make_card(config, name, command, evaluation)))
    return policy, evaluation


def _test_key(config: Training) -> jax.Array:
    return jax.random.fold_in(jax.random.key(config.seed), UNSEEN - 1)


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

    def ask(number: int, frame: FrameType | None) -> None:
        if asked.is_set():
            signal.default_int_handler(number, frame)
        asked.set()

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield asked.is_set
    finally:
        signal.signal(signal.SIGINT, before)


def _tensorboard(out: Path) -> Any:
    try:
        from tensorboardX import SummaryWriter
    except ImportError as error:
        raise TrainingError("--tensorboard", None, "the package tensorboardX (pip install tensorboardX)") from error
    return SummaryWriter(str(out / "tensorboard"))
