"""The maps as seen from where the UAV is.

The global maps lie over the zone, so that a network must learn for each own place anew what "to the east of me" means.
Here they are moved until the UAV is in the middle: a vehicle at some distance and bearing is then the same input
wherever in the zone both are. On the paper's games a network learns the same from a quarter of the steps or less, and
ends better (docs/decisions/0031).

Where the observation tells the range, distances count in ranges: "at the edge of my reach" is then the same input
whatever the zone's size, and what is learned at one scale holds at all (docs/decisions/0032).

It is the first layer of a network and has no weights: what goes in is still what the game defines.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Float

from skyrelay.airspace.maps import (
    GLOBAL_COVERAGE,
    GLOBAL_LOCATION,
    LOCAL_LOCATION,
    MAPS,
    OUTLOOK_MAPS,
    PAPER_MAPS,
    RANGE_MAPS,
    Kind,
)

PLACE_SCALE = 2.0
"""What the UAV's own column comes to, and its row: of the size of the other inputs (`skyrelay.airspace.maps`)."""
MARKS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.75, 2.1, 2.5, 3.0)
"""Distances along an axis that are told apart [ranges], to both sides: closest about the range, where links break."""
LEAST_RANGE = 0.05
"""Zone sides; less is taken as this much."""


def tells_range(names: Sequence[str]) -> bool:
    """Whether distances count in ranges."""
    return set(RANGE_MAPS) <= set(names)


def moved(names: Sequence[str]) -> list[int]:
    """Numbers of the maps that are moved: all that lie over the zone, but for the own location.

    Nor coverage where the range is told: it shows nothing that the range and the UAVs' places do not.
    """
    left = {GLOBAL_LOCATION, GLOBAL_COVERAGE} if tells_range(names) else {GLOBAL_LOCATION}
    return [k for k, name in enumerate(names) if MAPS[name].kind is Kind.ZONE and k not in left]


def near(names: Sequence[str]) -> list[int]:
    """Numbers of the maps about the UAV that are moved: those of the options.

    Near the zone's border the window is shifted inward, so that the UAV is not in the middle of these either. The
    paper's two are left out: they show nothing that the maps over the zone do not.
    """
    return [k for k, name in enumerate(names) if MAPS[name].kind is Kind.WINDOW and name not in PAPER_MAPS]


def same_everywhere(names: Sequence[str]) -> list[int]:
    """Numbers of the maps that are the same in every cell."""
    return [k for k, name in enumerate(names) if MAPS[name].kind is Kind.EVERYWHERE]


def ahead(names: Sequence[str]) -> list[int]:
    """Numbers of the maps of places about the UAV, to be seen as differences from its own."""
    return [k for k, name in enumerate(names) if name == OUTLOOK_MAPS[1]]


def side(n: int, names: Sequence[str]) -> int:
    """Of a map that was moved."""
    return 2 * len(MARKS) - 1 if tells_range(names) else 2 * n - 1


def width(n: int, names: Sequence[str]) -> int:
    """How many numbers `egocentric` makes of maps of n x n cells."""
    seen = len(moved(names)) * side(n, names) ** 2 + len(near(names)) * (2 * n - 1) ** 2
    return 2 * n + seen + len(ahead(names)) * (n * n + 1) + len(same_everywhere(names))


def operations(n: int, names: Sequence[str]) -> int:
    """Floating-point operations of one call: two matrix products for each map that is moved."""
    sides = [side(n, names)] * len(moved(names)) + [2 * n - 1] * len(near(names))
    return sum(2 * (to * n * n + to * to * n) for to in sides)


def offsets(n: int) -> npt.NDArray[np.int64]:
    """[2 n - 1, n]: in which own column (row) column c is at offset d - (n - 1) from it; n where there is none."""
    own = np.arange(n) - (np.arange(2 * n - 1)[:, None] - (n - 1))
    return np.where((own >= 0) & (own < n), own, n)


