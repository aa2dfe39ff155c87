"""``skyrelay baseline``: play a baseline through the episodes that ``skyrelay evaluate`` flies."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from skyrelay.cli.options import Json, print_result, span


def command(
    name: Annotated[
        str,
        typer.Argument(
            help="static, random, centroid, centroid-linked, pso-placed, pso, pso-10, planner or clairvoyant."
        ),
    ],
    uavs: Annotated[str, typer.Option("--uavs", help="Team size, or a range: 2-5.")] = "3",
    vehicles: Annotated[str, typer.Option("--vehicles", help="Number of vehicles, or a range: 5-20.")] = "20",
    episodes: Annotated[int, typer.Option("--episodes", min=1, max=100_000)] = 200,
    seed: Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1)] = 0,
    as_json: Json = False,
) -> None:
    """Return, coverage and connectivity of a baseline, with 95 % intervals over episodes.

    The same numbers and seed give the same episodes as `skyrelay evaluate`.

    For example: skyrelay baseline centroid-linked --uavs 3 --vehicles 20 --episodes 200
    """
    team, traffic = span("--uavs", uavs, 16), span("--vehicles", vehicles, 255)

    from skyrelay.baselines.catalogue import evaluate_baseline

    measures = evaluate_baseline(name, team, traffic, episodes, seed)
    outcome: dict[str, Any] = {
        "baseline": name,
        "uavs": list(team),
        "vehicles": list(traffic),
        "episodes": episodes,
        "seed": seed,
        **measures,
    }
    print_result(outcome, as_json)
