"""The observation maps by name and number, how their levels become a network's input, and the maps of the options.

JAX and NumPy share all of it: functions are for any array library of the Python array API standard.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Literal

import numpy as np

from skyrelay.airspace.flight import ACTIONS, in_sight, unit_moves
from skyrelay.airspace.guard import safe_moves

LOCAL_LOCATION, LOCAL_VEHICLES, GLOBAL_LOCATION, GLOBAL_TEAM, GLOBAL_COVERAGE, GLOBAL_VEHICLES = range(6)
CHANNELS = 6

VEHICLE_SCALE = 8.0
"""What all of a UAV's own vehicles together come to in one cell."""


class Kind(Enum):
    """Where the cells of a map lie."""

    WINDOW = "a window of the full map about the UAV, shifted inward at the zone's border"
    ZONE = "blocks over the whole zone"
    EVERYWHERE = "one number, the same in every cell"
    PLACES = "places about the UAV, wherever the border is"


class Unit(Enum):
    """What a level of 1 stands for; levels are whole numbers."""

    PLACE = "1 / (2 zoom)^2 of what lies in a cell"
    CELL = "a cell"
    BLOCK = "a cell of a block of zoom x zoom"
    NUMBER = "1 / 255 of the greatest number"
    OWN_PLACE = "a place of an own vehicle, as a share of them all"
    OWN = "an own vehicle, as a share of them all"
    OWN_PART = "1 / 8 of an own vehicle, as a share of them all"


@dataclass(frozen=True, slots=True)
class Map:
    """One map of the observation.

    Attributes:
        name: in a policy's card.
        option: of the game or the run that has it; `paper` is always on.
        kind: where its cells lie.
        unit: what its levels count.
        scale: what the input comes to where the map is full: by `meaning`, for one UAV. Maps of one cell and maps of
            many then weigh about the same, which is what a network learns fastest from.
        meaning: what is in a cell.
        sums: the UAVs that add up in a cell: none but itself, its mates, or the whole team.
    """

    name: str
    option: str
    kind: Kind
    unit: Unit
    scale: float
    meaning: str
    sums: Literal["itself", "mates", "team"] = "itself"

    def factor(self, zoom: int, share: Any) -> Any:
        """From levels to input.

        Args:
            share: `VEHICLE_SCALE` over the places of all own vehicles.
        """
        whole = (2 * zoom) ** 2
        match self.unit:
            case Unit.PLACE:
                return self.scale / whole
            case Unit.CELL:
                return self.scale
            case Unit.BLOCK:
                return self.scale / zoom**2
            case Unit.NUMBER:
                return self.scale / FAR_LEVEL
            case Unit.OWN_PLACE:
                return share * (self.scale / VEHICLE_SCALE)
            case Unit.OWN:
                return share * (self.scale * whole / VEHICLE_SCALE)
            case Unit.OWN_PART:
                return share * (self.scale * whole / (VEHICLE_SCALE * COVER_PARTS))

    def greatest(self, uavs: int) -> float:
        """The greatest input in a team of so many."""
        return self.scale * {"itself": 1, "mates": max(uavs - 1, 1), "team": uavs}[self.sums]


_TABLE = (
    Map("local_location", "paper", Kind.WINDOW, Unit.PLACE, 4.0, "the UAV"),
    Map("local_vehicles", "paper", Kind.WINDOW, Unit.OWN_PLACE, VEHICLE_SCALE, "its own vehicles"),
    Map("global_location", "paper", Kind.ZONE, Unit.PLACE, 4.0, "the UAV"),
    Map("global_team", "paper", Kind.ZONE, Unit.PLACE, 2.0, "its team mates", "mates"),
    Map("global_coverage", "paper", Kind.ZONE, Unit.BLOCK, 0.1, "cells in range of a UAV, for each UAV", "team"),
    Map("global_vehicles", "paper", Kind.ZONE, Unit.OWN_PLACE, VEHICLE_SCALE, "its own vehicles"),
    Map("local_buildings", "obstacles", Kind.WINDOW, Unit.CELL, 0.5, "a building"),
    Map("global_buildings", "obstacles", Kind.ZONE, Unit.BLOCK, 0.5, "built-up cells"),
    Map("local_sight", "obstacles", Kind.WINDOW, Unit.OWN, 3.0, "own vehicles in range and in sight from here"),
    Map("local_charger", "energy", Kind.WINDOW, Unit.PLACE, 4.0, "the charging point"),
    Map("global_charger", "energy", Kind.ZONE, Unit.PLACE, 4.0, "the charging point"),
    Map("own_flight", "energy", Kind.EVERYWHERE, Unit.NUMBER, 2.0, "how far the charge carries, of `FAR` zone sides"),
    Map("at_charger", "energy", Kind.EVERYWHERE, Unit.CELL, 1.0, "whether hovering here charges"),
    Map("own_range", "range", Kind.EVERYWHERE, Unit.NUMBER, 1.0, "how far the links reach, of a zone side"),
    Map("safe_moves", "outlook", Kind.PLACES, Unit.CELL, 1.0, "whether the move that heads here keeps the links"),
    Map("cover_nearby", "outlook", Kind.PLACES, Unit.OWN_PART, 3.0, "own vehicles in range from here"),
)
MAPS: Mapping[str, Map] = {entry.name: entry for entry in _TABLE}
"""Every map that there is, in order: name, what it shows, how it becomes input."""


