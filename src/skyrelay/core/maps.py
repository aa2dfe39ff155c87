"""The six observation maps by number, and how their levels become a network's input (JAX and NumPy share this)."""

from __future__ import annotations

from typing import Any

LOCAL_LOCATION, LOCAL_VEHICLES, GLOBAL_LOCATION, GLOBAL_TEAM, GLOBAL_COVERAGE, GLOBAL_VEHICLES = range(6)
CHANNELS = 6

VEHICLE_SCALE = 4.0
"""Sum of the global vehicles map, so that one vehicle among a few weighs about as much as a UAV."""


def normalise(levels: Any, zoom: int) -> Any:
    """Levels as the network's input, for any array library of the array API standard.

    Locations and team mates stay counts; coverage becomes UAVs per cell, halved; vehicles become shares of the UAV's
    own vehicles, times `VEHICLE_SCALE`: what to do depends on where they are, not on how many they are.

    Args:
        levels: [..., 6, n, n] sums of the full maps' cells (see skyrelay.coordination.observation).
    Returns: [..., 6, n, n] float32.
    """
    xp = levels.__array_namespace__()
    maps = xp.astype(levels, xp.float32)
    own = xp.sum(maps[..., GLOBAL_VEHICLES, :, :], axis=(-2, -1))
    one = xp.ones_like(own)
    share = VEHICLE_SCALE / xp.maximum(own, one)
    factors = xp.stack([one, share, one, one, one * (0.5 / zoom**2), share], axis=-1)
    return maps * factors[..., None, None]
