"""The maps as seen from where the UAV is.

The global maps lie over the zone, so that a network must learn for each own place anew what "to the east of me" means.
Here they are moved until the UAV is in the middle: a vehicle at some distance and bearing is then the same input
wherever in the zone both are. On the paper's games a network learns the same from a quarter of the steps or less, and
ends better (docs/decisions/0031).

It is the first layer of a network and has no weights: what goes in is still what the game defines.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Float

from skyrelay.core.maps import EVERYWHERE, GLOBAL_LOCATION, LOCATION_SCALE, PAPER_MAPS

PLACE_SCALE = 2.0
"""What the UAV's own column comes to, and its row: of the size of the other inputs (`skyrelay.core.maps`)."""


def moved(names: Sequence[str]) -> list[int]:
    """Numbers of the maps that are moved: all that lie over the zone, but for the own location."""
    return [k for k, name in enumerate(names) if name.startswith("global_") and k != GLOBAL_LOCATION]


def kept(names: Sequence[str]) -> list[int]:
    """Numbers of the maps that are around the UAV already: those of the options.

    The paper's two are left out: they show nothing that the moved ones do not.
    """
    return [k for k, name in enumerate(names) if name.startswith("local_") and name not in PAPER_MAPS]


def same_everywhere(names: Sequence[str]) -> list[int]:
    """Numbers of the maps that are the same in every cell."""
    return [k for k, name in enumerate(names) if name in EVERYWHERE]


def width(n: int, names: Sequence[str]) -> int:
    """How many numbers `egocentric` makes of maps of n x n cells."""
    return 2 * n + len(moved(names)) * (2 * n - 1) ** 2 + len(kept(names)) * n * n + len(same_everywhere(names))


def operations(n: int, names: Sequence[str]) -> int:
    """Floating-point operations of one call: two matrix products for each map that is moved."""
    side = 2 * n - 1
    return len(moved(names)) * 2 * (side * n * n + side * side * n)


def offsets(n: int) -> npt.NDArray[np.int64]:
    """[2 n - 1, n]: in which own column (row) column c is at offset d - (n - 1) from it; n where there is none."""
    own = np.arange(n) - (np.arange(2 * n - 1)[:, None] - (n - 1))
    return np.where((own >= 0) & (own < n), own, n)


def egocentric(maps: Float[Array, "batch maps n n"], names: Sequence[str]) -> Float[Array, "batch width"]:
    """Normalised maps, seen from the UAV.

    The own location is shared among up to four cells (bilinear downsampling): every global map is moved by each of
    them, weighted. So the finer place that the shares tell is not lost.

    Args:
        names: of the maps.
    Returns: own column and own row [n each]; the global maps [2 n - 1, 2 n - 1], the UAV in the middle and 0 outside
        the zone; the options' local maps [n, n]; one number for a map that is the same everywhere.
    """
    batch, n = maps.shape[0], maps.shape[-1]
    location = maps[:, GLOBAL_LOCATION] / LOCATION_SCALE
    column, row = location.sum(1), location.sum(2)
    table, nowhere = offsets(n), jnp.zeros((batch, 1), maps.dtype)
    across, along = (jnp.concatenate([own, nowhere], 1)[:, table] for own in (column, row))
    seen = jnp.einsum("bdr,bkrc,bec->bkde", along, maps[:, np.array(moved(names))], across, optimize="optimal")
    parts = [PLACE_SCALE * column, PLACE_SCALE * row, seen.reshape(batch, -1)]
    if kept(names):
        parts.append(maps[:, np.array(kept(names))].reshape(batch, -1))
    parts += [maps[:, number, 0, :1] for number in same_everywhere(names)]
    return jnp.concatenate(parts, 1)
