"""Positions in degrees, brought into a plane in metres."""

from __future__ import annotations

import numpy as np
from pyproj import CRS, Transformer

from skyrelay.core.entities import FloatArray


def project(longitude: FloatArray, latitude: FloatArray) -> tuple[FloatArray, FloatArray, str]:
    """Project WGS 84 degrees into the transverse Mercator zone (UTM) that their middle lies in.

    Lengths are true to 0.04 % within 3 degrees of the zone's meridian.

    Args:
        longitude, latitude: [M] within [-180, 180] and [-80, 84].
    Returns: x and y [M] [m], and the projection's name for the record.
    """
    east, north = float(np.median(longitude)), float(np.median(latitude))
    zone = min(int((east + 180.0) // 6.0) + 1, 60)
    code = (32600 if north >= 0 else 32700) + zone
    target = CRS.from_epsg(code)
    x, y = Transformer.from_crs(4326, target, always_xy=True).transform(longitude, latitude)
    return np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64), f"{target.name} (EPSG:{code})"
