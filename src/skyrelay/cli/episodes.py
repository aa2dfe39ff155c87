"""Which unseen episodes are played: options that `skyrelay evaluate` and `skyrelay baseline` share."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from skyrelay.cli.options import span
from skyrelay.core.errors import UsageError
from skyrelay.core.names import GAMES

if TYPE_CHECKING:
    from skyrelay.coordination import game


Uavs = Annotated[str, typer.Option("--uavs", help="Team size, or a range: 2-5.")]
Vehicles = Annotated[str, typer.Option("--vehicles", help="Number of vehicles, or a range: 5-20.")]
Games = Annotated[
    str,
    typer.Option("--games", help="paper (one scale), varied (many scales, traffic, drop-outs), obstacles or energy."),
]
Ratio = Annotated[
    float | None,
    typer.Option("--ratio", min=1.0, max=10.0, help="Zone side over range; left out: the games' own."),
]
Trace = Annotated[
    str | None,
    typer.Option(
        "--trace", metavar="NAME|FILE", help="Vehicles of a trace, in squares of its area at moments of its time."
    ),
]
ZoneSide = Annotated[
    float | None,
    typer.Option("--zone-side", min=1.0, help="With --trace: side of a square [m]; left out: a third of the area's."),
]
StepSeconds = Annotated[float, typer.Option("--step-seconds", min=0.1, help="With --trace: between two moves [s].")]
Episodes = Annotated[int, typer.Option("--episodes", min=1, max=100_000)]
Seed = Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1)]


def unseen(
    uavs: str,
    vehicles: str,
    games: str,
    ratio: float | None,
    trace: str | None,
    zone_side: float | None,
    step_seconds: float,
    episodes: int,
    seed: int,
    n: int,
    zoom: int,
) -> tuple[game.State, game.Trace | None]:
    """The starts of the episodes, and their vehicles where a trace is replayed.

    Raises:
        UsageError, TraceError: an option does not fit, or the trace cannot be read.
    """
    if games not in GAMES:
        raise UsageError("--games", games, "one of: " + ", ".join(GAMES))
    team, traffic = span("--uavs", uavs, 16), span("--vehicles", vehicles, 255)

    from skyrelay.coordination.replay import Setting, replayed_games
    from skyrelay.learning.evaluation import starts, unseen_key
    from skyrelay.learning.presets import games_of
    from skyrelay.mobility.tracks import open_trace

    domain, shape = games_of(games, team, traffic, n, zoom)
    if trace is not None:
        if shape.walls or shape.energy:
            raise UsageError("--games", games, "paper or varied beside --trace")
        setting = Setting(team, traffic, zone_side, ratio if ratio is not None else 2.0, step_seconds)
        return replayed_games(unseen_key(seed), open_trace(trace)[0], episodes, shape, setting)
    if zone_side is not None:
        raise UsageError("--zone-side", zone_side, "--trace beside it")
    if ratio is not None:
        domain = replace(domain, ratio=(ratio, ratio))
    return starts(unseen_key(seed), episodes, shape, domain), None
