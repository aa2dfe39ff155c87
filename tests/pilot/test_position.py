"""Positions on the plane and from gpsd: a server that speaks its protocol, and the real one."""

import math
import shutil
import socket
import subprocess
import time

import pytest
from gpsd_server import GpsdServer
from hypothesis import given
from hypothesis import strategies as st
from processes import free_port, until

from skyrelay.core.errors import PositionError, UsageError
from skyrelay.pilot.geodesy import Frame
from skyrelay.pilot.position import Gpsd

BOLOGNA = Frame(44.4949, 11.3426)


def earth_centred(latitude, longitude):
    """x, y, z on WGS 84 [m], by the textbook's formula."""
    a, e2 = 6378137.0, 6.69437999014e-3
    phi, lam = math.radians(latitude), math.radians(longitude)
    n = a / math.sqrt(1 - e2 * math.sin(phi) ** 2)
    return n * math.cos(phi) * math.cos(lam), n * math.cos(phi) * math.sin(lam), n * (1 - e2) * math.sin(phi)


@given(
    st.floats(-70, 70),
    st.floats(-180, 180),
    st.floats(0, 2 * math.pi),
    st.sampled_from([(3000.0, 2.0), (10_000.0, 20.0)]),
)
def test_distances_in_the_plane_are_those_on_the_globe(latitude, longitude, bearing, case):
    distance, error = case
    frame = Frame(latitude, longitude)
    x, y = distance * math.cos(bearing), distance * math.sin(bearing)
    there = frame.to_globe(x, y)
    apart = math.dist(earth_centred(latitude, longitude), earth_centred(*there))
    assert abs(apart - distance) < error
    assert frame.to_plane(*there) == pytest.approx((x, y), abs=1e-4)


def test_axes_are_east_and_north():
    x, y = BOLOGNA.to_plane(44.5049, 11.3426)
    assert (round(x), round(y)) == (0, 1111)
    x, y = BOLOGNA.to_plane(44.4949, 11.3526)
    assert (round(x), round(y)) == (795, 0)
    with pytest.raises(UsageError, match="origin: is"):
        Frame(91.0, 0.0)


@pytest.fixture
def gpsd():
    server = GpsdServer()
    yield server
    server.stop()


def test_reports_become_fixes(gpsd):
    with Gpsd(gpsd.address, BOLOGNA, battery=70.0) as receiver:
        assert receiver.fix().position is None
        gpsd.report(lat=44.5049, lon=11.3426, speed=13.9)
        fix = until(lambda: (fix := receiver.fix()).position and fix)
        assert fix.position == pytest.approx((0.0, 1111.0), abs=1.0)
        assert (fix.speed, fix.battery) == (13.9, 70.0)
        gpsd.report(mode=1)  # it has lost the satellites
        until(lambda: receiver.fix().position is None)


def test_an_old_report_is_none(gpsd):
    with Gpsd(gpsd.address, BOLOGNA, stale=0.1) as receiver:
        begin = time.monotonic()
        gpsd.report(lat=44.5, lon=11.3)
        until(lambda: receiver._last)
        until(lambda: receiver.fix().position is None)
        assert time.monotonic() - begin >= 0.1


@pytest.mark.parametrize(
    "line",
    [
        b"no json\n",
        b"[" * 60_000 + b"\n",
        b"x" * 100_000 + b"\n",
        b'{"class":"TPV"}\n',
        b"17\n",
        b'{"class":"TPV","mode":3,"lat":NaN,"lon":1}\n',
        b'{"class":"TPV","mode":3,"lat":91,"lon":1}\n',
        b'{"class":"TPV","mode":3,"lat":"x","lon":1}\n',
        b'{"class":"TPV","mode":3,"lat":1,"lon":1,"speed":1e9}\n',
    ],
)
def test_reports_that_are_none_are_counted_and_harm_nothing(gpsd, line):
    with Gpsd(gpsd.address, BOLOGNA) as receiver:
        gpsd.raw(line)
        gpsd.report(lat=44.5, lon=11.3)
        until(lambda: receiver.fix().position)
        assert receiver.ignored >= 1


def test_gpsd_that_starts_again_is_found_again():
    port = free_port()
    first = GpsdServer(port)
    with Gpsd(first.address, BOLOGNA) as receiver:
        first.report(lat=44.5, lon=11.3)
        until(lambda: receiver.fix().position)
        first.stop()
        second = GpsdServer(port)
        second.report(lat=44.6, lon=11.3)
        until(lambda: (position := receiver.fix().position) and position[1] > 11_000)
        second.stop()


def test_nobody_there_or_somebody_else_is_one_line():
    with pytest.raises(PositionError, match=r"gpsd at 127\.0\.0\.1:\d+: expected gpsd to answer within 1 s"):
        Gpsd(f"127.0.0.1:{free_port()}", BOLOGNA, patience=1.0)
    other = GpsdServer(greeting=b"220 mail.example.org ESMTP\r\n")
    with pytest.raises(PositionError, match="gpsd's greeting"):
        Gpsd(other.address, BOLOGNA)
    other.stop()
    with pytest.raises(UsageError, match="HOST:PORT"):
        Gpsd("2947", BOLOGNA)


def nmea(body):
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"${body}*{check:02X}\r\n".encode()


@pytest.mark.gpsd
def test_debians_gpsd():
    """The real program, fed with a receiver's sentences over UDP."""
    program = shutil.which("gpsd", path="/usr/sbin:/usr/bin:/usr/local/sbin")
    assert program, "no gpsd: apt-get install gpsd"
    port, feed = free_port(), free_port()
    process = subprocess.Popen([program, "-N", "-n", "-S", str(port), f"udp://127.0.0.1:{feed}"])
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:

        def open_receiver():
            try:
                return Gpsd(f"127.0.0.1:{port}", BOLOGNA, battery=50.0)
            except PositionError:
                return None

        with until(open_receiver) as receiver:

            def fed():
                clock = time.strftime("%H%M%S.00", time.gmtime())
                day = time.strftime("%d%m%y", time.gmtime())
                sender.sendto(
                    nmea(f"GPRMC,{clock},A,4430.2940,N,01120.5560,E,27.0,90.0,{day},,")
                    + nmea(f"GPGGA,{clock},4430.2940,N,01120.5560,E,1,08,0.9,100.0,M,45.0,M,,"),
                    ("127.0.0.1", feed),
                )
                return receiver.fix().position

            x, y = until(fed)
            assert (x, y) == pytest.approx((0.0, 1111.0), abs=3.0)
            until(lambda: fed() and receiver.fix().speed == pytest.approx(13.9, abs=0.1))
    finally:
        process.terminate()
        process.wait()
        sender.close()
