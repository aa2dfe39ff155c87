"""The six observation maps by number, and how their levels become a network's input (JAX and NumPy share this)."""

from __future__ import annotations

from typing import Any

LOCAL_LOCATION, LOCAL_VEHICLES, GLOBAL_LOCATION, GLOBAL_TEAM, GLOBAL_COVERAGE, GLOBAL_VEHICLES = range(6)
CHANNELS = 6

LOCATION_SCALE = 4.0
TEAM_SCALE = 2.0
COVERAGE_SCALE = 0.1
VEHICLE_SCALE = 8.0
"""What a UAV's own cell, a team mate, a UAV that covers a whole block and all own vehicles together come to.

Maps of one cell and maps of many then weigh about the same, which is what a network learns fastest from.
"""


def normalise(levels: Any, zoom: int) -> Any:
    """Levels as the network's input, for any array library of the array API standard.

    Locations, team mates and UAVs per covered cell are scaled; vehicles become shares of the UAV's own vehicles,
    scaled: what to do depends on where they are, not on how many they are.

    Args:
        levels: [..., 6, n, n] in units of 1 / (2 zoom)^2 (see skyrelay.coordination.observation).
    Returns: [..., 6, n, n] float32.
    """
    xp = levels.__array_namespace__()
    maps = xp.astype(levels, xp.float32)
    own = xp.sum(maps[..., GLOBAL_VEHICLES, :, :], axis=(-2, -1))
    one = xp.ones_like(own)
    share = VEHICLE_SCALE / xp.maximum(own, one)
    whole = (2 * zoom) ** 2
    location, team, coverage = LOCATION_SCALE / whole, TEAM_SCALE / whole, COVERAGE_SCALE / zoom**2
    factors = xp.stack([location * one, share, location * one, team * one, coverage * one, share], axis=-1)
    return maps * factors[..., None, None]
