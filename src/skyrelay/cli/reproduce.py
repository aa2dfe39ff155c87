"""``skyrelay reproduce``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from skyrelay.cli.options import Json, print_result


def command(
    figures: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FIGURE]...", help="Left out: all; --list names them.", show_default=False),
    ] = None,
    scale: Annotated[
        str, typer.Option("--scale", metavar="SCALE", help="smoke (a minute), fast, or paper (100 seeds).")
    ] = "fast",
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="One folder a figure goes there, and claims.md.")
    ] = Path("reproduced"),
    ray: Annotated[
        str | None,
        typer.Option(
            "--ray", metavar="ADDRESS", help="Spread the work over a Ray cluster, or 'local'.", show_default=False
        ),
    ] = None,
    list_figures: Annotated[bool, typer.Option("--list", help="Name the figures, and stop.")] = False,
    as_json: Json = False,
) -> None:
    """Reproduce figures and tables of the paper: CSV, PDF, PNG, and every claim beside what was measured.

    A run that was interrupted goes on where it stopped: call it again.

    \b
    Examples:
      skyrelay reproduce selection --scale smoke
      skyrelay reproduce selection --scale paper --ray local --out results
      skyrelay reproduce selection-weights selection-distance
    """
    from skyrelay.cli.progress import ShownProgress
    from skyrelay.cli.quiet import stdout_kept_clean
    from skyrelay.experiments.claims import write_claims_page
    from skyrelay.experiments.figures import FIGURES, check_scale, load_figure, reproduce

    if list_figures:
        print_result({name: load_figure(name).title for name in FIGURES}, as_json)
        return
    names = list(dict.fromkeys(figures or FIGURES))
    chosen = check_scale(scale)
    for name in names:
        load_figure(name)  # a wrong name is said before an hour of work, not after
    result: dict[str, Any] = {}
    with ShownProgress() as progress, stdout_kept_clean():
        for name in names:
            folder = out / f"{name}-{scale}"
            rendered = reproduce(name, chosen, folder, ray=ray, progress=progress)
            result[name] = {
                "folder": str(folder),
                "files": [path.name for path in rendered.files],
                "findings": [asdict(finding) for finding in rendered.findings],
            }
        page = write_claims_page(out)
    if as_json:
        print_result({**result, "claims": str(page)}, as_json=True)
        return
    for name, entry in result.items():
        typer.echo(f"{name}: {entry['folder']} ({', '.join(entry['files'])})")
        for finding in entry["findings"]:
            typer.echo(f"  {finding['verdict']:<13}  {finding['claim']} ({finding['setting']}): {finding['measured']}")
    typer.echo(str(page))
