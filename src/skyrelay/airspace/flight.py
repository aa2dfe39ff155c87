"""How UAVs move and what their links achieve, for any array library of the Python array API standard.

The compiled game (JAX), the UAV in flight and the measurements of a run (NumPy) all call these functions, so that
they cannot disagree. Leading dimensions (``...``) are batches. Lengths are in one unit of the caller's choice.
"""

from __future__ import annotations

from typing import Any

import numpy as np

STAY = 0
HEADINGS = 8
ACTIONS = 1 + HEADINGS

_ANGLES = 2.0 * np.pi * np.arange(1, HEADINGS + 1) / HEADINGS
_COMPASS = np.vstack([[0.0, 0.0], np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])]).round(12)


def unit_moves(xp: Any = np) -> Any:
    """[9, 2] direction of each action: 0 stays, k in 1..8 heads to theta = 2 pi k / 8 from east, counter-clockwise.

    Source: the equation of Section "Action Space", K = 8.
    """
    return xp.asarray(_COMPASS, dtype=xp.float32)


def move(uavs: Any, actions: Any, step: Any, low: Any = 0.0, high: Any = 1.0) -> Any:
    """Fly one step at constant speed; a move that would leave the zone ends at its border.

    Args:
        uavs: [..., N, 2] positions.
        actions: [..., N] integers 0..8.
        step: [...] or a number, length of a move.
        low, high: the zone's smallest and largest coordinates, numbers or [2].
    Returns: [..., N, 2] positions.
    """
    xp = uavs.__array_namespace__()
    heading = xp.take(unit_moves(xp), actions, axis=0)
    return xp.clip(uavs + heading * xp.asarray(step)[..., None, None], low, high)


def coverage(uavs: Any, vehicles: Any, owner: Any, reach: Any, walls: Any = None, flying: Any = None) -> Any:
    """Share of the vehicles that are inside their own UAV's range (and in its sight); 1 where there is no vehicle.

    Args:
        uavs: [..., N, 2] positions.
        vehicles: [..., V, 2] positions.
        owner: [..., V] row of the UAV that serves each vehicle; negative where there is no vehicle.
        reach: [...] or a number, range of the UAV-vehicle link.
        walls: [..., W, 5] what stands in the way (see `in_sight`); None for nothing.
        flying: [..., N] false for a UAV that serves nobody; None where all do.
    Returns: [...] in [0, 1].
    Source: the coverage of Eq. 3.
    """
    xp = uavs.__array_namespace__()
    count = xp.sum(owner >= 0, axis=-1)
    covered = xp.sum(served(uavs, vehicles, owner, reach, walls, flying), axis=-1)
    return xp.where(count > 0, covered / xp.maximum(count, xp.asarray(1)), 1.0)


def served(uavs: Any, vehicles: Any, owner: Any, reach: Any, walls: Any = None, flying: Any = None) -> Any:
    """[..., V]: whether each vehicle is inside its own UAV's range, and in its sight (arguments as `coverage`)."""
    xp = uavs.__array_namespace__()
    near = in_range(uavs[..., :, None, :], vehicles[..., None, :, :], xp.asarray(reach)[..., None, None])
    own = owner[..., None, :] == xp.arange(uavs.shape[-2])[:, None]
    if flying is not None:
        own = own & flying[..., None]
    covered = xp.any(near & own, axis=-2)
    if walls is not None:
        covered = covered & in_sight(vehicles, of_owner(uavs, owner), walls[..., None, :, :])
    return covered


def in_range(one: Any, other: Any, reach: Any) -> Any:
    """[...] whether two points [..., 2] are at most ``reach`` apart: the disc of the paper."""
    xp = one.__array_namespace__()
    apart = one - other
    return xp.sum(apart * apart, axis=-1) <= reach**2


def of_owner(uavs: Any, owner: Any) -> Any:
    """[..., V, 2]: where each vehicle's UAV is; anywhere for a vehicle without one."""
    xp = uavs.__array_namespace__()
    return xp.take_along_axis(uavs, xp.maximum(owner, xp.asarray(0))[..., None], axis=-2)


