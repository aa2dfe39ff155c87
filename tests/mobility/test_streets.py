import gzip
import json

import numpy as np
import pytest

from skyrelay.core.errors import ScenarioError
from skyrelay.core.scenario import load_scenario
from skyrelay.mobility import load_tracks, read_streets
from skyrelay.mobility import streets as module
from skyrelay.mobility.plane import between, project
from skyrelay.simulation.world import World

BOX = (0.0, 0.0, 1000.0, 1000.0)

NETWORK = """<?xml version="1.0" encoding="UTF-8"?>
<net version="1.20">
    <location netOffset="-680000.00,-4928000.00" convBoundary="0,0,900,900" origBoundary="11,44,12,45"
              projParameter="+proj=utm +zone=32 +ellps=WGS84 +datum=WGS84 +units=m +no_defs"/>
    <edge id=":a_0" function="internal"><lane id=":a_0_0" index="0" shape="500,500 501,501"/></edge>
    <edge id="main" from="a" to="b" priority="1">
        <lane id="main_0" index="0" allow="pedestrian" shape="0.00,-3.00 900.00,-3.00"/>
        <lane id="main_1" index="1" shape="0.00,0.00 300.00,0.00,12.5 900.00,0.00"/>
        <lane id="main_2" index="2" shape="0.00,3.00 900.00,3.00"/>
    </edge>
    <edge id="bare" from="b" to="c" shape="900,0 900,900"/>
    <edge id="elsewhere"><lane id="elsewhere_0" index="0" shape="9000,9000 9900,9900"/></edge>
    <junction id="a" type="priority" x="0" y="0" shape="0,0 1,1"/>
</net>
"""


def network(folder, text=NETWORK, name="city.net.xml"):
    path = folder / name
    (gzip.open if name.endswith(".gz") else open)(path, "wb").write(text.encode())
    return path


def geojson(folder, *geometries, name="city.geojson"):
    features = [{"type": "Feature", "properties": {}, "geometry": geometry} for geometry in geometries]
    path = folder / name
    content = json.dumps({"type": "FeatureCollection", "features": features}).encode()
    path.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    return path


def line(*corners):
    return {"type": "LineString", "coordinates": [list(corner) for corner in corners]}


@pytest.mark.parametrize("name", ["city.net.xml", "city.net.xml.gz"])
def test_a_network_s_edges_in_the_area_each_by_its_middle_lane(tmp_path, name):
    main, bare = read_streets(network(tmp_path, name=name), BOX)
    np.testing.assert_array_equal(main, [[0, 0], [300, 0], [900, 0]])
    np.testing.assert_array_equal(bare, [[900, 0], [900, 900]])


@pytest.mark.parametrize("name", ["city.geojson", "city.geojson.gz", "city.json"])
def test_geojson_lines_in_the_area_s_metres(tmp_path, name):
    path = geojson(
        tmp_path,
        line((10, 20, 55.5), (30, 40)),
        {"type": "MultiLineString", "coordinates": [[[0, 0], [0, 9]], [[5, 5], [500, 5], [600, 6]]]},
        {"type": "Point", "coordinates": [1, 1]},
        None,
        name=name,
    )
    first, second, third = read_streets(path, BOX)
    np.testing.assert_array_equal(first, [[10, 20], [30, 40]])
    np.testing.assert_array_equal(second, [[0, 0], [0, 9]])
    assert len(third) == 3


def test_degrees_and_a_network_are_placed_as_the_vehicles_degrees_were(tmp_path):
    longitude, latitude = np.array([11.30, 11.36]), np.array([44.48, 44.52])
    x, y, plane = project(longitude, latitude)
    assert plane == 32632
    box = (x.min(), y.min(), x.max(), y.max())
    (street,) = read_streets(geojson(tmp_path, line(*zip(longitude, latitude, strict=True))), box, plane)
    np.testing.assert_allclose(street, np.column_stack([x, y]), atol=0.01)
    moved = NETWORK.replace('"-680000.00,-4928000.00"', f'"{-x[0]},{-y[0]}"')
    main, _ = read_streets(network(tmp_path, moved), box, plane)[:2]
    np.testing.assert_allclose(main[0], (x[0], y[0]), atol=0.02)
    # A network of the next zone is brought over.
    other = between(plane, 32633, x[:1], y[:1])
    moved = NETWORK.replace('"-680000.00,-4928000.00"', f'"{-other[0][0]},{-other[1][0]}"').replace("=32", "=33")
    main = read_streets(network(tmp_path, moved), box, plane)[0]
    np.testing.assert_allclose(main[0], (x[0], y[0]), atol=0.02)


