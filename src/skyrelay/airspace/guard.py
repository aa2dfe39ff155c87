"""Which moves keep a team linked, as every UAV can work out for itself; for any array library.

All UAVs know where all of them are, so that all work out the same minimum spanning tree of the team. A UAV that is
within half a range of the point midway to each of its neighbours in the tree is not who breaks a link; where all move
so, all links hold, whatever else each of them does (Ando et al. 1999).
"""

from __future__ import annotations

from typing import Any

from skyrelay.airspace.flight import ACTIONS, move

HAIR = 1e-5
"""Share of the range by which links are held shorter than it: rounding must not break them."""
TOLERANCE = 1e-3
"""Steps of a UAV; where no move holds the links, those that come as near to it as this count alike."""


def spanning_tree(uavs: Any, active: Any) -> Any:
    """Which pairs are neighbours in the team's minimum spanning tree: no detour between them has shorter hops only.

    Args:
        uavs: [N, 2] positions.
        active: [N] false for a row that holds no UAV.
    Returns: [N, N].
    """
    xp = uavs.__array_namespace__()
    both = active[:, None] & active[None] & ~xp.eye(uavs.shape[0], dtype=xp.bool)
    hop = xp.where(both, _distance(uavs[:, None], uavs[None]), xp.inf)
    longest = hop
    for over in range(uavs.shape[0]):
        longest = xp.minimum(longest, xp.maximum(longest[:, over, None], longest[over]))
    return both & (hop <= longest)


def too_far(places: Any, uavs: Any, active: Any, reach: Any) -> Any:
    """How far each place is from where all links of its UAV hold, whatever its neighbours do.

    Args:
        places: [P, N, 2] of each UAV.
        uavs, active: as in `spanning_tree`.
        reach: range of the links, an array of one number or [N, N].
    Returns: [P, N] in the unit of the positions, 0 where they hold.
    """
    xp = uavs.__array_namespace__()
    middle = 0.5 * (uavs[:, None] + uavs[None])
    beyond = _distance(places[:, :, None], middle) - 0.5 * (1.0 - HAIR) * reach
    held = xp.zeros_like(beyond)
    return xp.max(xp.where(spanning_tree(uavs, active), xp.maximum(beyond, held), held), axis=-1)


def safe_moves(uavs: Any, active: Any, reach: Any, step: Any) -> Any:
    """The moves after which all links of a UAV hold, whatever its neighbours do; else those that come nearest to it.

    Args:
        uavs: [N, 2] positions [zone sides].
        active, reach: as in `too_far`.
        step: length of a move [zone sides], an array of one number.
    Returns: [9, N]; at least one move of each UAV is safe.
    """
    xp = uavs.__array_namespace__()
    here = xp.broadcast_to(uavs, (ACTIONS, *uavs.shape))
    actions = xp.broadcast_to(xp.arange(ACTIONS)[:, None], here.shape[:2])
    away = too_far(move(here, actions, step), uavs, active, reach)
    least = xp.min(away, axis=0)
    return away <= xp.where(least > 0.0, least + TOLERANCE * step, least)


def keep_apart(places: Any, own: Any, others: Any, separation: float) -> Any:
    """[P] the places of a UAV at which it is far enough from all others, whatever each of them does by the same rule.

    Each keeps to its own side of the line midway to another, by half of the separation (the buffered Voronoi cells of
    Zhou et al. 2017). Of two that are nearer to each other already, neither comes nearer; where it is may always stay.

    Args:
        places: [P, 2] to choose from.
        own: [2] where the UAV is.
        others: [M, 2].
        separation: in the unit of the positions.
    Source: D. Zhou, Z. Wang, S. Bandyopadhyay, M. Schwager, "Fast, on-line collision avoidance for dynamic vehicles
    using buffered Voronoi cells", IEEE Robotics and Automation Letters 2(2), 2017.
    """
    xp = own.__array_namespace__()
    away = own - others
    apart = xp.sqrt(xp.sum(away * away, axis=-1))
    # Two in one place have no line between them.
    across = away / xp.where(apart > 0.0, apart, xp.ones_like(apart))[:, None]
    held = xp.sum((places[:, None, :] - 0.5 * (own + others)) * across, axis=-1)
    least = 0.5 * xp.minimum(apart, xp.full_like(apart, separation))
    return xp.all(held >= least * (1.0 - HAIR), axis=-1)


def _distance(one: Any, other: Any) -> Any:
    xp = one.__array_namespace__()
    x, y = (one[..., axis] - other[..., axis] for axis in (0, 1))
    return xp.sqrt(x * x + y * y)
