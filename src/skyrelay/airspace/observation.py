"""What a UAV sees: one description of what there is, one observer that draws the maps of it.

The paper's six come from four full maps over the zone, h x h cells, h = zoom x n (Section "MDRL Formulation", Fig.
"Observations"): the UAV's own cell; how many *other* UAVs are in each; how many of the team have its centre in range;
how many of the UAV's *own* vehicles are there. Of these the policy gets, each [n, n], row = y from south, column = x
from west:

- local: a window of n x n cells about the UAV, shifted inward at the zone's border;
- global: the full map downsampled bilinearly, what is in a cell being shared among the four coarse cells whose centres
  surround it, so that where it lay between them is not lost; coverage is summed over blocks of zoom x zoom.

In the units of `skyrelay.airspace.maps.Unit` all this is whole numbers ("levels"). A UAV in flight draws them here,
with NumPy. The compiled game draws the six with one scatter (`skyrelay.coordination.observation`) and takes the maps of
the options from here; the tests hold both against plain loops that do materialise the full maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from skyrelay.airspace.charge import Charger, at_charger
from skyrelay.airspace.maps import (
    ENERGY_MAPS,
    GLOBAL_COVERAGE,
    GLOBAL_LOCATION,
    GLOBAL_TEAM,
    GLOBAL_VEHICLES,
    LOCAL_LOCATION,
    LOCAL_VEHICLES,
    MAPS,
    OBSTACLE_MAPS,
    OUTLOOK_MAPS,
    PAPER_MAPS,
    RANGE_MAPS,
    cell_of,
    energy_maps,
    footprint,
    normalise,
    obstacle_maps,
    outlook_maps,
    range_map,
    tent,
    window_of,
)
from skyrelay.core.errors import UsageError

Floats = npt.NDArray[np.floating]
Maps = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Scene:
    """A team over its zone, in zone sides from the zone's south-west corner; arrays of NumPy or of JAX.

    Attributes:
        uavs: [N, 2] positions, in [0, 1].
        vehicles: [V, 2] positions; one that has left the zone is outside [0, 1].
        owner: [V] row of the UAV that serves each vehicle; negative where there is no vehicle.
        reach: range of the links, an array of one number.
        step: length of a move, an array of one number; None where nobody looks ahead.
        airborne: [N] whether a UAV is there, in the air; None where all are.
        walls: [W, 5] of the buildings (`skyrelay.airspace.flight.in_sight`); None on open ground.
        built: [h, h] from `footprint`; None to have it drawn.
        charger: the charging point; None where there is none.
        flight: [N], or of the first few: how far its charge carries each UAV.
        held: [N, N] length at which the guard holds each link; None for the range.
    """

    uavs: Any
    vehicles: Any
    owner: Any
    reach: Any
    step: Any = None
    airborne: Any = None
    walls: Any = None
    built: Any = None
    charger: Charger | None = None
    flight: Any = None
    held: Any = None

    @classmethod
    def in_metres(
        cls,
        uavs: Floats,
        vehicles: Floats,
        owner: npt.NDArray[np.integer],
        corner: tuple[float, float],
        side: float,
        reach: float,
        *,
        step: float | None = None,
        walls: Floats | None = None,
        charger: tuple[float, float, float] | None = None,
        flight: Floats | None = None,
        held: Floats | None = None,
    ) -> Scene:
        """From lengths in metres; UAVs outside the zone are put at its border, vehicles at NaN are left out.

        Args:
            corner, side: of the zone.
            charger: x, y and radius of the charging point.
        """
        there = (np.asarray(owner) >= 0) & np.isfinite(vehicles).all(axis=-1)
        south_west = np.asarray(corner, dtype=np.float64)
        scaled_walls = point = None
        if walls is not None:
            scaled_walls = np.column_stack([(walls[:, :4] - np.tile(south_west, 2)) / side, walls[:, 4]])
        if charger is not None:
            point = Charger((np.array(charger[:2]) - south_west) / side, np.asarray(charger[2] / side))
        return cls(
            uavs=((np.asarray(uavs, dtype=np.float64) - south_west) / side).clip(0.0, 1.0),
            vehicles=(np.asarray(vehicles, dtype=np.float64)[there] - south_west) / side,
            owner=np.asarray(owner)[there],
            reach=np.asarray(reach / side),
            step=None if step is None else np.asarray(step / side),
            walls=scaled_walls,
            charger=point,
            flight=None if flight is None else np.asarray(flight, dtype=np.float64) / side,
            held=None if held is None else held / side,
        )


@dataclass(frozen=True, slots=True)
class Observer:
    """Draws the maps that a policy looks at.

    Attributes:
        names: of the maps: the six, then those of options (`skyrelay.airspace.maps.MAPS`).
        n: side of a map [cells].
        zoom: of the full maps over n.
    """

    names: tuple[str, ...]
    n: int
    zoom: int

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of one UAV's maps."""
        return len(self.names), self.n, self.n

    def greatest(self, uavs: int) -> Maps:
        """[maps, n, n] the greatest input of each cell in a team of so many; the least is 0."""
        top = np.array([MAPS[name].greatest(uavs) for name in self.names], dtype=np.float32)
        return np.broadcast_to(top[:, None, None], self.shape).copy()

    def look(self, scene: Scene, seers: int | None = None) -> Maps:
        """[seers, maps, n, n] the input of the first UAVs of a NumPy scene, of all where left out.

        Where only the first few look, all vehicles are theirs. Maps of what there is not are empty.

        Raises:
            UsageError: the maps are of who looks ahead, and the scene has no step.
        """
        count = len(scene.uavs) if seers is None else seers
        if count == 0:
            return np.zeros((0, *self.shape), dtype=np.float32)
        levels = [*np.moveaxis(six_maps(scene, self.n, self.zoom, count), 1, 0), *self.further(scene, count)]
        maps: Maps = normalise(np.stack(levels, axis=1).astype(np.float32), self.zoom, self.names)
        return maps

    def further(self, scene: Scene, seers: int | None = None) -> list[Any]:
        """The options' maps, in order, as levels [seers, n, n] each (arguments as `look`, of NumPy or JAX)."""
        n, zoom, wanted = self.n, self.zoom, frozenset(self.names)
        if wanted <= frozenset(PAPER_MAPS):
            return []
        xp = scene.uavs.__array_namespace__()
        window = window_of(scene.uavs, n, zoom)[:seers]
        own = scene.owner == xp.arange(scene.uavs.shape[0])[:seers, None]
        nothing = xp.zeros((window.shape[0], n, n))
        maps: list[Any] = []
        if wanted & frozenset(OBSTACLE_MAPS):
            if scene.walls is None:
                maps += [nothing] * len(OBSTACLE_MAPS)
            else:
                built = footprint(scene.walls, n * zoom) if scene.built is None else scene.built
                shown = xp.clip(scene.vehicles, 0.0, 1.0)
                maps += obstacle_maps(window, own, shown, scene.reach, scene.walls, built, n, zoom)
        if wanted & frozenset(ENERGY_MAPS):
            if scene.charger is None or scene.flight is None:
                maps += [nothing] * len(ENERGY_MAPS)
            else:
                charged = at_charger(scene.uavs[:seers], scene.charger)
                maps += energy_maps(window, scene.charger.point, scene.flight[:seers], charged, n, zoom)
        if wanted & frozenset(RANGE_MAPS):
            maps.append(range_map(scene.reach, window.shape[0], n))
        if wanted & frozenset(OUTLOOK_MAPS):
            if scene.step is None:
                raise UsageError("step", None, "the length of a UAV's move [m]: this policy looks ahead")
            airborne = xp.ones(scene.uavs.shape[0], dtype=xp.bool) if scene.airborne is None else scene.airborne
            reach, step = scene.reach, scene.step
            moves, cover = outlook_maps(
                scene.uavs, airborne, own, scene.vehicles, reach, step, n, scene.walls, scene.held
            )
            maps += [moves[:seers], cover]
        return maps


