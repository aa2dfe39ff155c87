"""``skyrelay live``."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyrelay.cli.ending import until_terminated
from skyrelay.core.errors import UsageError

if TYPE_CHECKING:
    from skyrelay.runfolder.feed import Feed


def command(
    run_dir: Annotated[
        Path | None, typer.Argument(help="A folder that `skyrelay run` has left.", show_default=False)
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", metavar="FILE", help="Of a pilot: live.toml in its hosts' folder.", show_default=False
        ),
    ] = None,
    speed: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Times real time, of a run.")] = 1.0,
    host: Annotated[str, typer.Option(help="Address to serve on; beyond loopback only with a token.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to serve on; 0: any free one.")] = 8765,
    token_file: Annotated[
        Path | None, typer.Option(help="File with the token that a page has to give.", show_default=False)
    ] = None,
) -> None:
    """Show a fleet as it flies, in a browser: a run at its pace, or a pilot as it happens (Ctrl-C ends it).

    \b
    Examples:
      skyrelay live runs/bologna-1 --speed 5
      skyrelay live --config runs/bologna-1-hosts/live.toml
    """
    if (run_dir is None) == (config is None):
        raise UsageError("skyrelay live", None, "either a run's folder or a pilot's --config")
    from skyrelay.report.live import ControlRoom

    room = ControlRoom(_read_token(token_file))
    feed = _of_a_run(run_dir, speed) if run_dir is not None else _of_a_pilot(config or Path())

    async def serve() -> None:
        async with room.open(host, port) as server:
            address, bound = next(iter(server.sockets)).getsockname()[:2]
            name = f"[{address}]" if ":" in address else address
            # The token itself is in the file, and in no log.
            typer.echo(f"http://{name}:{bound}/" + ("#token=THE-TOKEN" if token_file else ""))
            await room.follow(feed)
            typer.echo("The run is at its end; the page stays. Ctrl-C ends it.")
            await server.serve_forever()

    with until_terminated():
        asyncio.run(serve())


def _of_a_run(folder: Path, speed: float) -> Feed:
    from skyrelay.report.replay import replay
    from skyrelay.runfolder import read_run

    return replay(read_run(folder), speed)


def _of_a_pilot(path: Path) -> Feed:
    from skyrelay.pilot.watch import Watch, load_watch

    return Watch(load_watch(path), lambda line: typer.echo(line, err=True)).follow()


def _read_token(path: Path | None) -> str | None:
    if path is None:
        return None
    try:
        with path.open("rb") as file:
            return file.read(1024).decode("ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError("--token-file", str(path), "a readable file with a token") from error
