"""The pictures of the docs, each drawn from what the code does: `make docs-pictures`.

The process sequence from its tables, the maps and the outlook by the observer that a policy has, the animation from a
run. Only where things stand on the paper is decided here.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from collections import defaultdict
from collections.abc import Mapping
from enum import Enum
from itertools import combinations
from pathlib import Path
from typing import TypeVar

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch
from PIL import Image

from skyrelay.airspace.maps import OUTLOOK_MAPS, PAPER_MAPS
from skyrelay.airspace.observation import Observer, Scene
from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.policy import Policy
from skyrelay.protocol.sequence import UAV, VEHICLE, ZONE
from skyrelay.runfolder import new_run_folder, read_run
from skyrelay.simulation import play

IMAGES = Path(__file__).parents[2] / "docs" / "images"
INK, PALE, BLUE = "#1f2937", "#9ca3af", "#2563eb"
State = TypeVar("State", bound=Enum)
Message = TypeVar("Message", bound=Enum)
COLOURS = [mpl.colors.to_hex(colour) for colour in mpl.color_sequences["tab20"]]


def main() -> None:
    """Draw them all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, help="run folder to animate; left out: the default run is played")
    arguments = parser.parse_args()
    mpl.rcParams.update({"font.size": 9, "svg.hashsalt": "skyrelay", "svg.fonttype": "path"})
    draw_sequence("vehicle", VEHICLE)
    draw_sequence("uav", UAV)
    draw_sequence("zone", ZONE)
    draw_maps()
    draw_deployment()
    if arguments.run is not None:
        animate(arguments.run)
        return
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        with new_run_folder(run) as building:
            play(load_scenario("bologna"), building, Silent())
        animate(run)


def save(figure: Figure, name: str) -> None:
    """Into docs/images, the same bytes each time."""
    options = {"metadata": {"Date": None}} if name.endswith(".svg") else {"dpi": 110}
    figure.savefig(IMAGES / name, bbox_inches="tight", facecolor="white", **options)
    plt.close(figure)


def box(
    axes: Axes, x: float, y: float, text: str, wide: float = 0.9, high: float = 0.34, face: str = "#eef2ff"
) -> None:
    """A rounded box about a text."""
    shape = FancyBboxPatch(
        (x - wide / 2, y - high / 2), wide, high, boxstyle="round,pad=0.02,rounding_size=0.08", fc=face, ec=INK, lw=1
    )
    axes.add_patch(shape)
    axes.text(x, y, text, ha="center", va="center", color=INK, fontsize=8.5)


def draw_sequence(name: str, table: Mapping[tuple[State, Message], State]) -> None:
    """One of the process sequence's tables: a line down for each state, a row for each message and where it leads."""
    states = list(type(next(iter(table))[0]))
    column = {state: place for place, state in enumerate(states)}
    rows: dict[tuple[Message, State], list[State]] = defaultdict(list)
    for (state, message), after in table.items():
        rows[message, after].append(state)
    figure, axes = plt.subplots(figsize=(1.35 * len(states) + 2.6, 0.36 * len(rows) + 0.8))
    for state in states:
        axes.plot([column[state]] * 2, [0, len(rows)], color="#e5e7eb", lw=1, zorder=0)
        box(axes, column[state], 0, state.name.lower(), 0.78, 0.5)
    for place, ((message, after), starts) in enumerate(rows.items(), 1):
        axes.text(-0.6, place, message.value, ha="right", va="center", fontsize=8, color=INK)
        end = column[after]
        for start in (column[state] for state in starts):
            if start == end:
                axes.plot(end, place, marker=r"$\circlearrowleft$", ms=9, color=BLUE, zorder=3)
                continue
            arrow = {"arrowstyle": "-|>", "color": BLUE, "lw": 1.2, "shrinkA": 0, "shrinkB": 3}
            axes.annotate("", (end, place), (start, place), arrowprops=arrow)
            axes.plot(start, place, marker="o", ms=4, color=BLUE)
    axes.set(xlim=(-0.6, len(states) - 0.5), ylim=(len(rows) + 0.4, -0.45))
    axes.axis("off")
    save(figure, f"sequence-{name}.svg")


