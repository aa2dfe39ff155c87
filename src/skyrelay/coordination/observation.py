"""The paper's six maps inside the compiled game: one scatter for all of them (`skyrelay.airspace.observation`)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt

from skyrelay.airspace.maps import (
    CHANNELS,
    GLOBAL_COVERAGE,
    GLOBAL_LOCATION,
    GLOBAL_TEAM,
    GLOBAL_VEHICLES,
    LOCAL_LOCATION,
    LOCAL_VEHICLES,
    cell_of,
    tent,
    window_of,
)
from skyrelay.airspace.observation import Scene


def six_maps(scene: Scene, active: Bool[Array, " uavs"], n: int, zoom: int) -> UInt[Array, "uavs 6 n n"]:
    """The six maps of every UAV, as levels, without any h x h map of a UAV.

    Everything but coverage is points: one scatter-add writes a UAV's own place and its vehicles. The team map is the
    sum of all locations without one's own. Coverage is the same for the whole team and comes from comparing block by
    block. Bytes hold the levels of up to 28 vehicles at zoom 2; beyond, and at zoom 3, there are two bytes each.

    Args:
        active: false for a row that holds no UAV; its maps are all 0.
    """
    uavs, vehicles, owner, reach = scene.uavs, scene.vehicles, scene.owner, scene.reach
    count, cells, size = uavs.shape[0], n * zoom, CHANNELS * n * n
    uav_cell = cell_of(uavs, cells)
    vehicle_cell = cell_of(vehicles, cells)
    window = window_of(uavs, n, zoom)

    nowhere = count * size  # an index past the end, which the scatter drops
    first = jnp.where(active, jnp.arange(count) * size, nowhere)  # where each UAV's maps begin
    owner_first = jnp.where(owner >= 0, first[owner], nowhere)
    in_window = vehicle_cell - window[owner]
    seen = jnp.all((in_window >= 0) & (in_window < n), -1)

    def at(base: Array, channel: int, column: Array, row: Array) -> Array:
        return base + (channel * n * n + row * n + column)

    whole = (2 * zoom) ** 2
    local = uav_cell - window
    indices = [
        at(first, LOCAL_LOCATION, local[:, 0], local[:, 1]),
        jnp.where(seen, at(owner_first, LOCAL_VEHICLES, in_window[:, 0], in_window[:, 1]), nowhere),
    ]
    weights = [jnp.full(count, whole), jnp.full(len(vehicles), whole)]
    for base, channel, cell in ((first, GLOBAL_LOCATION, uav_cell), (owner_first, GLOBAL_VEHICLES, vehicle_cell)):
        near, far, near_weight, far_weight = tent(cell, n, zoom)
        for column, column_weight in ((near[:, 0], near_weight[:, 0]), (far[:, 0], far_weight[:, 0])):
            for row, row_weight in ((near[:, 1], near_weight[:, 1]), (far[:, 1], far_weight[:, 1])):
                indices.append(at(base, channel, column, row))
                weights.append(column_weight * row_weight)
    dtype = jnp.uint8 if zoom == 2 and len(vehicles) <= 28 else jnp.uint16
    flat = jnp.zeros(count * size, dtype)
    flat = flat.at[jnp.concatenate(indices)].add(jnp.concatenate(weights).astype(dtype), mode="drop")
    levels = flat.reshape(count, CHANNELS, n, n)

    location = levels[:, GLOBAL_LOCATION]
    team = jnp.sum(location, axis=0, dtype=dtype) - location
    covered = jnp.broadcast_to(_coverage(uavs, active, reach, n, zoom).astype(dtype), team.shape)
    shared = jnp.where(active[:, None, None, None], jnp.stack([team, covered], axis=1), 0)
    return levels.at[:, GLOBAL_TEAM : GLOBAL_COVERAGE + 1].set(shared)


def _coverage(
    uavs: Float[Array, "uavs 2"], active: Bool[Array, " uavs"], reach: Float[Array, ""], n: int, zoom: int
) -> Float[Array, "n n"]:
    """[n, n]: over each block's zoom x zoom cells, the number of UAVs with the cell's centre in range, summed.

    One pass over [n, n] for each place in a block, fused; the UAVs are a loop of the program, because the sum would
    otherwise be fused into the maps of every UAV and computed once for each.
    """
    centre = ((jnp.arange(n * zoom) + 0.5) / (n * zoom)).reshape(n, zoom)
    limit = jnp.where(active, reach * reach, -1.0)
    x2 = (uavs[:, 0, None, None] - centre) ** 2
    y2 = (uavs[:, 1, None, None] - centre) ** 2

    def add(uav: Array, total: Array) -> Array:
        for below in range(zoom):
            for left in range(zoom):
                near = y2[uav, :, below, None] + x2[uav, None, :, left] <= limit[uav]
                total = total + near.astype(jnp.float32)
        return total

    covered: Array = jax.lax.fori_loop(0, uavs.shape[0], add, jnp.zeros((n, n), jnp.float32))
    return covered
