"""``skyrelay evaluate``: fly a policy through unseen episodes of the synthetic game."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.cli.options import Json, print_result, span
from skyrelay.core.errors import UsageError


def command(
    model: Annotated[str, typer.Argument(help="Path of an ONNX policy, or the name of a shipped one.")],
    uavs: Annotated[str, typer.Option("--uavs", help="Team size, or a range: 2-5.")] = "3",
    vehicles: Annotated[str, typer.Option("--vehicles", help="Number of vehicles, or a range: 5-20.")] = "20",
    games: Annotated[
        str, typer.Option("--games", help="paper (one scale) or varied (many scales, speeds and kinds of traffic).")
    ] = "paper",
    ratio: Annotated[
        float | None,
        typer.Option(
            "--ratio", min=1.0, max=10.0, help="Zone side over range, instead of the games' own.", show_default=False
        ),
    ] = None,
    episodes: Annotated[int, typer.Option("--episodes", min=1, max=100_000)] = 200,
    seed: Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1)] = 0,
    as_json: Json = False,
) -> None:
    """Return, coverage and connectivity (both definitions) of a policy, with 95 % intervals over episodes."""
    if games not in ("paper", "varied"):
        raise UsageError("--games", games, "one of: paper, varied")
    team, traffic = span("--uavs", uavs, 16), span("--vehicles", vehicles, 255)

    from skyrelay.policy import Policy, builtin_policies

    named = model in builtin_policies() and not Path(model).exists()
    policy = Policy.builtin(model) if named else Policy.load(Path(model))

    from skyrelay.learning.evaluation import evaluate_policy
    from skyrelay.learning.presets import games_of

    domain, shape = games_of(games, team, traffic, policy.n, policy.zoom)  # type: ignore[arg-type]
    if ratio is not None:
        domain = replace(domain, ratio=(ratio, ratio))
    measures = evaluate_policy(policy, episodes, shape, domain, seed)
    outcome: dict[str, Any] = {
        "model": policy.card.name,
        "uavs": list(team),
        "vehicles": list(traffic),
        "episodes": episodes,
        "steps": shape.steps,
        "seed": seed,
        **measures,
    }
    print_result(outcome, as_json)
