"""``skyrelay evaluate``: fly a policy through unseen episodes, or everybody through a suite of tasks."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.cli import episodes as played
from skyrelay.cli.options import Json, print_result
from skyrelay.core.errors import UsageError

_OF_A_SUITE = ("policy", "only", "out", "ray")
"""Options that mean something beside ``--suite`` only."""


def command(
    context: typer.Context,
    model: Annotated[
        str | None,
        typer.Argument(help="Path of an ONNX policy, or the name of a shipped one.", show_default=False),
    ] = None,
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
    suite: Annotated[
        str | None,
        typer.Option("--suite", metavar="NAME", help="Everybody through a fixed set of tasks.", show_default=False),
    ] = None,
    list_suites: Annotated[bool, typer.Option("--list-suites", help="Name the suites, and stop.")] = False,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            "--policy",
            metavar="NAME=FILE[,FILE...]",
            help="With --suite: plays, too. Several files, or a folder of folders: trainings of one method.",
            show_default=False,
        ),
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            "--only", metavar="NAME[,NAME...]", help="With --suite: of what is shipped, these.", show_default="all"
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="With --suite: its folder.", show_default="suites/NAME"),
    ] = None,
    ray: Annotated[
        str | None,
        typer.Option(
            "--ray", metavar="ADDRESS", help="With --suite: spread over a Ray cluster, or 'local'.", show_default=False
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Return, coverage and connectivity (both definitions) of a policy, with 95 % intervals over episodes.

    With --suite every shipped policy, every rule and every --policy plays the same episodes of fixed tasks; the folder
    has a leaderboard.html. A suite that was interrupted goes on where it stopped: call it again.

    \b
    Examples:
      skyrelay evaluate policy/policy.onnx --uavs 2-5 --vehicles 5-20 --seed 7
      skyrelay evaluate generalist --uavs 4 --trace bologna
      skyrelay evaluate generalist --uavs 4 --gif flight.gif
      skyrelay evaluate generalist --uavs 3 --games varied --ratio 3 --json
      skyrelay evaluate --suite sizes
      skyrelay evaluate --suite all --policy mine=trained/seed-1,trained/seed-2 --only cover,generalist
    """
    given = {name: _option(context, name) for name in context.params if _typed(context, name)}
    if list_suites:
        from skyrelay.experiments.suite_tasks import suites

        print_result({name: one.title for name, one in suites().items()}, as_json)
        return
    if suite is not None:
        alien = [option for name, option in given.items() if name not in (*_OF_A_SUITE, "suite", "as_json")]
        if alien:
            raise UsageError("--suite", suite, f"no {alien[0]} beside it: what its tasks are is fixed")
        _play(suite, policy or [], only.split(",") if only else [], out, ray, as_json)
        return
    of_a_suite = [option for name, option in given.items() if name in _OF_A_SUITE]
    if of_a_suite:
        raise UsageError(of_a_suite[0], context.params[next(n for n in given if n in _OF_A_SUITE)], "--suite beside it")
    if model is None:
        raise UsageError("MODEL", None, "an ONNX file, the name of a shipped policy, or --suite")

    from skyrelay.policy import Policy

    flies = Policy.named(model)

    from skyrelay.cli.progress import ShownProgress
    from skyrelay.coordination.picture import write_gif
    from skyrelay.learning.evaluation import evaluate_policy, flight

    with ShownProgress() as progress:
        progress.stage("Games", 1)
        starts, traces = played.unseen(
            uavs, vehicles, games, ratio, trace, zone_side, step_seconds, episodes, seed, flies.n, flies.zoom
        )
        progress.stage(f"Compiling, flying {episodes:,} times", 1)
        measured = evaluate_policy(flies, starts, traces)
        if gif is not None:
            progress.stage("Animation", 1)
            write_gif(flight(flies, starts, traces), gif)
    outcome: dict[str, Any] = {"model": flies.card.name, "uavs": uavs, "vehicles": vehicles}
    outcome |= {"trace": trace} if trace else {"games": games}
    outcome |= {"episodes": episodes, "steps": starts.shape.steps, "seed": seed}
    print_result(outcome | measured, as_json)


def _typed(context: typer.Context, name: str) -> bool:
    """Whether a parameter is from the command line, not a default."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _option(context: typer.Context, name: str) -> str:
    """What an option or argument is called on the command line."""
    return next(parameter.opts[0] for parameter in context.command.params if parameter.name == name)


def _play(name: str, given: list[str], only: list[str], out: Path | None, ray: str | None, as_json: bool) -> None:
    """Everybody through a suite."""
    from skyrelay.cli.progress import ShownProgress
    from skyrelay.cli.quiet import stdout_kept_clean
    from skyrelay.experiments.suite import entrants, play
    from skyrelay.experiments.suite_tasks import suite_of
    from skyrelay.report.leaderboard import write_leaderboard

    suite = suite_of(name)
    playing = entrants(suite, given, only)
    folder = out if out is not None else Path("suites") / suite.name
    words = ["skyrelay", "evaluate", "--suite", suite.name, *(word for text in given for word in ("--policy", text))]
    words += ["--only", ",".join(only)] if only else []
    with ShownProgress() as progress, stdout_kept_clean():
        told = play(suite, playing, folder, ray=ray, progress=progress, command=shlex.join(words))
        page = write_leaderboard(folder)
    if as_json:
        print_result({**told, "leaderboard": str(page)}, as_json=True)
        return
    width = max(len(method["name"]) for method in told["methods"])
    for method in told["methods"]:
        if method["complete"]:
            iqm = method["iqm"]
            text = f"IQM {iqm['mean']:.3f} [{iqm['low']:.3f}, {iqm['high']:.3f}]"
            if "improvement" in method:
                text += f", better than {told['reference']} with {method['improvement']['mean']:.2f}"
        else:
            text = f"{len(method['tasks'])} of {len(told['tasks'])} tasks"
        typer.echo(f"{method['name']:<{width}}  {text}")
    typer.echo(str(page))
