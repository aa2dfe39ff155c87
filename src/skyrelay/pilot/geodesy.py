"""From the globe to the scenario's plane and back."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from skyrelay.core.errors import UsageError

_SEMI_MAJOR = 6378137.0
_ECCENTRICITY_SQUARED = 6.69437999014e-3
"""Of WGS 84's ellipsoid [m, -]."""


@dataclass(frozen=True)
class Frame:
    """The plane that touches the ellipsoid where the scenario's origin is; x east, y north [m].

    Within 10 km of the origin and between 70 degrees south and north it is true to 20 m, within 3 km to 2 m
    (`tests/pilot/test_position.py` measures it against Earth-centred coordinates).

    Args:
        latitude, longitude: of x = 0, y = 0 [degrees].
    Raises:
        UsageError: it is no place, or too near a pole.
    """

    latitude: float
    longitude: float
    _north: float = field(init=False, repr=False)
    _east: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not (abs(self.latitude) <= 85.0 and abs(self.longitude) <= 180.0):
            place = f"{self.latitude}, {self.longitude}"
            raise UsageError("origin", place, "a latitude of -85 to 85 and a longitude of -180 to 180 degrees")
        latitude = math.radians(self.latitude)
        bulge = 1.0 - _ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
        meridian = _SEMI_MAJOR * (1.0 - _ECCENTRICITY_SQUARED) / bulge**1.5
        normal = _SEMI_MAJOR / math.sqrt(bulge)
        object.__setattr__(self, "_north", math.radians(meridian))
        object.__setattr__(self, "_east", math.radians(normal * math.cos(latitude)))

    @classmethod
    def parse(cls, text: str, option: str) -> Frame:
        """From ``LATITUDE,LONGITUDE``.

        Raises:
            UsageError: it is no such pair.
        """
        try:
            latitude, longitude = map(float, text.split(","))
        except ValueError:
            raise UsageError(option, text, "LATITUDE,LONGITUDE in degrees, e.g. 44.49,11.34") from None
        return cls(latitude, longitude)

    def to_plane(self, latitude: float, longitude: float) -> tuple[float, float]:
        """x, y [m] of a place [degrees]."""
        east = (longitude - self.longitude + 180.0) % 360.0 - 180.0
        return east * self._east, (latitude - self.latitude) * self._north

    def to_globe(self, x: float, y: float) -> tuple[float, float]:
        """Latitude and longitude [degrees] of a point [m]."""
        longitude = self.longitude + x / self._east
        return self.latitude + y / self._north, (longitude + 180.0) % 360.0 - 180.0
