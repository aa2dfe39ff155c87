"""``skyrelay live``."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from skyrelay.core.errors import UsageError


def command(
    run_dir: Annotated[Path, typer.Argument(help="A folder that `skyrelay run` has left.", show_default=False)],
    speed: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Times real time.")] = 1.0,
    host: Annotated[str, typer.Option(help="Address to serve on; beyond loopback only with a token.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to serve on; 0: any free one.")] = 8765,
    token_file: Annotated[
        Path | None, typer.Option(help="File with the token that a page has to give.", show_default=False)
    ] = None,
) -> None:
    """Show a fleet as it flies, in a browser: skyrelay live runs/bologna-1 (Ctrl-C ends it)."""
    from skyrelay.report.live import ControlRoom
    from skyrelay.report.replay import replay
    from skyrelay.runfolder import read_run

    room = ControlRoom(_read_token(token_file))
    run = read_run(run_dir)

    async def serve() -> None:
        async with room.open(host, port) as server:
            address, bound = next(iter(server.sockets)).getsockname()[:2]
            name = f"[{address}]" if ":" in address else address
            # The token itself is in the file, and in no log.
            typer.echo(f"http://{name}:{bound}/" + ("#token=THE-TOKEN" if token_file else ""))
            await room.follow(replay(run, speed))
            typer.echo("The run is at its end; the page stays. Ctrl-C ends it.")
            await server.serve_forever()

    asyncio.run(serve())


def _read_token(path: Path | None) -> str | None:
    if path is None:
        return None
    try:
        with path.open("rb") as file:
            return file.read(1024).decode("ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError("--token-file", str(path), "a readable file with a token") from error