def _of(option: str) -> tuple[str, ...]:
    return tuple(entry.name for entry in _TABLE if entry.option == option)


PAPER_MAPS = _of("paper")
"""The six that every policy sees, in the order of their numbers."""
OBSTACLE_MAPS = _of("obstacles")
"""After the six where there are buildings."""
ENERGY_MAPS = _of("energy")
"""After those where charge counts."""
RANGE_MAPS = _of("range")
"""After those where games are of many scales."""
OUTLOOK_MAPS = _of("outlook")
"""Last, where a UAV looks ahead."""

NEARBY = 1.25
"""The k-th ring of cells of `cover_nearby` are places k to this power steps of a UAV away; its first, the 8 moves'."""
COVER_PARTS = 8
"""Levels of `cover_nearby` for a vehicle that is surely in range; fewer where half a move would change it.

Bytes then hold as many vehicles as they do in the six maps (28).
"""
FAR = 2.0
"""Zone sides that a UAV can still fly, beyond which it need not know: there and back is less."""
FAR_LEVEL = 255
"""The level of `FAR` and of more; and of a range of one zone side and of more."""


def map_names(*, obstacles: bool, energy: bool, tells_range: bool = False, outlook: bool = False) -> tuple[str, ...]:
    """The maps of a game or a run with these options, in order."""
    options = OBSTACLE_MAPS * obstacles + ENERGY_MAPS * energy + RANGE_MAPS * tells_range + OUTLOOK_MAPS * outlook
    return PAPER_MAPS + options


def normalise(levels: Any, zoom: int, names: Sequence[str] = PAPER_MAPS) -> Any:
    """Levels as the network's input.

    Locations, team mates and UAVs per covered cell are scaled; vehicles become shares of the UAV's own vehicles,
    scaled: what to do depends on where they are, not on how many they are. So do vehicles in sight.

    Args:
        levels: [..., maps, n, n], the six in units of 1 / (2 zoom)^2 (see skyrelay.coordination.observation).
        names: of the maps, the six first.
    Returns: [..., maps, n, n] float32.
    """
    xp = levels.__array_namespace__()
    maps = xp.astype(levels, xp.float32)
    own = xp.sum(maps[..., GLOBAL_VEHICLES, :, :], axis=(-2, -1))
    one = xp.ones_like(own)
    share = VEHICLE_SCALE / xp.maximum(own, one)
    factors = xp.stack([MAPS[name].factor(zoom, share) * one for name in names], axis=-1)
    return maps * factors[..., None, None]


def chosen(maps: Any, has: Sequence[str], wants: Sequence[str]) -> Any:
    """The maps [..., wants, n, n] that a policy wants of those that there are; empty ones for what there is not."""
    if tuple(has) == tuple(wants):
        return maps
    xp = maps.__array_namespace__()
    empty = xp.zeros_like(maps[..., 0, :, :])
    return xp.stack([maps[..., has.index(name), :, :] if name in has else empty for name in wants], axis=-3)


