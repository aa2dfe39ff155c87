"""``skyrelay baseline``: play a baseline through the episodes that ``skyrelay evaluate`` flies."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from skyrelay.cli import episodes as played
from skyrelay.cli.options import Json, named_code, print_result


def command(
    name: Annotated[
        str,
        typer.Argument(
            help="static, random, centroid, centroid-linked, cover, pso-placed, pso, pso-10, planner, clairvoyant, "
            "recharge (games with energy), or module:Player."
        ),
    ],
    uavs: played.Uavs = "3",
    vehicles: played.Vehicles = "20",
    games: played.Games = "paper",
    ratio: played.Ratio = None,
    trace: played.Trace = None,
    zone_side: played.ZoneSide = None,
    step_seconds: played.StepSeconds = 2.0,
    episodes: played.Episodes = 200,
    seed: played.Seed = 0,
    as_json: Json = False,
) -> None:
    """Return, coverage and connectivity of a baseline, with 95 % intervals over episodes.

    The same options give the same episodes as `skyrelay evaluate`.

    \b
    Examples:
      skyrelay baseline centroid-linked --uavs 3 --vehicles 20 --episodes 200
      skyrelay baseline static --uavs 4 --trace bologna
    """
    named_code(name)
    from skyrelay.baselines.catalogue import evaluate_baseline
    from skyrelay.cli.progress import ShownProgress
    from skyrelay.coordination.settings import Shape

    with ShownProgress() as progress:
        progress.stage("Games", 1)
        # No baseline looks at the maps: their size does not matter.
        starts, traces = played.unseen(
            uavs, vehicles, games, ratio, trace, zone_side, step_seconds, episodes, seed, Shape.n, Shape.zoom
        )
        progress.stage(f"Compiling, flying {episodes:,} times", 1)
        measured = evaluate_baseline(name, seed, starts, traces)
    outcome: dict[str, Any] = {"baseline": name, "uavs": uavs, "vehicles": vehicles}
    outcome |= {"trace": trace} if trace else {"games": games}
    outcome |= {"episodes": episodes, "seed": seed}
    print_result(outcome | measured, as_json)
