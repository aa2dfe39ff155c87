"""The observation of a UAV in flight, in NumPy; what the maps are is told in skyrelay.coordination.observation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from skyrelay.airspace.maps import (
    CHANNELS,
    ENERGY_MAPS,
    GLOBAL_COVERAGE,
    GLOBAL_LOCATION,
    GLOBAL_TEAM,
    GLOBAL_VEHICLES,
    LOCAL_LOCATION,
    LOCAL_VEHICLES,
    OBSTACLE_MAPS,
    OUTLOOK_MAPS,
    PAPER_MAPS,
    RANGE_MAPS,
    cell_of,
    chosen,
    energy_maps,
    footprint,
    normalise,
    obstacle_maps,
    outlook_maps,
    range_map,
)
from skyrelay.core.errors import UsageError

Floats = npt.NDArray[np.floating]
Maps = npt.NDArray[np.float32]


def observe(
    own_xy: Floats,
    team_xy: Floats,
    vehicles_xy: Floats,
    zone_corner: tuple[float, float],
    zone_side: float,
    reach: float,
    *,
    n: int,
    zoom: int,
    names: Sequence[str] = PAPER_MAPS,
    walls: Floats | None = None,
    charger: tuple[float, float, float] | None = None,
    flight: float | None = None,
    step: float | None = None,
    margins: Floats | None = None,
) -> Maps:
    """The maps of one UAV, from what it knows: itself, its team, its own vehicles, the city and its battery.

    Args:
        own_xy: [2] its position [m].
        team_xy: [M, 2] positions of the other UAVs of its team [m].
        vehicles_xy: [V, 2] positions of its own vehicles [m]; NaN where a vehicle is not there.
        zone_corner: the zone's south-west corner [m].
        zone_side: [m].
        reach: range of its links [m].
        n, zoom, names: of the policy's maps (its card tells).
        walls: [W, 5] of the buildings (`in_sight` of `airspace.flight`) [m]; None on open ground, whose maps are empty.
        charger: x, y and radius of the charging point [m]; None where there is none.
        flight: how far its charge carries it [m]; None where charge does not count.
        step: length of its move [m]; None for a policy that does not look ahead.
        margins: [M] by how much the guard holds the link to each of its team shorter than the range, for what is not
            known of where it is now [m]; None for nothing.
    Returns: [maps, n, n], normalised. Positions outside the zone are shown at its border.
    Raises:
        UsageError: ``names`` has the outlook, and there is no ``step``.
    """
    uavs = np.vstack([np.asarray(own_xy).reshape(1, 2), np.asarray(team_xy).reshape(-1, 2)])
    vehicles = np.asarray(vehicles_xy).reshape(-1, 2)
    owner = np.zeros(len(vehicles), dtype=np.int64)
    flights = None if flight is None else np.array([flight])
    held = None
    if margins is not None:
        held = np.full((len(uavs), len(uavs)), reach)
        held[0, 1:] = held[1:, 0] = np.maximum(reach - margins, 0.0)
    maps: Maps = _maps(
        uavs,
        vehicles,
        owner,
        zone_corner,
        zone_side,
        reach,
        n,
        zoom,
        names,
        walls,
        charger,
        flights,
        step,
        seers=1,
        held=held,
    )[0]
    return maps


def observe_team(
    uavs_xy: Floats,
    vehicles_xy: Floats,
    owner: npt.NDArray[np.integer],
    zone_corner: tuple[float, float],
    zone_side: float,
    reach: float,
    *,
    n: int,
    zoom: int,
    names: Sequence[str] = PAPER_MAPS,
    walls: Floats | None = None,
    charger: tuple[float, float, float] | None = None,
    flight: Floats | None = None,
    step: float | None = None,
) -> Maps:
    """The maps of every UAV of a team at once: for UAV i the same as `observe` with its own vehicles.

    Args:
        uavs_xy: [N, 2] positions [m].
        vehicles_xy: [V, 2] positions [m]; NaN where a vehicle is not there.
        owner: [V] row of the UAV that serves each vehicle; negative for none.
        flight: [N] how far its charge carries each UAV [m]; None where charge does not count.
        zone_corner, zone_side, reach, n, zoom, names, walls, charger, step: as in `observe`.
    Returns: [N, maps, n, n], normalised.
    Raises:
        UsageError: as in `observe`.
    """
    if not len(uavs_xy):
        return np.zeros((0, len(names), n, n), dtype=np.float32)
    return _maps(
        uavs_xy,
        vehicles_xy,
        owner,
        zone_corner,
        zone_side,
        reach,
        n,
        zoom,
        names,
        walls,
        charger,
        flight,
        step,
        seers=len(uavs_xy),
    )


def _maps(
    uavs_xy: Floats,
    vehicles_xy: Floats,
    owner: npt.NDArray[np.integer],
    zone_corner: tuple[float, float],
    zone_side: float,
    reach: float,
    n: int,
    zoom: int,
    names: Sequence[str],
    walls: Floats | None,
    charger: tuple[float, float, float] | None,
    flight: Floats | None,
    step: float | None,
    seers: int,
    held: Floats | None = None,
) -> Maps:
    """[seers, maps, n, n] maps of the first ``seers`` UAVs, to whom all vehicles belong.

    ``held`` [N, N] is the length at which the guard holds each link [m]; None for the range.
    """
    cells = n * zoom
    corner = np.asarray(zone_corner, dtype=np.float64)
    there = (np.asarray(owner) >= 0) & np.isfinite(vehicles_xy).all(axis=-1)
    uavs = ((np.asarray(uavs_xy, dtype=np.float64) - corner) / zone_side).clip(0.0, 1.0)
    # One that has left the zone is in the maps' nearest cell; where it would be covered from goes by its true place.
    anywhere = (np.asarray(vehicles_xy, dtype=np.float64)[there] - corner) / zone_side
    vehicles = anywhere.clip(0.0, 1.0)
    of = np.asarray(owner)[there]

    uav_cell, vehicle_cell = cell_of(uavs, cells), cell_of(vehicles, cells)
    window = (uav_cell - n // 2).clip(0, cells - n)
    in_window = vehicle_cell - window[of]
    seen = ((in_window >= 0) & (in_window < n)).all(axis=-1)

    levels = np.zeros((seers, CHANNELS, n, n), dtype=np.float32)
    seer = np.arange(seers)
    local, whole = (uav_cell - window)[:seers], (2.0 * zoom) ** 2
    levels[seer, LOCAL_LOCATION, local[:, 1], local[:, 0]] = whole
    np.add.at(levels[:, LOCAL_VEHICLES], (of[seen], in_window[seen, 1], in_window[seen, 0]), whole)
    location = np.zeros((len(uavs), n, n), dtype=np.float32)
    _scatter(location, np.arange(len(uavs)), uav_cell, n, zoom)
    levels[:, GLOBAL_LOCATION] = location[:seers]
    levels[:, GLOBAL_TEAM] = location.sum(axis=0) - location[:seers]
    _scatter(levels[:, GLOBAL_VEHICLES], of, vehicle_cell, n, zoom)

    centre = (np.arange(cells) + 0.5) / cells
    x2 = (uavs[:, 0, None] - centre) ** 2
    y2 = (uavs[:, 1, None] - centre) ** 2
    near = y2[:, :, None] + x2[:, None, :] <= (reach / zone_side) ** 2
    levels[:, GLOBAL_COVERAGE] = near.sum(axis=0).reshape(n, zoom, n, zoom).sum(axis=(1, 3))

    has: tuple[str, ...] = PAPER_MAPS
    more: tuple[Floats, ...] = ()
    own = of == seer[:, None]
    zone_walls = None
    if walls is not None:
        zone_walls = np.column_stack([(walls[:, :4] - np.tile(corner, 2)) / zone_side, walls[:, 4]])
    if zone_walls is not None and set(OBSTACLE_MAPS) & set(names):
        has += OBSTACLE_MAPS
        built = footprint(zone_walls, cells)
        more += obstacle_maps(window[:seers], own, vehicles, reach / zone_side, zone_walls, built, n, zoom)
    if charger is not None and flight is not None:
        has += ENERGY_MAPS
        point, radius = (np.array(charger[:2]) - corner) / zone_side, charger[2] / zone_side
        near = ((uavs[:seers] - point) ** 2).sum(axis=-1) <= radius**2
        more += energy_maps(window[:seers], point, np.asarray(flight, dtype=np.float64) / zone_side, near, n, zoom)
    if set(RANGE_MAPS) & set(names):
        has += RANGE_MAPS
        more += (range_map(np.asarray(reach / zone_side), seers, n),)
    if set(OUTLOOK_MAPS) & set(names):
        if step is None:
            raise UsageError("step", step, "the length of a UAV's move [m]: this policy looks ahead")
        has += OUTLOOK_MAPS
        lengths = np.asarray(reach / zone_side), np.asarray(step / zone_side)
        links = None if held is None else held / zone_side
        moves, cover = outlook_maps(uavs, np.ones(len(uavs), bool), own, anywhere, *lengths, n, zone_walls, links)
        more += (moves[:seers], cover)
    if more:
        levels = np.concatenate([levels, np.stack(more, axis=1).astype(np.float32)], axis=1)
    maps: Maps = chosen(normalise(levels, zoom, has), has, names)
    return maps


def _scatter(maps: Maps, row: npt.NDArray[np.int64], cell: npt.NDArray[np.int64], n: int, zoom: int) -> None:
    """Add points at full-map cells to coarse maps, shared among the four nearest coarse cells, in 1 / (2 zoom)^2."""
    near = cell // zoom
    offset = 2 * (cell % zoom) + 1 - zoom
    far = (near + np.sign(offset)).clip(0, n - 1)
    sides = ((near, 2 * zoom - abs(offset)), (far, abs(offset)))
    for columns, column_weight in sides:
        for rows, row_weight in sides:
            np.add.at(
                maps, (row, rows[:, 1], columns[:, 0]), (column_weight[:, 0] * row_weight[:, 1]).astype(np.float32)
            )