def obstacle_maps(
    window: Any, own: Any, vehicles: Any, reach: Any, walls: Any, built: Any, n: int, zoom: int
) -> tuple[Any, Any, Any]:
    """`OBSTACLE_MAPS` of every UAV, as levels.

    Local: 1 in a cell of the window whose centre is inside a building. Global: such cells of each block, counted.
    Sight: how many of the UAV's own vehicles would be in range and in sight from each cell's centre of the window.

    Args:
        window: [N, 2] column and row of each UAV's window in the full map.
        own: [N, V] whether a vehicle is there and is the UAV's.
        vehicles: [V, 2] positions [zone sides].
        reach: range [zone sides].
        walls: [W, 5] (see `skyrelay.airspace.flight.in_sight`), in zone sides.
        built: [h, h] from `footprint`.
    Returns: [N, n, n] each.
    """
    xp = walls.__array_namespace__()
    cells = n * zoom
    columns, rows = (window[:, axis, None] + xp.arange(n) for axis in (0, 1))
    local = built[rows[:, :, None], columns[:, None, :]]
    blocks = xp.sum(xp.reshape(built, (n, zoom, n, zoom)), axis=(1, 3))
    # A vehicle has one UAV, so that each is looked at from one window only.
    uav = xp.argmax(own, axis=0)
    x, y = (columns[uav] + 0.5) / cells, (rows[uav] + 0.5) / cells
    shape = (vehicles.shape[0], n, n)
    air = xp.stack([xp.broadcast_to(x[:, None, :], shape), xp.broadcast_to(y[:, :, None], shape)], axis=-1)
    ground = vehicles[:, None, None, :]
    near = xp.sum((air - ground) ** 2, axis=-1) <= reach**2
    seen = xp.astype(near & in_sight(ground, air, walls), xp.float32)
    counts = xp.astype(own, xp.float32) @ xp.reshape(seen, (-1, n * n))
    return local, xp.broadcast_to(blocks, local.shape), xp.reshape(counts, local.shape)


def footprint(walls: Any, cells: int) -> Any:
    """[cells, cells]: whether the centre of each cell is inside a building, by its winding number.

    Args:
        walls: [W, 5]; the walls of a building form a ring, counter-clockwise; buildings may overlap.
    """
    xp = walls.__array_namespace__()
    centre = (xp.arange(cells) + 0.5) / cells
    x, y = centre[None, :, None], centre[:, None, None]
    x0, y0, x1, y1, rise = (walls[:, column] for column in range(5))
    left = (x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)
    up, down = (y0 <= y) & (y < y1) & (left > 0), (y1 <= y) & (y < y0) & (left < 0)
    turns = xp.astype(up & (rise > 0), xp.int32) - xp.astype(down & (rise > 0), xp.int32)
    return xp.sum(turns, axis=-1) != 0


def energy_maps(
    window: Any, charger: Any, flight: Any, at_charger: Any, n: int, zoom: int
) -> tuple[Any, Any, Any, Any]:
    """`ENERGY_MAPS` of every UAV, as levels.

    Args:
        window: [N, 2] as in `obstacle_maps`.
        charger: [2] the charging point [zone sides].
        flight: [N] how far each can still fly [zone sides].
        at_charger: [N] whether it is within the charging point's radius.
    Returns: [N, n, n] each.
    """
    xp = flight.__array_namespace__()
    cells, whole = n * zoom, (2 * zoom) ** 2
    cell = cell_of(charger, cells)
    columns, rows = (window[:, axis, None] + xp.arange(n) == cell[axis] for axis in (0, 1))
    local = whole * xp.astype(rows[:, :, None] & columns[:, None, :], xp.int32)
    near, far, near_share, far_share = tent(cell, n, zoom)
    coarse = xp.arange(n)[:, None]
    shares = near_share * (coarse == near) + far_share * (coarse == far)
    x, y = shares[:, 0], shares[:, 1]
    flight_level = xp.round(xp.clip(flight / FAR, 0.0, 1.0) * FAR_LEVEL)
    numbers = (flight_level, xp.astype(at_charger, flight_level.dtype))
    everywhere = (xp.broadcast_to(number[:, None, None], local.shape) for number in numbers)
    return local, xp.broadcast_to(y[:, None] * x[None, :], local.shape), *everywhere


def range_map(reach: Any, uavs: int, n: int) -> Any:
    """`RANGE_MAPS` of every UAV, as levels [N, n, n].

    Args:
        reach: range [zone sides], an array of one number.
    """
    xp = reach.__array_namespace__()
    return xp.broadcast_to(xp.round(xp.clip(reach, 0.0, 1.0) * FAR_LEVEL), (uavs, n, n))


