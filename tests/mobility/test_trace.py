import gzip

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrelay.core.errors import TraceError
from skyrelay.mobility import Trace, read_trace, replay

ROWS = [(0.0, "a", 0.0, 0.0), (0.0, "b", 100.0, 50.0), (2.0, "a", 20.0, 10.0), (4.0, "b", 80.0, 50.0)]
XML = """<fcd-export>
  <timestep time="0.00"><vehicle id="a" x="0" y="0"/><vehicle y="50" x="100" id="b"/></timestep>
  <timestep time="2.00"><vehicle id="a" x="20" y="10" angle="3"/></timestep>
  <timestep time="4.00"><vehicle id="b" x="80" y="50"/></timestep>
</fcd-export>"""


def write(path, rows=ROWS, names=("time", "id", "x", "y"), delimiter=","):
    if path.suffix == ".parquet":
        pq.write_table(pa.table({name: [row[k] for row in rows] for k, name in enumerate(names)}), path)
    else:
        lines = [delimiter.join(map(str, row)) for row in (names, *rows)]
        path.write_text("\n".join(lines) + "\n")
    return path


def samples(trace):
    ids = [trace.ids[row] for row in trace.vehicle]
    return sorted(zip(trace.time.tolist(), ids, trace.x.tolist(), trace.y.tolist(), strict=True))


def test_every_format_gives_the_same_trace(tmp_path):
    (tmp_path / "t.xml").write_text(XML)
    with gzip.open(tmp_path / "t.xml.gz", "wt") as stream:
        stream.write(XML)
    sumo = ("timestep_time", "vehicle_id", "vehicle_x", "vehicle_y")
    paths = [
        write(tmp_path / "t.parquet"),
        write(tmp_path / "t.csv"),
        write(tmp_path / "sumo.csv", names=sumo, delimiter=";"),
        tmp_path / "t.xml",
        tmp_path / "t.xml.gz",
    ]
    for path in paths:
        assert samples(read_trace(path)) == ROWS


def test_numeric_ids_are_read_as_text(tmp_path):
    trace = read_trace(write(tmp_path / "t.parquet", [(0, 7, 0.0, 0.0), (1, 10, 5.0, 5.0)]))
    assert trace.ids == ("10", "7")


@pytest.mark.parametrize(
    ("rows", "names", "place"),
    [
        ([(0.0, "a", "east", 0.0)], ("time", "id", "x", "y"), "row 1: x"),
        ([(0.0, "a", 0.0, 0.0), (1.0, "a", float("nan"), 0.0)], ("time", "id", "x", "y"), "row 2: x"),
        ([(0.0, "a", 0.0, 0.0)], ("time", "id", "x", "z"), "column 'y'"),
        ([(0.0, "a", 0.0, 0.0), (0.0, "a", 5.0, 0.0)], ("time", "id", "x", "y"), "a twice at 0 s"),
        ([(0.0, "a", 11.34, 44.49), (1.0, "a", 11.35, 44.5)], ("time", "id", "x", "y"), "metres"),
    ],
)
def test_a_bad_trace_is_one_line_with_its_place(tmp_path, rows, names, place):
    for ending in ("parquet", "csv"):
        path = write(tmp_path / f"bad.{ending}", rows, names)
        with pytest.raises(TraceError) as fault:
            read_trace(path)
        assert place in str(fault.value)
        assert "\n" not in str(fault.value)


@pytest.mark.parametrize("content", [b"", b"PAR1garbage", b"<fcd-export><timestep", b"time,id,x,y\n"])
@pytest.mark.parametrize("ending", ["parquet", "csv", "xml", "xml.gz", "txt"])
def test_broken_files_are_trace_errors(tmp_path, content, ending):
    path = tmp_path / f"broken.{ending}"
    path.write_bytes(content)
    with pytest.raises(TraceError):
        read_trace(path)


@settings(max_examples=50)
@given(st.data())
def test_replay_agrees_with_interpolating_each_vehicle_alone(data):
    tables = {}
    for name in "abc":
        times = data.draw(st.lists(st.integers(0, 20), min_size=1, max_size=6, unique=True).map(sorted))
        tables[name] = [
            (float(t), name, data.draw(st.floats(0, 100)), float(data.draw(st.integers(2, 90)))) for t in times
        ]
    rows = [row for table in tables.values() for row in table]
    trace = _trace(rows)
    clock = np.arange(0.0, 21.0, data.draw(st.sampled_from([0.5, 1.0, 3.0])))
    connected = np.array([True, data.draw(st.booleans()), True])
    tracks = replay(trace, clock, connected)
    for column, name in enumerate(tracks.ids):
        times, xs = [row[0] for row in tables[name]], [row[2] for row in tables[name]]
        inside = (clock >= times[0]) & (clock <= times[-1])
        assert (np.isfinite(tracks.x[:, column]) == inside).all()
        np.testing.assert_allclose(tracks.x[inside, column], np.interp(clock[inside], times, xs), atol=1e-6)


def _trace(rows):
    ids = sorted({row[1] for row in rows})
    rows = sorted(rows, key=lambda row: (row[1], row[0]))
    time, x, y = (np.array([row[k] for row in rows]) for k in (0, 2, 3))
    return Trace(tuple(ids), np.array([ids.index(row[1]) for row in rows]), time, x, y, "")


def test_a_vehicle_is_absent_across_a_long_gap(tmp_path):
    rows = [(0.0, "a", 0.0, 0.0), (1.0, "a", 0.5, 0.0), (2.0, "a", 1.0, 0.0), (100.0, "a", 50.0, 50.0)]
    tracks = replay(read_trace(write(tmp_path / "t.csv", rows)), np.array([0.0, 50.0, 100.0]), np.array([True]))
    assert np.isfinite(tracks.x[:, 0]).tolist() == [True, False, True]


@pytest.mark.parametrize("name", ["t.xml.gz", "t.gpx.gz"])
@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"<fcd-export><timestep time='" + b"9" * 2**22, "a tag or text of more than"),
        (b"<fcd-export>" + b"9" * 2**22, "a tag or text of more than"),
        (b"<a>" * 100_000, "more than 32 levels"),
    ],
    ids=["attribute", "text", "depth"],
)
def test_a_small_file_that_unpacks_to_much_is_no_long_wait(tmp_path, name, content, told):
    with gzip.open(tmp_path / name, "wb") as stream:
        stream.write(content)
    with pytest.raises(TraceError, match=told):
        read_trace(tmp_path / name)