def test_a_trace_in_degrees_tells_its_plane(tmp_path):
    rows = [f"{t},a,{11.3 + 0.0002 * t},{44.5 + 0.0001 * t}" for t in range(12)]
    (tmp_path / "gps.csv").write_text("\n".join(["time,id,lon,lat", *rows]))
    (tmp_path / "own.toml").write_text(
        '[mobility]\ntrace = "gps.csv"\npenetration = 1.0\n[map]\nstreets = "city.geojson"\n'
        "[zones]\ncolumns = 1\nrows = 1\n[fleet]\nuavs = 2\n[coordination]\nsteps = 5\nperiod_steps = 5\n"
    )
    geojson(tmp_path, line((11.3, 44.5), (11.3022, 44.5011)))
    scenario = load_scenario(tmp_path / "own.toml")
    tracks = load_tracks(scenario)
    assert tracks.plane == 32632
    (street,) = World.of(scenario).streets
    np.testing.assert_allclose(street[0], (tracks.x[0, 0], tracks.y[0, 0]), atol=0.01)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "no element found"),
        ("<net><edge id='e'><lane shape='0,0 1,1'/></edge>", "no element found"),
        ("<html/>", "root element <net>"),
        ("<net></net>", "at least one street"),
        ("<net><edge id='e'><lane shape='0,0'/></edge></net>", "edge e: shape"),
        ("<net><edge id='e'><lane shape='0,0 nan,5'/></edge></net>", "edge e: shape"),
        ("<net><edge id='e'><lane shape='0,0 1e999,5'/></edge></net>", "edge e: shape"),
        ("<net><edge id='e'><lane shape='0,0 a,5'/></edge></net>", "edge e: shape"),
        ("<net><edge id='e'><lane shape='0 1'/></edge></net>", "edge e: shape"),
        ("<net><edge id='e'><lane shape='1e6,0 2e6,0'/></edge></net>", "in the run's area"),
        ("<net><edge id='e'><lane shape='11.30,44.50 11.31,44.51'/></edge></net>", "in the run's area"),
        ("<net>" + "<a>" * 5000 + "</a>" * 5000 + "</net>", "more than 32 levels"),
        ("<net><edge id='e'>" + "<lane/>" * 100_001 + "</edge></net>", "more than 100,000 elements"),
        ('<!DOCTYPE net [<!ENTITY a SYSTEM "file:///etc/passwd">]><net>&a;</net>', "undefined entity"),
    ],
)
def test_a_network_that_does_not_fit_is_one_line(tmp_path, text, expected):
    with pytest.raises(ScenarioError, match=r"map\.streets") as fault:
        read_streets(network(tmp_path, text), BOX)
    assert expected in str(fault.value)
    assert len(str(fault.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "Expecting value"),
        (b"[]", "FeatureCollection"),
        (b"[" * 50_000, "32 levels"),
        (b'{"features": [1]}', r"features[0]"),
        (b'{"features": [{"geometry": {"type": "LineString", "coordinates": [[0, 0], [NaN, 1]]}}]}', r"features[0]"),
        (b'{"features": [{"geometry": {"type": "LineString", "coordinates": [[0, 0], [true, 1]]}}]}', r"features[0]"),
        (b'{"features": [{"geometry": {"type": "LineString", "coordinates": [[0, 0], [1]]}}]}', r"features[0]"),
        (b'{"features": [{"geometry": {"type": "LineString", "coordinates": [[0, 0], [1e999, 1]]}}]}', r"features[0]"),
        (
            b'{"features": [{"geometry": {"type": "LineString", "coordinates": [[0,0],[1' + 400 * b"0" + b",1]]}}]}",
            "[0]",
        ),
        (b'{"features": [{"geometry": {"type": "Point", "coordinates": [0, 0]}}]}', "at least one street"),
        (b"\xff\xfe", "utf-8"),
    ],
)
def test_geojson_that_does_not_fit_is_one_line(tmp_path, content, expected):
    path = tmp_path / "city.geojson"
    path.write_bytes(content)
    with pytest.raises(ScenarioError, match=r"map\.streets") as fault:
        read_streets(path, BOX)
    assert expected in str(fault.value)
    assert len(str(fault.value).splitlines()) == 1


def test_a_network_without_a_known_projection_is_no_map_of_degrees(tmp_path):
    with pytest.raises(ScenarioError, match="projParameter"):
        read_streets(network(tmp_path, NETWORK.replace("+proj=utm", "+nadgrids=@/etc/passwd")), BOX, 32632)
    with pytest.raises(ScenarioError, match="netOffset"):
        read_streets(network(tmp_path, NETWORK.replace("-680000.00,", "")), BOX, 32632)


def test_what_is_packed_is_bounded_too(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MAX_NETWORK", 10_000)
    padded = NETWORK.replace("</net>", " " * 10_000 + "</net>")
    assert len(gzip.compress(padded.encode())) < 2_000
    with pytest.raises(ScenarioError, match="more than 10,000 bytes"):
        read_streets(network(tmp_path, padded, "city.net.xml.gz"), BOX)
    monkeypatch.setattr(module, "MAX_POINTS", 4)
    with pytest.raises(ScenarioError, match="5 corners in the area"):
        read_streets(network(tmp_path), BOX)


@pytest.mark.parametrize(
    ("name", "expected"), [("city.pbf", "ends in"), ("gone.net.xml", "that exists"), ("folder.geojson", "that exists")]
)
def test_a_file_of_another_kind_or_none(tmp_path, name, expected):
    (tmp_path / "folder.geojson").mkdir()
    with pytest.raises(ScenarioError, match=expected):
        read_streets(tmp_path / name, BOX)
    (tmp_path / "torn.geojson.gz").write_bytes(gzip.compress(b"{}" * 1000)[:20])
    with pytest.raises(ScenarioError, match="can be read"):
        read_streets(tmp_path / "torn.geojson.gz", BOX)