def marks() -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """[marks, 1] each: `MARKS` to both sides from west (south) to east (north), the one before each, the one after."""
    at = np.array([*(-mark for mark in MARKS[:0:-1]), *MARKS], np.float32)
    far = np.array([1e9], np.float32)
    before, after = np.concatenate([-far, at[:-1]]), np.concatenate([at[1:], far])
    return at[:, None], before[:, None], after[:, None]


def egocentric(maps: Float[Array, "batch maps n n"], names: Sequence[str]) -> Float[Array, "batch width"]:
    """Normalised maps, seen from the UAV.

    The own location is shared among up to four cells (bilinear downsampling), so that the finer place is not lost:
    every global map is moved by each of them, weighted; or, in ranges, by where they balance.

    Args:
        names: of the maps.
    Returns: own column and own row [n each]; the global maps [side, side] and the options' local ones
        [2 n - 1, 2 n - 1], the UAV in the middle and 0 outside; what would be covered from nearby, against what is from
        here [n, n], and that one number; one number for a map that is the same everywhere.
    """
    n = maps.shape[-1]
    column, row = _place(maps, GLOBAL_LOCATION)
    if tells_range(names):
        reach = maps[:, names.index(RANGE_MAPS[0]), 0, 0] / MAPS["own_range"].scale
        across, along = (_in_ranges(own, reach) for own in (column, row))
    else:
        across, along = (_in_cells(own) for own in (column, row))
    parts = [PLACE_SCALE * column, PLACE_SCALE * row, _move(maps, moved(names), across, along)]
    if near(names):
        across, along = (_in_cells(own) for own in _place(maps, LOCAL_LOCATION))
        parts.append(_move(maps, near(names), across, along))
    for number in ahead(names):
        here = maps[:, number, n // 2, n // 2, None]
        parts += [maps[:, number].reshape(len(maps), -1) - here, here]
    parts += [maps[:, number, 0, :1] for number in same_everywhere(names)]
    return jnp.concatenate(parts, 1)


def _place(maps: Float[Array, "batch maps n n"], number: int) -> tuple[Array, Array]:
    """Of the own place on a map: shares of the columns and of the rows [batch, n each]."""
    location = maps[:, number] / MAPS["local_location"].scale
    return location.sum(1), location.sum(2)


def _move(
    maps: Float[Array, "batch maps n n"],
    numbers: list[int],
    across: Float[Array, "batch to n"],
    along: Float[Array, "batch to n"],
) -> Float[Array, "batch features"]:
    """Some maps, each column's content brought to where ``across`` says, each row's to where ``along`` does."""
    seen = jnp.einsum("bdr,bkrc,bec->bkde", along, maps[:, np.array(numbers)], across, optimize="optimal")
    return seen.reshape(len(maps), -1)


def _in_cells(own: Float[Array, "batch n"]) -> Float[Array, "batch offsets n"]:
    """Of each column's content the share that goes to each offset: as much as of the own place is so far from it."""
    return jnp.concatenate([own, jnp.zeros((len(own), 1), own.dtype)], 1)[:, offsets(own.shape[1])]


def _in_ranges(own: Float[Array, "batch n"], reach: Float[Array, " batch"]) -> Float[Array, "batch marks n"]:
    """Of each column's content the share that goes to each mark: to the two between which it lies, or the outermost.

    Args:
        own: shares of the UAV's own place.
        reach: range [zone sides].
    """
    n = own.shape[1]
    cells = jnp.arange(n, dtype=own.dtype)
    away = (cells - (own @ cells)[:, None]) / (n * jnp.maximum(reach, LEAST_RANGE)[:, None])
    at, before, after = marks()
    away = jnp.clip(away, -MARKS[-1], MARKS[-1])[:, None, :]
    return jnp.maximum(jnp.minimum((away - before) / (at - before), (after - away) / (after - at)), 0.0)
