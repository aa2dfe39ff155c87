"""What a UAV sees: four h x w maps, reduced to six n x n maps (Section "MDRL Formulation", Fig. "Observations").

The four maps lie over the zone as a grid of h x h cells, h = zoom x n:
- location: 1 in the UAV's own cell;
- team: in each cell, how many of the *other* UAVs are there;
- coverage: in each cell, how many UAVs of the whole team have its centre in range;
- vehicles: in each cell, how many of the UAV's *own* vehicles are there.

The six maps that the policy gets, each [n, n], row = y from south, column = x from west:
- LOCAL_LOCATION, LOCAL_VEHICLES: a window of n x n cells of the full map centred on the UAV, shifted inward at borders;
- GLOBAL_LOCATION, GLOBAL_TEAM, GLOBAL_COVERAGE, GLOBAL_VEHICLES: each zoom x zoom block of the full map, summed.

The sums are whole numbers ("levels"), a byte each: rollouts keep them so. `skyrelay.core.maps.normalise` makes them the
network's input.
`skyrelay.policy.observation` computes the same in NumPy for a UAV in flight; the tests hold both against a plain-loop
reference that does materialise the four maps.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt8

from skyrelay.core.maps import (
    CHANNELS,
    GLOBAL_COVERAGE,
    GLOBAL_LOCATION,
    GLOBAL_TEAM,
    GLOBAL_VEHICLES,
    LOCAL_LOCATION,
    LOCAL_VEHICLES,
)


def observe(
    uavs: Float[Array, "uavs 2"],
    active: Bool[Array, " uavs"],
    vehicles: Float[Array, "vehicles 2"],
    owner: Int[Array, " vehicles"],
    reach: Float[Array, ""],
    n: int,
    zoom: int,
) -> UInt8[Array, "uavs 6 n n"]:
    """The six maps of every UAV, as levels, without any h x h map of a UAV.

    Each level is a count, so one scatter-add writes all of them but coverage: the cell of every location, team mate
    and own vehicle in the maps of the UAV that sees it. Coverage is the same for the whole team and comes from
    comparing block by block.

    Args:
        uavs, vehicles: positions [zone sides], in [0, 1].
        active: false for a row that holds no UAV; its maps are all 0.
        owner: row of each vehicle's UAV, negative where there is no vehicle.
        reach: range [zone sides].
    """
    count, cells, size = uavs.shape[0], n * zoom, CHANNELS * n * n
    uav_cell = _cell(uavs, cells)
    vehicle_cell = _cell(vehicles, cells)
    window = jnp.clip(uav_cell - n // 2, 0, cells - n)

    nowhere = count * size  # an index past the end, which the scatter drops
    row = jnp.arange(count)
    first = jnp.where(active, row * size, nowhere)  # where each UAV's maps begin
    owner_first = jnp.where(owner >= 0, first[owner], nowhere)
    in_window = vehicle_cell - window[owner]
    seen = jnp.all((in_window >= 0) & (in_window < n), -1)
    mate = active[None, :] & (row[None, :] != row[:, None])

    def at(base: Array, channel: int, cell: Array) -> Array:
        return base + channel * n * n + cell[..., 1] * n + cell[..., 0]

    indices = [
        at(first, LOCAL_LOCATION, uav_cell - window),
        at(first, GLOBAL_LOCATION, uav_cell // zoom),
        jnp.where(mate, at(first[:, None], GLOBAL_TEAM, uav_cell[None] // zoom), nowhere).reshape(-1),
        jnp.where(seen, at(owner_first, LOCAL_VEHICLES, in_window), nowhere),
        at(owner_first, GLOBAL_VEHICLES, vehicle_cell // zoom),
    ]
    levels = jnp.zeros(count * size, jnp.uint8).at[jnp.concatenate(indices)].add(jnp.uint8(1), mode="drop")
    covered = jnp.where(active[:, None, None], _coverage(uavs, active, reach, n, zoom), 0)
    return levels.reshape(count, CHANNELS, n, n).at[:, GLOBAL_COVERAGE].set(covered.astype(jnp.uint8))


def _cell(position: Array, cells: int) -> Array:
    """Column and row of positions in a grid of cells x cells over the zone; what lies outside is in the nearest."""
    return jnp.clip(jnp.floor(position * cells).astype(jnp.int32), 0, cells - 1)


def _coverage(uavs: Array, active: Array, reach: Array, n: int, zoom: int) -> Array:
    """[n, n]: over each block's zoom x zoom cells, the number of UAVs with the cell's centre in range, summed.

    One pass over [n, n] for each UAV and each place in a block; the compiler fuses them, which is several times faster
    than reducing an [N, h, h] comparison. The loops are unrolled while tracing: their lengths are fixed.
    """
    centre = ((jnp.arange(n * zoom) + 0.5) / (n * zoom)).reshape(n, zoom)
    limit = jnp.where(active, reach * reach, -1.0)
    x2 = (uavs[:, 0, None, None] - centre) ** 2
    y2 = (uavs[:, 1, None, None] - centre) ** 2
    total = jnp.zeros((n, n), jnp.float32)
    for uav in range(uavs.shape[0]):
        for below in range(zoom):
            for left in range(zoom):
                near = y2[uav, :, below, None] + x2[uav, None, :, left] <= limit[uav]
                total = total + near.astype(jnp.float32)
    return total
