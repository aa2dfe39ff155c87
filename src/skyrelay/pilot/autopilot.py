"""A UAV that is flown for real: whatever speaks MAVLink, by MAVSDK; the only place that knows MAVSDK."""

from __future__ import annotations

import logging
import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import mavsdk
import numpy as np
from mavsdk.plugins.action import Action
from mavsdk.plugins.geofence import Geofence, geofence
from mavsdk.plugins.offboard import Offboard, offboard
from mavsdk.plugins.telemetry import Telemetry, telemetry

from skyrelay.airspace.flight import move
from skyrelay.airspace.law import Law
from skyrelay.core.errors import AutopilotError, UsageError
from skyrelay.pilot.geodesy import Frame
from skyrelay.pilot.logs import LOGGER
from skyrelay.protocol.messages import Fix

_URL = re.compile(r"(udp|udpin|udpout|tcpin|tcpout|serial)://\S+")
_NEAR = 1.0
"""So near to the altitude asked for [m], a climb is over."""
FENCE_MARGIN = 20.0
"""The autopilot's fence stands so far outside the zone [m]: set-points end at the zone's border, gusts need not."""


class Autopilot:
    """One UAV's; a position source too.

    Args:
        url: MAVSDK's, e.g. ``udp://127.0.0.1:14540`` (listens), ``udpout://HOST:PORT``, ``serial:///dev/ttyACM0:57600``.
        frame: where the scenario's plane is.
        patience: until an autopilot has said where it is and what its battery has [s].
        stale: a position older than this is none [s], by this machine's steady clock.
    Raises:
        UsageError: the URL is none, or its port is taken.
        AutopilotError: nobody answers, or it has no position.
    """

    def __init__(self, url: str, frame: Frame, *, patience: float = 30.0, stale: float = 2.0) -> None:
        if not _URL.fullmatch(url):
            raise UsageError("--autopilot", url, "an address such as udp://127.0.0.1:14540")
        self._url, self._frame, self._stale = url, frame, stale
        self._news = threading.Condition()
        self._position: tuple[float, telemetry.Position] | None = None
        self._battery: float | None = None
        self._speed = 0.0
        self._landed = False
        self._flying = threading.Lock()  # one command at a time
        self._going_home = False
        self._altitude = 0.0
        self._zone: tuple[Any, Any] | None = None
        mavsdk.log_subscribe(_log)
        kind = mavsdk.ComponentType.COMPANION_COMPUTER
        self._mavsdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(kind))
        try:
            self._connect(patience)
        except BaseException:
            self._mavsdk.destroy()
            raise

    def _connect(self, patience: float) -> None:
        result = self._mavsdk.add_any_connection(self._url.replace("udp://", "udpin://", 1))
        if result != mavsdk.ConnectionResult.SUCCESS:
            reason = mavsdk.ConnectionResult(result).name.lower().replace("_", " ")
            raise UsageError("--autopilot", self._url, f"an address that is free ({reason})")
        deadline = time.monotonic() + patience
        system = self._mavsdk.first_autopilot(patience)
        if system is None:
            raise AutopilotError(f"autopilot {self._url}", None, f"a heartbeat within {patience:g} s")
        self._action, self._offboard = Action(system), Offboard(system)
        self._geofence, self._telemetry = Geofence(system), Telemetry(system)
        self._telemetry.subscribe_position(self._note_position)
        self._telemetry.subscribe_velocity_ned(self._note_velocity)
        self._telemetry.subscribe_battery(self._note_battery)
        self._telemetry.subscribe_landed_state(self._note_landed)
        with self._news:
            known = self._news.wait_for(
                lambda: self._position is not None and self._battery is not None, deadline - time.monotonic()
            )
        if not known:
            missing = "position" if self._position is None else "battery"
            raise AutopilotError(f"autopilot {self._url}: {missing}", None, f"one within {patience:g} s")

    # What it says

    def fix(self) -> Fix:
        """Where it is; see `skyrelay.pilot.position.PositionSource`."""
        with self._news:
            battery, speed, noted = self._battery or 0.0, self._speed, self._position
        if noted is None or time.monotonic() - noted[0] > self._stale:
            return Fix(None, battery)
        return Fix(self._frame.to_plane(noted[1].latitude_deg, noted[1].longitude_deg), battery, speed)

    @property
    def altitude(self) -> float:
        """Above where it took off [m]."""
        with self._news:
            return 0.0 if self._position is None else float(self._position[1].relative_altitude_m)

    @property
    def landed(self) -> bool:
        """It stands on the ground, by what it says."""
        return self._landed

    def wait_until(self, true: Callable[[], bool], patience: float) -> bool:
        """Wait for its news to make something true; False where they have not within ``patience`` [s]."""
        with self._news:
            return self._news.wait_for(true, patience)

    # What it is asked

    def fence(self, law: Law, zone: int) -> None:
        """Have the autopilot itself keep within a zone (and `FENCE_MARGIN` around it).

        Raises:
            AutopilotError: it does not take the fence.
        """
        low = np.array(law.grid.corner(zone))
        high = low + law.grid.side
        (x0, y0), (x1, y1) = low - FENCE_MARGIN, high + FENCE_MARGIN
        corners = [self._frame.to_globe(x, y) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        polygon = geofence.Polygon([geofence.Point(*corner) for corner in corners], geofence.FenceType.INCLUSION)
        with self._asked("to take the zone's fence"):
            self._geofence.upload_geofence(geofence.GeofenceData(polygons=[polygon]))
        self._zone = (low, high)

    def take_off(self, altitude: float, speed: float, patience: float = 60.0) -> None:
        """Arm, climb, and hover there, ready for set-points.

        Args:
            altitude: above the ground [m].
            speed: of its moves [m/s].
            patience: for the climb [s].
        Raises:
            AutopilotError: it refuses, or is not up within ``patience``; then it is told to land.
        """
        with self._flying:
            with self._asked("to arm and take off"):
                self._action.set_takeoff_altitude(altitude)
                self._action.arm()
                self._action.takeoff()
            if not self.wait_until(lambda: self.altitude_reached(altitude), patience):
                with self._asked("to land after a climb that failed"):
                    self._action.land()
                raise AutopilotError(f"autopilot {self._url}: altitude", f"{self.altitude:.1f} m", f"{altitude:g} m")
            self._altitude = altitude
            position = self.fix().position
            if position is None:
                raise AutopilotError(f"autopilot {self._url}: position", None, "one to hover at")
            with self._asked("to fly by set-points"):
                self._action.set_current_speed(speed)
                self._aim(position)
                self._offboard.start()

    def altitude_reached(self, altitude: float) -> bool:
        """Whether it is at least nearly so high [m]."""
        return self._position is not None and self._position[1].relative_altitude_m >= altitude - _NEAR

    def fly(self, action: int, law: Law) -> None:
        """A move as the policy's: its set-point is where the law of flight has the move end, within the fenced zone.

        Args:
            action: 0 stays, 1 to 8 are the headings.
        Raises:
            AutopilotError: it has no zone, no position, or does not take the set-point.
        """
        with self._flying:
            position = self.fix().position
            if self._zone is None or position is None:
                raise AutopilotError(f"autopilot {self._url}", None, "a fenced zone and a fresh position before a move")
            if self._going_home:
                return
            low, high = self._zone
            end = move(np.array([position]), np.array([action]), np.array(law.stride), low, high)[0].tolist()
            with self._asked("to take a set-point"):
                self._aim((end[0], end[1]))

    def come_home(self) -> None:
        """Return to where it took off, and land; from then on it takes no set-points.

        Raises:
            AutopilotError: it refuses both this and to land where it is.
        """
        self._going_home = True
        with self._flying, self._asked("to return or to land"):
            try:
                self._action.return_to_launch()
            except mavsdk.MavsdkError as error:
                logging.getLogger(LOGGER).warning("autopilot: no return (%s): landing here", _reason(error))
                self._action.land()

    def close(self) -> None:
        """Let go of it: it is then on its own, with what it does where set-points stop coming."""
        self._mavsdk.destroy()

    def __enter__(self) -> Autopilot:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # Within

    def _aim(self, position: tuple[float, float]) -> None:
        latitude, longitude = self._frame.to_globe(*position)
        above_home = offboard.PositionGlobalYaw.AltitudeType.REL_HOME
        self._offboard.set_position_global(
            offboard.PositionGlobalYaw(latitude, longitude, self._altitude, 0.0, above_home)
        )

    @contextmanager
    def _asked(self, what: str) -> Iterator[None]:
        try:
            yield
        except mavsdk.MavsdkError as error:
            raise AutopilotError(f"autopilot {self._url}", _reason(error), what) from None

    def _note_position(self, position: telemetry.Position, _: Any) -> None:
        if all(map(math.isfinite, (position.latitude_deg, position.longitude_deg, position.relative_altitude_m))):
            with self._news:
                self._position = (time.monotonic(), position)
                self._news.notify_all()

    def _note_velocity(self, velocity: telemetry.VelocityNed, _: Any) -> None:
        speed = math.hypot(velocity.north_m_s, velocity.east_m_s)
        if math.isfinite(speed):
            self._speed = speed

    def _note_battery(self, battery: telemetry.Battery, _: Any) -> None:
        if math.isfinite(battery.remaining_percent):
            with self._news:
                self._battery = min(max(battery.remaining_percent, 0.0), 100.0)
                self._news.notify_all()

    def _note_landed(self, state: telemetry.LandedState, _: Any) -> None:
        with self._news:
            self._landed = state == telemetry.LandedState.ON_GROUND
            self._news.notify_all()


def _reason(error: Any) -> str:
    """MAVSDK's result, in words."""
    result = getattr(error, "result", None)
    return str(getattr(result, "name", error)).lower().replace("_", " ")


def _log(level: mavsdk.LogLevel, message: str, _file: str | None, _line: int) -> bool:
    """MAVSDK's own log goes where ours goes, a level lower; true keeps it from standard output."""
    worst = level >= mavsdk.LogLevel.ERROR
    logging.getLogger(LOGGER).log(logging.WARNING if worst else logging.DEBUG, "mavsdk: %s", message)
    return True
