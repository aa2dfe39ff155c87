"""``skyrelay evaluate``: fly a policy through unseen episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.cli import episodes as played
from skyrelay.cli.options import Json, print_result


def command(
    model: Annotated[str, typer.Argument(help="Path of an ONNX policy, or the name of a shipped one.")],
    uavs: played.Uavs = "3",
    vehicles: played.Vehicles = "20",
    games: played.Games = "paper",
    ratio: played.Ratio = None,
    trace: played.Trace = None,
    zone_side: played.ZoneSide = None,
    step_seconds: played.StepSeconds = 2.0,
    episodes: played.Episodes = 200,
    seed: played.Seed = 0,
    gif: Annotated[
        Path | None,
        typer.Option("--gif", metavar="FILE", help="Also the first episode, as an animation.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Return, coverage and connectivity (both definitions) of a policy, with 95 % intervals over episodes.

    \b
    Examples:
      skyrelay evaluate policy/policy.onnx --uavs 2-5 --vehicles 5-20 --seed 7
      skyrelay evaluate generalist --uavs 4 --trace bologna
      skyrelay evaluate generalist --uavs 4 --gif flight.gif
      skyrelay evaluate generalist --uavs 3 --games varied --ratio 3 --json
    """
    from skyrelay.policy import Policy

    policy = Policy.named(model)

    from skyrelay.cli.progress import ShownProgress
    from skyrelay.coordination.picture import write_gif
    from skyrelay.learning.evaluation import evaluate_policy, flight

    with ShownProgress() as progress:
        progress.stage("Games", 1)
        starts, traces = played.unseen(
            uavs, vehicles, games, ratio, trace, zone_side, step_seconds, episodes, seed, policy.n, policy.zoom
        )
        progress.stage(f"Compiling, flying {episodes:,} times", 1)
        measured = evaluate_policy(policy, starts, traces)
        if gif is not None:
            progress.stage("Animation", 1)
            write_gif(flight(policy, starts, traces), gif)
    outcome: dict[str, Any] = {"model": policy.card.name, "uavs": uavs, "vehicles": vehicles}
    outcome |= {"trace": trace} if trace else {"games": games}
    outcome |= {"episodes": episodes, "steps": starts.shape.steps, "seed": seed}
    print_result(outcome | measured, as_json)