def in_sight(ground: Any, air: Any, walls: Any) -> Any:
    """Whether the straight line from a point on the ground to a UAV passes above every wall on its way.

    The line climbs evenly from the ground to the UAV's altitude, so that it meets a wall at a share t of the way at t
    times the altitude: it is blocked where that is below the wall's top. A point inside a building sees through its
    roof, not through its walls; a point on a wall is not blocked by that wall.

    Args:
        ground, air: [..., 2] positions; they are broadcast against each other and against the walls' first axes.
        walls: [..., W, 5] x and y of both ends, and the height over the UAVs' altitude, in [0, 1); 0 is no wall.
    Returns: [...].
    """
    blocked, _, _ = _crossings(ground, air, walls)
    xp = blocked.__array_namespace__()
    return ~xp.any(blocked, axis=-1)


def sight_share(ground: Any, air: Any, walls: Any) -> Any:
    """[...]: the share of its distance at which a UAV that comes straight nearer sees the point; 1 where it does now.

    Coming nearer makes the line steeper. Arguments as `in_sight`, with at least one wall.
    """
    blocked, at, top = _crossings(ground, air, walls)
    xp = blocked.__array_namespace__()
    one = xp.ones_like(top)
    return xp.min(xp.where(blocked, at / xp.where(blocked, top, one), one), axis=-1)


def _crossings(ground: Any, air: Any, walls: Any) -> tuple[Any, Any, Any]:
    """[..., W] whether each wall blocks the line; where it meets it and where it clears it, in one common unit."""
    xp = walls.__array_namespace__()
    line, wall = (air - ground)[..., None, :], walls[..., 2:4] - walls[..., :2]
    to_wall = walls[..., :2] - ground[..., None, :]
    # Both meet at ``at / whole`` of the line and ``along / whole`` of the wall; multiplied out, nothing divides by 0.
    across = _cross(line, wall)
    sign, whole = xp.where(across < 0, -1.0, 1.0), xp.abs(across)
    at, along, top = sign * _cross(to_wall, wall), sign * _cross(to_wall, line), walls[..., 4] * whole
    return (at > 0) & (at < top) & (along >= 0) & (along <= whole), at, top


def _cross(a: Any, b: Any) -> Any:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def links(uavs: Any, reach: Any, active: Any) -> Any:
    """The range graph: [..., N, N], true between two active UAVs at most ``reach`` apart, and on the diagonal.

    Args:
        uavs: [..., N, 2] positions.
        reach: [...] or a number, range of the UAV-UAV link.
        active: [..., N], false for a row that holds no UAV.
    """
    xp = uavs.__array_namespace__()
    near = in_range(uavs[..., :, None, :], uavs[..., None, :, :], xp.asarray(reach)[..., None, None])
    return (near & active[..., :, None] & active[..., None, :]) | xp.eye(uavs.shape[-2], dtype=xp.bool)


def connectivity(graph: Any, active: Any) -> Any:
    """[...] true where a path of links joins every two active UAVs (so for a team of one, or none).

    Args:
        graph: [..., N, N] from `links`.
        active: [..., N].
    Source: the connectivity of Eq. 3.
    """
    xp = graph.__array_namespace__()
    # From the first active UAV, walk the graph: N - 1 rounds reach whatever can be reached.
    reached = active & (xp.cumulative_sum(xp.astype(active, xp.int32), axis=-1) == 1)
    for _ in range(graph.shape[-1] - 1):
        reached = reached | xp.any(graph & reached[..., None, :], axis=-1)
    return xp.all(reached | ~active, axis=-1)


def connectivity_neighbor(graph: Any, active: Any) -> Any:
    """[...] true where every active UAV has at least one other in range (so for a team of one, or none).

    Source: the weaker connectivity of the results text in Section "MDRL-based Coordination".
    """
    xp = graph.__array_namespace__()
    others = xp.sum(xp.astype(graph, xp.int32), axis=-1) - 1
    alone = xp.sum(xp.astype(active, xp.int32), axis=-1) <= 1
    return xp.all((others > 0) | ~active, axis=-1) | alone