def six_maps(scene: Scene, n: int, zoom: int, seers: int) -> Maps:
    """[seers, 6, n, n] `PAPER_MAPS` of the first UAVs of a NumPy scene, as levels."""
    cells, whole, seer = n * zoom, (2.0 * zoom) ** 2, np.arange(seers)
    # One that has left the zone is in the maps' nearest cell.
    uav_cell, vehicle_cell = cell_of(scene.uavs, cells), cell_of(scene.vehicles.clip(0.0, 1.0), cells)
    window = window_of(scene.uavs, n, zoom)
    in_window = vehicle_cell - window[scene.owner]
    seen = ((in_window >= 0) & (in_window < n)).all(axis=-1)

    levels = np.zeros((seers, len(PAPER_MAPS), n, n), dtype=np.float32)
    local = (uav_cell - window)[:seers]
    levels[seer, LOCAL_LOCATION, local[:, 1], local[:, 0]] = whole
    np.add.at(levels[:, LOCAL_VEHICLES], (scene.owner[seen], in_window[seen, 1], in_window[seen, 0]), whole)
    location = np.zeros((len(scene.uavs), n, n), dtype=np.float32)
    _scatter(location, np.arange(len(scene.uavs)), uav_cell, n, zoom)
    levels[:, GLOBAL_LOCATION] = location[:seers]
    levels[:, GLOBAL_TEAM] = location.sum(axis=0) - location[:seers]
    _scatter(levels[:, GLOBAL_VEHICLES], scene.owner, vehicle_cell, n, zoom)

    centre = (np.arange(cells) + 0.5) / cells
    x2 = (scene.uavs[:, 0, None] - centre) ** 2
    y2 = (scene.uavs[:, 1, None] - centre) ** 2
    near = y2[:, :, None] + x2[:, None, :] <= scene.reach**2
    levels[:, GLOBAL_COVERAGE] = near.sum(axis=0).reshape(n, zoom, n, zoom).sum(axis=(1, 3))
    return levels


def _scatter(maps: Maps, row: npt.NDArray[np.integer], cell: npt.NDArray[np.integer], n: int, zoom: int) -> None:
    """Add points at full-map cells to coarse maps, each shared among the four nearest coarse cells."""
    near, far, near_share, far_share = tent(cell, n, zoom)
    sides = ((near, near_share), (far, far_share))
    for columns, column_share in sides:
        for rows, row_share in sides:
            share = (column_share[:, 0] * row_share[:, 1]).astype(np.float32)
            np.add.at(maps, (row, rows[:, 1], columns[:, 0]), share)
