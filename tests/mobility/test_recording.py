"""Recording from SUMO: the real simulator where libsumo is installed (make test-sumo), clear errors where it is not."""

import importlib.util
import json
import math
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest

from skyrelay.core.errors import TraceError, UsageError
from skyrelay.mobility import read_trace
from skyrelay.mobility.recording import record

INSTALLED = importlib.util.find_spec("libsumo") is not None
needs_sumo = pytest.mark.skipif(not INSTALLED, reason="needs libsumo: make test-sumo")

# One street of 400 m from west to east, then north; no internal lanes at the corner.
NETWORK = """<net version="1.20" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">
    <location netOffset="0,0" convBoundary="0,0,400,300" origBoundary="0,0,400,300" projParameter="!"/>
    <edge id="east" from="a" to="b"><lane id="east_0" index="0" speed="13.9" length="400" shape="0,0 400,0"/></edge>
    <edge id="north" from="b" to="c">
        <lane id="north_0" index="0" speed="13.9" length="300" shape="400,0 400,300"/>
    </edge>
    <junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,-3"/>
    <junction id="b" type="priority" x="400" y="0" incLanes="east_0" intLanes="" shape="400,0 400,-3 403,0">
        <request index="0" response="0" foes="0"/>
    </junction>
    <junction id="c" type="dead_end" x="400" y="300" incLanes="north_0" intLanes="" shape="400,300 403,300"/>
    <connection from="east" to="north" fromLane="0" toLane="0" dir="l" state="M"/>
</net>"""
ROUTES = """<routes>
    <route id="way" edges="east north"/>
    <vehicle id="first" route="way" depart="0" departSpeed="10"/>
    <vehicle id="second" route="way" depart="20" departSpeed="10"/>
</routes>"""
CONFIG = """<configuration>
    <input><net-file value="street.net.xml"/><route-files value="street.rou.xml"/></input>
    <time><begin value="0"/><end value="200"/></time>
</configuration>"""


@pytest.fixture
def street(tmp_path):
    (tmp_path / "street.net.xml").write_text(NETWORK)
    (tmp_path / "street.rou.xml").write_text(ROUTES)
    config = tmp_path / "street.sumocfg"
    config.write_text(CONFIG)
    return config


@needs_sumo
def test_a_recording_is_a_trace_of_what_drives(street, tmp_path):
    recording = record(street, tmp_path / "out" / "street.parquet")
    trace = read_trace(recording.path)
    assert trace.ids == ("first", "second")
    assert recording.vehicles == 2
    assert recording.samples == len(trace.time)
    assert trace.attribution.startswith("SUMO ")
    first = trace.vehicle == 0
    assert (np.diff(trace.time[first]) == 1.0).all()
    # Ahead along the street, then the corner, never faster than it allows.
    along = trace.x[first] + trace.y[first]
    assert (np.diff(along) > 0).all()
    assert np.diff(along).max() <= 13.9 * 1.2
    assert along[-1] - along[0] > 500
    rows = pq.read_table(recording.path).to_pylist()
    angles = [row["angle"] for row in rows if row["id"] == "first"]
    assert (angles[0], angles[-1]) == (90.0, 0.0)  # east, then north


@needs_sumo
def test_seconds_and_step_length(street, tmp_path):
    recording = record(street, tmp_path / "street.parquet", seconds=10, step_length=0.5)
    trace = read_trace(recording.path)
    assert trace.ids == ("first",)
    assert (np.diff(trace.time) == 0.5).all()
    assert trace.time[-1] == 10.0


@needs_sumo
def test_the_same_seed_gives_the_same_trace(street, tmp_path):
    tables = [
        pq.read_table(record(street, tmp_path / f"{run}.parquet", seed=seed).path) for run, seed in enumerate((1, 1, 2))
    ]
    assert tables[0].equals(tables[1])
    assert not tables[0].equals(tables[2])


@needs_sumo
@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<configuration", "end of input"),
        ('<configuration><input><net-file value="nowhere.net.xml"/></input></configuration>', "nowhere.net.xml"),
        (CONFIG.replace("street.rou.xml", "street.net.xml"), "no vehicle"),
    ],
)
def test_what_sumo_refuses_is_one_line_and_leaves_nothing(street, tmp_path, text, told, capfd):
    street.write_text(text)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(TraceError, match=told) as fault:
        record(street, tmp_path / "out.parquet")
    assert "\n" not in str(fault.value)
    assert sorted(tmp_path.iterdir()) == before
    assert capfd.readouterr().err == ""
    # The process can simulate again.
    street.write_text(CONFIG)
    assert record(street, tmp_path / "out.parquet").vehicles == 2


@needs_sumo
def test_the_command_prints_nothing_but_the_result(street, tmp_path):
    # A process of its own: libsumo prints a warning where it is imported first.
    line = ["record", street, "--out", tmp_path / "street.parquet", "--seconds", "30", "--json"]
    run = [sys.executable, "-c", "from skyrelay.cli.main import main; main()", *map(str, line)]
    ended = subprocess.run(run, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    result = json.loads(ended.stdout)
    assert (result["vehicles"], result["end_seconds"]) == (2, 30.0)


@pytest.mark.skipif(INSTALLED, reason="libsumo is installed")
def test_without_libsumo_the_command_says_what_to_install(street, tmp_path):
    with pytest.raises(UsageError, match=r"pip install 'skyrelay\[sumo\]'"):
        record(street, tmp_path / "street.parquet")


@pytest.mark.parametrize(
    ("options", "place"),
    [({"out": "trace.csv"}, "--out"), ({"seconds": 0.0}, "--seconds"), ({"step_length": math.nan}, "--step-length")],
)
def test_bad_options_are_named(tmp_path, options, place):
    out = tmp_path / options.pop("out", "trace.parquet")
    with pytest.raises(UsageError, match=place):
        record(tmp_path / "any.sumocfg", out, **options)