def outlook_maps(
    uavs: Any, active: Any, own: Any, vehicles: Any, reach: Any, step: Any, n: int, walls: Any = None, held: Any = None
) -> tuple[Any, Any]:
    """`OUTLOOK_MAPS` of every UAV, as levels, from exact positions.

    Safe moves: of the middle 3 x 3 cells, 1 in those that a safe move heads to (`guard.safe_moves`); 0 elsewhere.
    Cover: how many own vehicles would be in range (and in sight) from places on rings about the UAV, in `COVER_PARTS`.
    A vehicle at the edge of the range counts half, as it may be gone on arrival: from half a move inside the edge to
    half a move outside its part falls from 1 to 0.

    Args:
        uavs, vehicles: [N, 2] and [V, 2] positions [zone sides].
        active: [N] whether a UAV is there, in the air.
        own: [seers, V] whether a vehicle is there and is the UAV's, of all UAVs or of the first few.
        reach, step: range, and length of a UAV's move [zone sides], arrays of one number.
        walls: as in `obstacle_maps`; None on open ground.
        held: [N, N] length at which the guard holds each link [zone sides]; None for the range.
    Returns: [N, n, n] and [seers, n, n].
    """
    xp = uavs.__array_namespace__()
    safe = xp.permute_dims(
        xp.astype(safe_moves(uavs, active, reach if held is None else held, step), xp.float32), (1, 0)
    )
    heads_to = np.full(n * n, ACTIONS)
    heads_to[cell_of_move(n)] = np.arange(ACTIONS)
    none = xp.zeros((safe.shape[0], 1), dtype=xp.float32)
    moves = xp.take(xp.concat([safe, none], axis=1), xp.asarray(heads_to), axis=1)

    # A vehicle has one UAV, so that each is looked at from one UAV's places only. Each coordinate has an array of its
    # own: pairs side by side would keep XLA from computing many places at once.
    uav = xp.argmax(own, axis=0)
    rings = xp.asarray(_rings(n), dtype=xp.float32)
    x, y = (xp.clip(xp.take(uavs[:, axis], uav)[:, None] + step * rings[:, axis], 0.0, 1.0) for axis in (0, 1))
    squared = (x - vehicles[:, 0, None]) ** 2 + (y - vehicles[:, 1, None]) ** 2
    # (range - distance) / move + 1/2 to first order about the edge, without a root.
    covered = xp.clip((reach**2 - squared) / (2.0 * reach * step) + 0.5, 0.0, 1.0)
    if walls is not None:
        covered = xp.where(in_sight(vehicles[:, None, :], xp.stack([x, y], axis=-1), walls), covered, 0.0)
    counts = xp.round(COVER_PARTS * (xp.astype(own, xp.float32) @ covered))
    return xp.reshape(moves, (-1, n, n)), xp.reshape(counts, (-1, n, n))


def safe_of(maps: Any, names: Sequence[str]) -> Any:
    """[..., 9]: 1 for each move that `safe_moves` of normalised maps [..., maps, n, n] allows, else 0."""
    row, column = np.divmod(cell_of_move(maps.shape[-1]), maps.shape[-1])
    return maps[..., names.index(OUTLOOK_MAPS[0]), row, column] / MAPS[OUTLOOK_MAPS[0]].scale


def cell_of_move(n: int) -> Any:
    """[9] the cell of `safe_moves` that each move heads to from the middle, as row x n + column."""
    column, row = (np.sign(unit_moves()[:, axis]).astype(np.int64) + n // 2 for axis in (0, 1))
    return row * n + column


def _rings(n: int) -> Any:
    """[n x n, 2] of the places of `cover_nearby` [steps], cell by cell; the middle one is where the UAV is."""
    axis = np.arange(n) - n // 2
    x, y = np.meshgrid(axis, axis)
    ring = np.maximum(abs(x), abs(y))
    away = ring**NEARBY / np.maximum(np.hypot(x, y), 1.0)
    return np.stack([x * away, y * away], axis=-1).reshape(-1, 2)


def cell_of(position: Any, cells: int) -> Any:
    """Column and row of positions [..., 2] in a grid of cells x cells over the zone; outside: in the nearest."""
    xp = position.__array_namespace__()
    return xp.clip(xp.astype(xp.floor(position * cells), xp.int32), 0, cells - 1)


def window_of(position: Any, n: int, zoom: int) -> Any:
    """[..., 2] column and row of the full map where the window about each position [..., 2] begins."""
    xp = position.__array_namespace__()
    return xp.clip(cell_of(position, n * zoom) - n // 2, 0, n * zoom - n)


def tent(cell: Any, n: int, zoom: int) -> tuple[Any, Any, Any, Any]:
    """Along an axis, how a full map's cell is shared between the two nearest coarse ones.

    Returns: like ``cell``: the coarse cell that it lies in, the next nearest (at the border the same one again), and
        their shares in units of 1 / (2 zoom).
    """
    xp = cell.__array_namespace__()
    near = cell // zoom
    offset = 2 * (cell % zoom) + 1 - zoom  # of the cell's centre from the coarse one's, in units of 1 / (2 zoom)
    far, beside = xp.clip(near + xp.sign(offset), 0, n - 1), xp.abs(offset)
    return near, far, 2 * zoom - beside, beside
