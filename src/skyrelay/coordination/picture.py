"""A game as a picture: UAVs, their range and links, and the vehicles, each in the colour of its UAV."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import jax
import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from skyrelay.airspace.flight import links
from skyrelay.coordination import game
from skyrelay.core.files import atomic_path

PIXELS = 480
"""Side of a picture."""
MILLISECONDS = 120
"""That each picture of an animation stands."""


def picture(state: game.State) -> npt.NDArray[np.uint8]:
    """One state [480, 480, 3]."""
    figure = Figure(figsize=(4.8, 4.8), dpi=PIXELS / 4.8)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.92))
    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[], yticks=[], aspect="equal")
    colours = mpl.colormaps["tab20"].colors  # type: ignore[attr-defined]
    uavs, flying = np.asarray(state.uavs), np.asarray(state.flying)
    reach, vehicles = float(state.parameters.reach), np.asarray(state.traffic.position)
    if state.parameters.walls is not None:
        for x0, y0, x1, y1 in np.asarray(state.parameters.walls)[:, :4]:
            axes.plot([x0, x1], [y0, y1], color="0.3", linewidth=1)
    if state.parameters.charging is not None:
        axes.plot(*np.asarray(state.parameters.charging.point), "P", color="0.2", markersize=9)
    linked = np.asarray(links(uavs, reach, flying))
    for one, other in np.argwhere(np.triu(linked, 1)):
        axes.plot(*uavs[[one, other]].T, color="0.4", linewidth=1.5)
    served_by = np.asarray(state.served_by)
    for row, place in enumerate(uavs):
        if not flying[row]:
            continue
        colour = colours[row % len(colours)]
        axes.add_patch(mpl.patches.Circle(place, reach, color=colour, alpha=0.1))
        axes.plot(*place, "^", color=colour, markersize=10, markeredgecolor="black")
        axes.plot(*vehicles[served_by == row].T, ".", color=colour, markersize=7)
    score = jax.device_get(game.measure(state))
    linked_now = "linked" if score.connectivity else "not linked"
    axes.set_title(f"step {int(state.time)}: coverage {float(score.coverage):.2f}, {linked_now}", fontsize=9)
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels: npt.NDArray[np.uint8] = np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]
    return pixels


def write_gif(states: Iterable[game.State], path: Path) -> None:
    """States, one after the other, as an animation."""
    from PIL import Image  # it comes with matplotlib

    first, *others = [Image.fromarray(picture(state)) for state in states]
    with atomic_path(path) as beside:
        first.save(beside, format="GIF", save_all=True, append_images=others, duration=MILLISECONDS, loop=0)
