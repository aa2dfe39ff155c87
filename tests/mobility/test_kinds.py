"""Traces of every kind: other names, units and formats, and what no vehicle does; each made for the purpose."""

import gzip
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrelay.core.errors import TraceError
from skyrelay.core.scenario import Mobility, load_scenario
from skyrelay.mobility import load_tracks, read_trace, replay

LINES = [
    (float(step), name, 10.0 * step + shift, 2.0 * shift)
    for step in range(12)
    for name, shift in (("v0", 0), ("v1", 100))
]
SUMO = "timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_speed;vehicle_lane;vehicle_edge"


def table(rows, header="time,id,x,y", delimiter=","):
    return "\n".join([header.replace(",", delimiter), *(delimiter.join(map(str, row)) for row in rows)]) + "\n"


def put(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(path, *parts, **mobility):
    with pytest.raises(TraceError) as fault:
        read_trace(path, Mobility(**mobility))
    text = str(fault.value)
    assert "\n" not in text
    for part in parts:
        assert part in text
    return text


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("tabs.csv", table(LINES, delimiter="\t")),
        ("tabs.tsv", table(LINES, delimiter="\t")),
        ("semicolons.csv", table(LINES, delimiter=";")),
        ("bom.csv", "\ufeff" + table(LINES)),
        ("crlf.csv", table(LINES).replace("\n", "\r\n")),
        ("padded.csv", table([(f" {t}", who, f"  {x} ", f"{y}  ") for t, who, x, y in LINES])),
        ("capitals.csv", table(LINES, "Time,ID,X,Y")),
        ("packed.csv.gz", gzip.compress(table(LINES).encode())),
        ("stamps.csv", table([(f"2026-03-01T08:00:{int(t):02d}Z", who, x, y) for t, who, x, y in LINES])),
    ],
)
def test_the_same_table_however_it_is_written(tmp_path, name, content):
    plain = read_trace(put(tmp_path, "plain.csv", table(LINES)))
    other = read_trace(put(tmp_path, name, content))
    assert other.ids == plain.ids
    np.testing.assert_array_equal(other.time - other.time.min(), plain.time)
    np.testing.assert_array_equal(other.x, plain.x)
    assert other.notes == ()


def test_ids_stay_what_they_are(tmp_path):
    names = ["007", "7", "1e3", "1000", " a b ", 'say "hi"', "<b>&amp;</b>", "x" * 5000, "NULL", "nan"]
    rows = [(t, '"' + name.replace('"', '""') + '"', 10 * t + k, 5 * k) for t in (0, 1) for k, name in enumerate(names)]
    assert read_trace(put(tmp_path, "ids.csv", table(rows))).ids == tuple(sorted(names))


def test_sumo_tables_are_what_its_xml_is(tmp_path):
    """A step without traffic is a row with a time alone, and pedestrians stand among the vehicles, on no lane."""
    rows = [
        "0;;;;;;",
        *(f"{t};a;{10 * t};0;10;e_0;" for t in range(1, 5)),
        *(f"{t};ped;{t};300;1;;e" for t in range(5)),
    ]
    steps = "".join(
        f'<timestep time="{t}"><vehicle id="a" x="{10 * t}" y="0" speed="10"/></timestep>' for t in range(1, 5)
    )
    last = '<timestep time="5"><person id="ped" x="1" y="300"/></timestep>'
    xml = f'<fcd-export><timestep time="0"/>{steps}{last}</fcd-export>'
    from_xml = read_trace(put(tmp_path, "run.xml", xml))
    from_table = read_trace(put(tmp_path, "run.csv", "\n".join([SUMO, *rows]) + "\n"))
    assert from_table.ids == from_xml.ids == ("a",)
    np.testing.assert_array_equal(from_table.time, from_xml.time)
    assert from_table.notes == ("5 rows of pedestrians left out (on an edge, on no lane)",)


def test_degrees_become_metres_where_names_or_speeds_say_so(tmp_path):
    start, step = (11.35, 44.49), 10.0 / 111_120
    rows = [(t, f"v{k}", start[0] + 0.001 * k, start[1] + step * t, 10.0) for t in range(20) for k in range(3)]
    named = read_trace(put(tmp_path, "named.csv", table([row[:4] for row in rows], "time,id,lon,lat")))
    proven = read_trace(put(tmp_path, "proven.csv", table(rows, "time,id,x,y,speed")))
    said = read_trace(put(tmp_path, "said.csv", table([row[:4] for row in rows])), Mobility(units="degrees"))
    for trace in (named, proven, said):
        assert trace.notes == ("degrees projected to WGS 84 / UTM zone 32N (EPSG:32632)",)
        same, gap, distance = trace.pairs
        np.testing.assert_allclose(distance[same] / gap[same], 10.0, rtol=0.005)
    refused(tmp_path / "said.csv", "x, y", 'mobility.units = "degrees"')
    wide = [(t, f"v{k}", 115.5 + 0.4 * k + 0.0001 * t, 39.5 + 0.3 * k) for t in range(9) for k in range(5)]
    refused(put(tmp_path, "wide.csv", table(wide)), "1.6 across", "degrees")