def draw_maps() -> None:
    """A scene and what one of its UAVs sees: the six maps, and the outlook of the policy that looks ahead."""
    rng = np.random.default_rng(4)
    uavs = np.array([[0.34, 0.36], [0.62, 0.52], [0.42, 0.74]])
    owner = np.repeat([0, 1, 2], 7)
    vehicles = np.clip(uavs[owner] + rng.uniform(-0.27, 0.27, (len(owner), 2)), 0.02, 0.98)
    reach = 0.33
    scene = Scene(uavs, vehicles, owner, np.asarray(reach), np.asarray(0.05))
    maps = Observer(tuple(PAPER_MAPS), 11, 2).look(scene)[0]

    figure = plt.figure(figsize=(9.6, 4.5))
    grid = figure.add_gridspec(2, 5, width_ratios=[1, 1, 1, 1, 1])
    show_scene(figure.add_subplot(grid[:, :2]), scene)
    axes = [figure.add_subplot(grid[row, column]) for row in range(2) for column in range(2, 5)]
    titles = (
        "own place, near",
        "own vehicles, near",
        "own place, zone",
        "team mates, zone",
        "coverage, zone",
        "own vehicles, zone",
    )
    for one, image, title in zip(axes, maps, titles, strict=True):
        one.imshow(image, origin="lower", cmap="Blues", vmin=0)
        one.set(xticks=[], yticks=[])
        one.set_title(title, fontsize=9)
    save(figure, "maps.png")

    policy = Policy.builtin("generalist")
    seen = policy.observer.look(scene)[0]
    figure, axes = plt.subplots(1, 3, figsize=(8.4, 2.9), gridspec_kw={"width_ratios": [1.15, 1, 1]})
    show_scene(axes[0], scene)
    for one, name, title in zip(
        axes[1:], OUTLOOK_MAPS, ("moves that break no link", "own vehicles covered from nearby"), strict=True
    ):
        one.imshow(seen[policy.observer.names.index(name)], origin="lower", cmap="Blues", vmin=0)
        one.set(xticks=[], yticks=[])
        one.set_title(title, fontsize=9)
    save(figure, "outlook.png")


def show_scene(axes: Axes, scene: Scene) -> None:
    """The zone from above; the UAV that looks is the first."""
    reach = float(scene.reach)
    for index, (x, y) in enumerate(scene.uavs):
        axes.add_patch(Circle((x, y), reach, color=COLOURS[2 * index], alpha=0.13, lw=0))
        mine = scene.owner == index
        axes.scatter(scene.vehicles[mine, 0], scene.vehicles[mine, 1], s=9, color=COLOURS[2 * index])
        axes.scatter(x, y, marker="^", s=70, color=COLOURS[2 * index], edgecolor=INK, zorder=3)
        for other in scene.uavs[index + 1 :]:
            if np.hypot(*(other - scene.uavs[index])) <= reach:
                axes.plot(*np.array([scene.uavs[index], other]).T, color=INK, lw=1)
    axes.annotate("looks", scene.uavs[0], (6, -14), textcoords="offset points", fontsize=8)
    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[], yticks=[], aspect="equal")
    axes.set_title("the zone", fontsize=9)


