"""``skyrelay train``: learn a policy and export it as ONNX."""

from __future__ import annotations

import shlex
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.cli.options import Json, named_code, print_result, span
from skyrelay.core.errors import UsageError
from skyrelay.core.names import GAMES, PRESETS


def command(
    out: Annotated[Path, typer.Option("--out", help="Folder for the policy, curves and checkpoint.")],
    preset: Annotated[
        str,
        typer.Option(
            "--preset",
            help="fast (seconds on a CPU), generalist (many scales), paper (its network and table) or authors (their "
            "public code's variant of it).",
        ),
    ] = "fast",
    uavs: Annotated[str, typer.Option("--uavs", help="Team size, or a range: 2-5.")] = "3",
    vehicles: Annotated[str, typer.Option("--vehicles", help="Number of vehicles, or a range: 5-20.")] = "20",
    games: Annotated[
        str,
        typer.Option(
            "--games", help="paper (one scale), varied (many scales, traffic, drop-outs), obstacles or energy."
        ),
    ] = "paper",
    paper_maps: Annotated[
        bool, typer.Option("--paper-maps", help="Learn from the paper's six maps alone: no outlook, no guarded links.")
    ] = False,
    steps: Annotated[
        int | None, typer.Option("--steps", min=1, help="Steps of a team; left out: the preset's.", show_default=False)
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1)] = 0,
    seeds: Annotated[
        int,
        typer.Option(
            "--seeds", min=1, max=256, help="Train so many seeds side by side, each into a folder of its own."
        ),
    ] = 1,
    reward: Annotated[
        str | None,
        typer.Option(
            "--reward", metavar="MODULE:FUNCTION", help="Learn for this reward.", show_default="Eq. 3, shaped"
        ),
    ] = None,
    network: Annotated[
        str | None,
        typer.Option(
            "--network",
            metavar="MODULE:FUNCTION",
            help="From the preset's Architecture to another.",
            show_default=False,
        ),
    ] = None,
    name: Annotated[str | None, typer.Option("--name", help="Of the policy, in its card.", show_default=False)] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder's checkpoint.")] = False,
    tensorboard: Annotated[bool, typer.Option("--tensorboard", help="Also write TensorBoard event files.")] = False,
    as_json: Json = False,
) -> None:
    """Train a policy by PPO; Ctrl-C leaves a checkpoint that --resume goes on from.

    \b
    Examples:
      skyrelay train --uavs 3 --vehicles 20 --seed 1 --out policy
      skyrelay train --games obstacles --uavs 2-4 --vehicles 5-20 --out obstacles
      skyrelay train --preset generalist --games varied --uavs 1-8 --vehicles 1-40 --out generalist --resume
      skyrelay train --reward mine:reward --network mine:wider --out mine
      skyrelay train --paper-maps --steps 200000 --seeds 5 --out curves
    """
    for option, value, choices in (
        ("--preset", preset, PRESETS),
        ("--games", games, GAMES),
    ):
        if value not in choices:
            raise UsageError(option, value, "one of: " + ", ".join(choices))
    team, traffic = span("--uavs", uavs, 16), span("--vehicles", vehicles, 255)

    if seeds > 1 and (resume or tensorboard or reward):
        raise UsageError("--seeds", seeds, "1 beside --resume, --tensorboard or --reward")
    named_code(reward)
    named_code(network)

    from skyrelay.cli.training_progress import TrainingProgress
    from skyrelay.core import plugins
    from skyrelay.core.folders import sole_writer
    from skyrelay.learning.ppo import EACH, OwnReward
    from skyrelay.learning.presets import training, with_network
    from skyrelay.learning.training import estimate, train, train_side_by_side

    config = training(preset, team, traffic, steps=steps, seed=seed, games=games, paper_maps=paper_maps)  # type: ignore[arg-type]
    if network is not None:
        config = with_network(config, network, plugins.load("skyrelay.networks", network, {}, "--network"))
    decider = EACH
    if reward is not None:
        decider = OwnReward(reward, plugins.load("skyrelay.rewards", reward, {}, "--reward"))
    begin = time.monotonic()
    line = shlex.join(["skyrelay", "train", *_arguments(sys.argv)])
    with sole_writer(out), TrainingProgress() as progress:
        if preset in ("paper", "authors"):
            progress.promise(estimate(config))  # hours on a CPU
        if seeds > 1:
            results = train_side_by_side(
                config, range(seed, seed + seeds), out, report=progress, name=name, command=line
            )
            outcome, how = _outcomes(results, out), f"each by itself: --resume --seed N --out {out}/seed-N"
        else:
            result = train(
                config,
                out,
                resume=resume,
                report=progress,
                name=name,
                command=line,
                tensorboard=tensorboard,
                decider=decider,
            )
            outcome, how = _outcome(result, out), f"--resume --out {out}"
    outcome["seconds_in_all"] = round(time.monotonic() - begin, 3)
    print_result(outcome, as_json)
    if not outcome["finished"]:
        typer.echo(f"skyrelay: interrupted; go on with {how}", err=True)
        raise SystemExit(130)


def _arguments(argv: list[str]) -> list[str]:
    """What was typed after ``train``, without what belongs to this machine alone."""
    typed = iter(argv[argv.index("train") + 1 :] if "train" in argv else [])
    kept = []
    for word in typed:
        if word == "--out":
            kept += [word, Path(next(typed, "")).name]
        elif word.startswith("--out="):
            kept.append("--out=" + Path(word.removeprefix("--out=")).name)
        elif word not in ("--json", "--resume", "--tensorboard"):
            kept.append(word)
    return kept


def _outcome(result: Any, out: Path) -> dict[str, Any]:
    last = result.curves[-1] if result.curves else {}
    outcome: dict[str, Any] = {
        "finished": result.finished,
        "policy": str(result.policy) if result.policy else None,
        "folder": str(out),
        "steps": int(last.get("steps", 0)),
        "training_seconds": result.seconds,
        "compile_seconds": result.compile_seconds,
        "actor_parameters": result.actor.architecture.parameters,
    }
    for entry in result.evaluation[:1]:
        for measure in ("episode_return", "coverage", "connectivity", "connectivity_neighbor"):
            interval = getattr(entry, measure)
            outcome[measure.removeprefix("episode_")] = interval.model_dump()
    return outcome


def _outcomes(results: list[Any], out: Path) -> dict[str, Any]:
    """Of trainings side by side: what each reached in its last test, and the interval over them."""
    from skyrelay.core.statistics import interval

    last = [result.curves[-1] if result.curves else {} for result in results]
    outcome: dict[str, Any] = {
        "finished": results[0].finished,
        "folder": str(out),
        "seeds": len(results),
        "steps": int(last[0].get("steps", 0)),
        "training_seconds": results[0].seconds,
        "compile_seconds": results[0].compile_seconds,
    }
    for measure in ("return", "coverage", "connectivity"):
        values = [row[f"test_{measure}"] for row in last if f"test_{measure}" in row]
        if values:
            outcome[measure] = interval(values).closed() | {"each": values}
    return outcome