@pytest.mark.parametrize(
    ("unit", "ticks", "first"), [("ms", 10**3, 0), ("us", 10**6, 0), ("ns", 10**9, 1_600_000_000 * 10**9)]
)
def test_times_in_other_units_are_refused_until_they_are_named(tmp_path, unit, ticks, first):
    path = put(tmp_path, "t.csv", table([(first + int(t * ticks), who, x, y) for t, who, x, y in LINES]))
    refused(path, "vehicle v0", "mobility.time_unit")
    trace = read_trace(path, Mobility(time_unit=unit))
    np.testing.assert_array_equal(trace.time - trace.time.min(), [row[0] for row in sorted(LINES, key=lambda r: r[1])])


def test_lengths_in_other_units_are_named(tmp_path):
    path = put(tmp_path, "t.csv", table([(t, who, x / 1000, y / 1000) for t, who, x, y in LINES]))
    trace = read_trace(path, Mobility(units="km"))
    assert trace.box == pytest.approx((0.0, 0.0, 210.0, 200.0))
    assert trace.notes == ("lengths in km taken to metres",)


def test_sparse_samples_are_refused_with_the_key_that_bridges_them(tmp_path):
    path = put(tmp_path, "t.csv", table([(45 * t, who, 45 * x, y) for t, who, x, y in LINES]))
    refused(path, "vehicle v0 at 0 s", "45 s from the next sample", "mobility.max_gap")
    trace = read_trace(path, Mobility(max_gap=60))
    tracks = replay(trace, np.array([0.0, 20.0]), np.array([True, True]), 60)
    assert np.isfinite(tracks.x).all()


def test_irregular_samples_are_told(tmp_path):
    moments = np.cumsum([0, 7, 15, 9, 40, 8, 12])
    path = put(tmp_path, "t.csv", table([(t, "v0", 5 * t, 0) for t in moments]))
    first, second = read_trace(path).notes
    assert "median 10.5, longest 40" in first
    assert second == "1 gap over 30 s not bridged (mobility.max_gap)"


def test_a_lost_fix_is_named_and_can_be_dropped(tmp_path):
    far = [*LINES, (5.5, "v0", 900_000.0, 0.0)]
    path = put(tmp_path, "t.csv", table(far))
    refused(path, "vehicle v0 at 5.5 s", "(900000, 0)", 'mobility.lost_fixes = "drop"')
    trace = read_trace(path, Mobility(lost_fixes="drop"))
    assert len(trace.x) == len(LINES)
    assert "1 sample dropped" in trace.notes[-1]


def test_a_jump_is_not_bridged(tmp_path):
    rows = [(float(t), "v0", 10.0 * t + (0 if t < 6 else 2000), 0.0) for t in range(12)]
    trace = read_trace(put(tmp_path, "t.csv", table(rows)))
    assert trace.notes == ("1 jump faster than 150 m/s not bridged (first: v0 at 5 s)",)
    tracks = replay(trace, np.array([4.5, 5.5, 6.5]), np.array([True]))
    assert np.isfinite(tracks.x[:, 0]).tolist() == [True, False, True]


def test_sumos_mark_for_no_position_is_left_out(tmp_path):
    trace = read_trace(put(tmp_path, "t.csv", table([*LINES, (5.0, "bad", -1073741824.0, -1073741824.0)])))
    assert trace.ids == ("v0", "v1")
    assert trace.notes == ("1 sample without a position left out (SUMO's mark for it)",)


@pytest.mark.parametrize("count", range(1, 40))
def test_a_trace_of_tenths_is_as_long_as_it_is(tmp_path, count):
    rows = [(round(0.1 * step, 1), "v0", 1.0 * step, 0.0) for step in range(count + 1)]
    path = put(tmp_path, "t.csv", table(rows))
    overrides = [f"mobility.trace={path}", "mobility.penetration=1", "coordination.step_seconds=0.1"]
    tracks = load_tracks(load_scenario(overrides=[*overrides, f"coordination.steps={count}"]))
    assert np.isfinite(tracks.x).all()


NS2 = """# made for the purpose
$node_(0) set X_ 0.0
$node_(0) set Y_ 0.0
$node_(0) set Z_ 0
$node_(1) set X_ 500
$node_(1) set Y_ 100
$ns_ at 2.0 "$node_(0) setdest 100.0 0.0 10.0"
$ns_ at 7.0 "$node_(0) setdest 50.0 120.0 10.0"
"""


