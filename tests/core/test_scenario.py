import json
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrelay.core.errors import ScenarioError
from skyrelay.core.scenario import Scenario, builtin_scenarios, load_scenario, to_commented_toml, to_toml, validate


@pytest.mark.parametrize("name", builtin_scenarios())
def test_builtin_scenarios_are_valid(name):
    assert load_scenario(name).name == name


def test_toml_round_trip_keeps_every_value():
    scenario = load_scenario("bologna", ["fleet.range=512.5", "chain.url=http://127.0.0.1:8545"], seed=7)
    assert validate(tomllib.loads(to_toml(scenario))) == scenario


@given(seed=st.integers(0, 2**32 - 1), uavs=st.integers(1, 2**16 - 1), share=st.floats(0.001, 1))
def test_any_valid_override_arrives(seed, uavs, share):
    scenario = load_scenario("bologna", [f"fleet.uavs={uavs}", f"mobility.penetration={share!r}"], seed=seed)
    assert (scenario.seed, scenario.fleet.uavs, scenario.mobility.penetration) == (seed, uavs, share)


@pytest.mark.parametrize(
    ("override", "place", "expected"),
    [
        ("fleet.uavs=0", "fleet.uavs", "greater than or equal to 1"),
        ("fleet.uav=3", "fleet.uav", "did you mean 'uavs'?"),
        ("selection.qou_weights=[0.5, 0.5, 0.5, 0.5]", "selection.qou_weights", "sum to 1"),
        ("fleet.battery=[90, 10]", "fleet.battery", "lower bound first"),
        ("fleet.speed=nan", "fleet.speed", "finite number"),
        ("mobility.source=teleport", "mobility.source", "one of trace, manhattan, random-waypoint"),
        ("demand.bandwidth=[1, 5]", "toml", "demand.bandwidth of at most selection.max_demand (5 is above 4)"),
        ("fleet", "--set", "key=value"),
        ("seed.deep=1", "--set", "a table"),
    ],
)
def test_a_bad_value_is_named_with_its_key_and_what_was_expected(override, place, expected):
    with pytest.raises(ScenarioError) as fault:
        load_scenario("bologna", ["seed=1", override])
    assert place in fault.value.place
    assert expected in str(fault.value)
    assert "\n" not in str(fault.value)


def test_paths_in_a_file_start_from_that_file(tmp_path):
    (tmp_path / "city.csv").write_text("time,id,x,y\n0,a,0,0\n")
    (tmp_path / "city.toml").write_text('[mobility]\ntrace = "city.csv"\n')
    assert load_scenario(tmp_path / "city.toml").mobility.trace == str(tmp_path / "city.csv")


def test_missing_and_broken_files_are_scenario_errors(tmp_path):
    with pytest.raises(ScenarioError, match="bologna"):
        load_scenario(tmp_path / "no.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("name = ")
    with pytest.raises(ScenarioError, match="TOML"):
        load_scenario(broken)


def test_scenarios_are_frozen():
    with pytest.raises(ValueError, match="frozen"):
        Scenario().seed = 3  # type: ignore[misc]


@pytest.mark.parametrize("name", ["../x", "a/b", "/etc/x", "a\\b", "a\nb", "a\x00b", "", "x" * 81])
def test_a_name_that_leaves_its_folder_is_refused(name):
    with pytest.raises(ScenarioError, match="name"):
        validate(load_scenario().model_dump(mode="json") | {"name": name}, "scenario.toml")


def test_a_byte_order_mark_is_no_key(tmp_path):
    (tmp_path / "city.toml").write_bytes(b"\xef\xbb\xbfseed = 3\r\n[fleet]\r\nuavs = 7\r\n")
    scenario = load_scenario(tmp_path / "city.toml")
    assert (scenario.seed, scenario.fleet.uavs) == (3, 7)


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        ([], "bologna"),
        (["fleet.uavs=7"], "bologna"),
        (["mobility.source=manhattan"], "manhattan"),
        (["mobility.trace=traces/city.csv"], "city"),
        (["mobility.source=manhattan", "name=mine"], "mine"),
    ],
)
def test_a_built_in_scenario_on_other_streets_is_named_after_them(overrides, name):
    assert load_scenario("bologna", overrides).name == name


def test_a_scenario_without_a_name_has_its_files_or_its_streets(tmp_path):
    (tmp_path / "town.toml").write_text("seed = 1")
    assert load_scenario(tmp_path / "town.toml").name == "town"
    assert validate({"mobility": {"source": "random-waypoint"}}).name == "random-waypoint"
    assert validate({"mobility": {"trace": "x" * 100}}).name == "bologna"  # no name of a folder


def geojson(path, *rings):
    features = [
        {"type": "Feature", "properties": {"height": 20}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
        for ring in rings
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return load_scenario("bologna", [f"obstacles.buildings={path}"])


def test_a_height_of_the_ground_is_passed_over(tmp_path):
    ring = [[0, 0, 5], [90, 0, 5], [90, 60, 5], [0, 0, 5]]
    assert geojson(tmp_path / "a.geojson", ring).obstacles.buildings[0].polygon == ((0, 0), (90, 0), (90, 60))
    with pytest.raises(ScenarioError, match="buildings"):
        geojson(tmp_path / "b.geojson", [[0], [90, 0], [90, 60]])


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (["radio.model=fibre"], "radio.model"),
        (["radio.channels=0"], "radio.channels"),
        (["radio.power=1000"], "radio.power"),
        (["radio.carier=2.0"], "did you mean 'carrier'"),
        (["radio.model=tr36777", "fleet.altitude=20.0"], "fleet.altitude above 22.5 m and up to 300 m"),
        (["radio.model=air-to-ground", "fleet.altitude=1.0"], "fleet.altitude above radio.antenna"),
        (['gateways=[{name = "a", x = 1.0}]'], "gateways.0.y"),
        (['gateways=[{name = "a", x = 1.0, y = 1.0, size = 3}]'], "gateways.0.size"),
        (['gateways=[{name = "a", x = 1.0, y = nan}]'], "gateways.0.y"),
        (['gateways=[{name = "a", x = 1.0, y = 1.0}, {name = "a", x = 2.0, y = 1.0}]'], "'a' is there twice"),
    ],
)
def test_a_radio_or_gateway_that_cannot_be_has_one_line(overrides, line):
    with pytest.raises(ScenarioError, match=line) as raised:
        load_scenario("bologna", overrides)
    assert "\n" not in str(raised.value)


def test_lists_of_words_are_written_and_read_back():
    scenario = load_scenario("bologna", [r'store.trusted_keys=["a key.pem", "b\"c.pem"]'])
    for text in (to_toml(scenario), to_commented_toml(scenario)):
        assert tomllib.loads(text)["store"]["trusted_keys"] == ["a key.pem", 'b"c.pem']


def test_gateways_are_written_and_read_back(tmp_path):
    scenario = load_scenario("bologna", ['gateways=[{name = "a", x = 1.0, y = 2.0, kind = "base-station"}]'])
    for text in (to_toml(scenario), to_commented_toml(scenario)):
        (tmp_path / "scenario.toml").write_text(text)
        assert load_scenario(tmp_path / "scenario.toml").gateways == scenario.gateways