def draw_deployment() -> None:
    """Who runs what, and who speaks with whom."""
    figure, axes = plt.subplots(figsize=(10.4, 4.2))
    left, middle, right = 0.0, 4.7, 9.2
    hosts = {
        "vehicles": (left, 2.8, "vehicles\nskyrelay agent vehicle"),
        "uavs": (left, 1.4, "UAVs\nskyrelay agent uav"),
        "coordinators": (left, 0.0, "coordinators\nskyrelay agent coordinator"),
        "bus": (middle, 2.8, "bus\nsigned beacons"),
        "chain": (middle, 1.4, "consortium chain\nvalidators, the contract"),
        "store": (middle, 0.0, "model store\npolicies by CID"),
        "page": (right, 2.8, "page\nskyrelay live"),
        "audit": (right, 1.4, "anyone\nskyrelay audit"),
    }
    for kind, (x, y, text) in hosts.items():
        box(axes, x, y, text, 2.5, 0.66, "#fff7ed" if kind in ("bus", "chain", "store") else "#eef2ff")
    lines = [
        ("vehicles", "bus", "where I am", 0.5),
        ("uavs", "bus", "", 0.5),
        ("vehicles", "chain", "proposals", 0.3),
        ("uavs", "chain", "place, battery", 0.5),
        ("coordinators", "chain", "selections", 0.3),
        ("uavs", "store", "policies", 0.7),
        ("bus", "page", "positions", 0.5),
        ("chain", "audit", "every selection, again", 0.5),
    ]
    for start, end, text, along in lines:
        (x0, y0, _), (x1, y1, _) = hosts[start], hosts[end]
        x0, x1 = x0 + 1.3, x1 - 1.3
        axes.annotate("", (x1, y1), (x0, y0), arrowprops={"arrowstyle": "<|-|>", "color": PALE, "lw": 1.2})
        face = {"fc": "white", "ec": "none", "pad": 0.6}
        place = x0 + along * (x1 - x0), y0 + along * (y1 - y0)
        axes.text(*place, text, va="center", ha="center", fontsize=7, color=INK, bbox=face)
    axes.set(xlim=(-1.4, 10.6), ylim=(-0.5, 3.3), aspect="equal")
    axes.axis("off")
    save(figure, "deployment.svg")


def animate(folder: Path, wide: int = 720, every: int = 2) -> None:
    """The run from above, one frame for every second step, as an animated WebP."""
    run = read_run(folder)
    vehicles, uavs = run.vehicles, run.uavs
    reach = run.summary.range_m
    names = sorted(set(uavs["uav"].tolist()))
    colour = {name: COLOURS[index % 20] for index, name in enumerate(names)} | {"": "#c4c9d1"}
    # Towards the border the trace has little traffic: what 98 % of it drives through is shown.
    west, east = np.quantile(vehicles["x"], [0.01, 0.99])
    south, north = np.quantile(vehicles["y"], [0.01, 0.99])
    frames = []
    for step in range(0, int(uavs["step"].max()) + 1, every):
        figure = plt.figure(figsize=(wide / 100, wide / 100 * (north - south) / (east - west)), dpi=100)
        axes = figure.add_axes((0, 0, 1, 1), xlim=(west, east), ylim=(south, north), xticks=[], yticks=[])
        axes.set_facecolor("#fbfbfa")
        axes.spines[:].set_visible(False)
        now = (uavs["step"] == step) & uavs["selected"]
        at, zone = np.column_stack([uavs["x"][now], uavs["y"][now]]), uavs["zone"][now]
        painted = [colour[name] for name in uavs["uav"][now]]
        for place, paint in zip(at, painted, strict=True):
            axes.add_patch(Circle(place, reach, color=paint, alpha=0.09, lw=0))
        for one, other in combinations(range(len(at)), 2):
            if zone[one] == zone[other] and np.hypot(*(at[one] - at[other])) <= reach:
                axes.plot(*at[[one, other]].T, color=INK, lw=0.7)
        there = vehicles["step"] == step
        paints = [colour[name] for name in vehicles["uav"][there]]
        axes.scatter(vehicles["x"][there], vehicles["y"][there], s=18, c=paints, lw=0)
        axes.scatter(at[:, 0], at[:, 1], marker="^", s=46, c=painted, edgecolor=INK, lw=0.8, zorder=3)
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=100)
        plt.close(figure)
        frames.append(Image.open(buffer).convert("RGB"))
    frames[0].save(
        IMAGES / "flight.webp", save_all=True, append_images=frames[1:], duration=160, loop=0, quality=70, method=6
    )


if __name__ == "__main__":
    main()