def test_ns2_movements_turn_where_they_are(tmp_path):
    trace = read_trace(put(tmp_path, "t.tcl", NS2))
    assert trace.ids == ("0", "1")
    tracks = replay(trace, np.array([0.0, 2.0, 4.5, 7.0, 13.5, 19.0]), np.array([True, True]))
    np.testing.assert_allclose(tracks.x[:, 0], [0, 0, 25, 50, 50, 50], atol=1e-6)
    np.testing.assert_allclose(tracks.y[:, 0], [0, 0, 0, 0, 65, 120], atol=1e-6)
    np.testing.assert_allclose(tracks.x[:, 1], 500)
    refused(put(tmp_path, "bad.tcl", NS2 + '$ns_ at x "$node_(0) setdest 1 2 3"\n'), "line 9", "setdest")


def test_bonnmotion_way_points(tmp_path):
    path = put(tmp_path, "t.movements", "0 0 0 10 100 0 20 100 50\n0 5 5 20 5 205\n")
    tracks = replay(read_trace(path), np.array([5.0, 15.0]), np.array([True, True]))
    np.testing.assert_allclose(tracks.x, [[50, 5], [100, 5]])
    np.testing.assert_allclose(tracks.y, [[0, 55], [25, 155]])
    refused(put(tmp_path, "bad.movements", "0 0 0 10 100\n"), "line 1", "time x y")


def test_gpx_and_geojson_tracks(tmp_path):
    points = [(11.35 + 0.0001 * t, 44.49, f"2026-03-01T08:00:{t:02d}Z") for t in range(10)]
    marks = "".join(f'<trkpt lon="{x}" lat="{y}"><time>{t}</time></trkpt>' for x, y, t in points)
    gpx = f'<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><name>bus 7</name><trkseg>{marks}</trkseg></trk></gpx>'
    line = {"type": "LineString", "coordinates": [[x, y, 30.0] for x, y, _ in points]}
    lines = {"properties": {"id": "bus 7", "coordTimes": [t for *_, t in points]}, "geometry": line}
    dots = [
        {"properties": {"id": "bus 7", "time": t}, "geometry": {"type": "Point", "coordinates": [x, y]}}
        for x, y, t in points
    ]
    traces = [
        read_trace(put(tmp_path, "t.gpx", gpx)),
        read_trace(put(tmp_path, "l.geojson", json.dumps({"type": "FeatureCollection", "features": [lines]}))),
        read_trace(put(tmp_path, "p.geojson", json.dumps({"type": "FeatureCollection", "features": dots}))),
    ]
    for trace in traces:
        assert trace.ids == ("bus 7",)
        np.testing.assert_allclose(trace.x, traces[0].x)
        assert np.diff(trace.x) == pytest.approx(7.95, abs=0.05)


@pytest.mark.parametrize(
    ("name", "content", "parts"),
    [
        ("twice.csv", table([(0, "a", 0, 0, 0)], "time,id,x,y,x"), ("x, x", "one column for the x")),
        ("both.csv", table([(0, 0, "a", 0, 0)], "timestep_time,time,id,x,y"), ("timestep_time, time", "one column")),
        ("late.csv", table(LINES).encode() + b"12,caf\xe9,1,2\n", ("UTF8",)),
        ("utf16.csv", table(LINES).encode("utf-16"), ("UTF-8",)),
        (
            "no-x.xml",
            '<f><timestep time="3"><vehicle id="a" speed="1"/></timestep></f>',
            ("timestep 3: vehicle a", "'x'"),
        ),
        ("no-time.xml", '<f><timestep><vehicle id="a" x="1" y="1"/></timestep></f>', ("'time'",)),
        ("blank.csv", table([*LINES, (12, "", 5, 5)]), ("row 25: id",)),
        ("hole.csv", table([*LINES, (12, "v0", "", 5)]), ("row 25: x",)),
        ("comma.csv", table([(0, "a", "1,5", 2)], delimiter=";"), ("row 1: x", "a number")),
        ("ragged.csv", "time,id,x,y\n0,a,0,0\n1,a,5\n", ("ragged.csv",)),
        ("empty.gpx", "<gpx/>", ("no point",)),
        ("deep.geojson", "[" * 5000, ("deep.geojson",)),
        ("huge.csv", table([(0, "a", "1e400", 2)]), ("row 1: x",)),
    ],
)
def test_what_does_not_fit_is_one_line(tmp_path, name, content, parts):
    refused(put(tmp_path, name, content), *parts)


@pytest.mark.parametrize("kind", [pa.bool_(), pa.list_(pa.float64()), pa.struct([("a", pa.int8())]), pa.date32()])
def test_other_types_in_parquet_are_one_line(tmp_path, kind):
    column = pa.nulls(3, kind)
    for role in ("x", "id", "time"):
        columns = {"time": [0.0, 1.0, 2.0], "id": ["a"] * 3, "x": [0.0, 5.0, 10.0], "y": [0.0] * 3} | {role: column}
        pq.write_table(pa.table(columns), tmp_path / "t.parquet")
        refused(tmp_path / "t.parquet", role)


def test_a_run_that_connects_nobody_says_so(tmp_path):
    with pytest.raises(TraceError, match=r"mobility\.penetration"):
        load_tracks(load_scenario(overrides=["mobility.penetration=1e-9"]))
