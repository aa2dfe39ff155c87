"""Where a member is, by a receiver of its own: the interface, and gpsd."""

from __future__ import annotations

import math
import socket
import threading
import time
from contextlib import suppress
from types import TracebackType
from typing import Protocol, runtime_checkable

from skyrelay.core.errors import PositionError, UsageError
from skyrelay.core.untrusted import parse_json
from skyrelay.pilot.geodesy import Frame
from skyrelay.protocol.messages import Fix

GPSD = "127.0.0.1:2947"
LONGEST_LINE = 64 * 1024
"""Bytes of a report."""
_WATCH = b'?WATCH={"enable":true,"json":true};\n'
_FLAT = 2
"""TPV's mode of a fix without altitude; 3 is one with, less is none."""


@runtime_checkable
class PositionSource(Protocol):
    """A receiver."""

    def fix(self) -> Fix:
        """The newest; its position is None where there is none, or none that is fresh."""
        ...


class Gpsd:
    """A receiver behind gpsd; asks it to report, reads along in a thread, and connects again when the line breaks.

    Args:
        address: ``HOST:PORT`` of gpsd.
        frame: where the scenario's plane is.
        battery: of the member that carries the receiver [0-100].
        stale: a report older than this is none [s], by this machine's steady clock.
        patience: until gpsd has answered [s].

    Attributes:
        ignored: reports that were not to be understood.
    Raises:
        UsageError: the address is none.
        PositionError: nobody answers there, or something that is no gpsd.
    """

    def __init__(
        self,
        address: str,
        frame: Frame,
        *,
        battery: float = 0.0,
        stale: float = 3.0,
        patience: float = 5.0,
    ) -> None:
        host, colon, port = address.rpartition(":")
        if not (colon and host and port.isascii() and port.isdigit() and 0 < int(port) < 1 << 16):
            raise UsageError("gpsd", address, f"HOST:PORT, e.g. {GPSD}")
        self.ignored = 0
        self._address, self._frame = (host, int(port)), frame
        self._battery, self._stale, self._patience = battery, stale, patience
        self._lock = threading.Lock()
        self._last: tuple[float, Fix] | None = None
        self._closed = threading.Event()
        self._line = _connected(self._address, patience)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def fix(self) -> Fix:
        """The newest; see `PositionSource`."""
        with self._lock:
            if self._last is None or time.monotonic() - self._last[0] > self._stale:
                return Fix(None, self._battery)
            return self._last[1]

    def close(self) -> None:
        """Let go of gpsd."""
        self._closed.set()
        with suppress(OSError):
            self._line.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._line.close()

    def __enter__(self) -> Gpsd:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _read(self) -> None:
        while not self._closed.is_set():
            with suppress(OSError), self._line.makefile("rb") as lines:
                while line := lines.readline(LONGEST_LINE):
                    self._take(line)
            self._line.close()
            while not self._closed.wait(0.2):
                with suppress(PositionError):
                    self._line = _connected(self._address, self._patience)
                    break

    def _take(self, line: bytes) -> None:
        """Note a report of the time, position and velocity; the others are of no use here."""
        try:
            report = parse_json(line, size=LONGEST_LINE)
            if report["class"] != "TPV":
                return
            position = None
            if report["mode"] >= _FLAT:
                position = self._frame.to_plane(_number(report["lat"], 90.0), _number(report["lon"], 180.0))
            fix = Fix(position, self._battery, _number(report.get("speed", 0.0), 1000.0))
        except (ValueError, KeyError, TypeError):
            self.ignored += 1
            return
        with self._lock:
            self._last = (time.monotonic(), fix)


def _connected(address: tuple[str, int], patience: float) -> socket.socket:
    """A line to gpsd that it has greeted us on, and that it reports on.

    Raises:
        PositionError: nobody answers there, or something that is no gpsd.
    """
    place = f"gpsd at {address[0]}:{address[1]}"
    try:
        line = socket.create_connection(address, timeout=patience)
    except OSError as error:
        raise PositionError(place, None, f"gpsd to answer within {patience:g} s ({error.strerror or error})") from None
    try:
        greeting = b""
        while not greeting.endswith(b"\n") and len(greeting) < LONGEST_LINE:
            byte = line.recv(1)
            if not byte:
                break
            greeting += byte
        greeted = parse_json(greeting, size=LONGEST_LINE)["class"] == "VERSION"
        line.sendall(_WATCH)
        line.settimeout(None)
    except (OSError, ValueError, KeyError, TypeError):
        greeted = False
    if not greeted:
        line.close()
        raise PositionError(place, None, f"gpsd's greeting within {patience:g} s")
    return line


def _number(value: float, largest: float) -> float:
    """The value as a finite number within bounds."""
    number = float(value)
    if not (math.isfinite(number) and abs(number) <= largest):
        raise ValueError(value)
    return number
