"""Vehicles of an own model: what it is given, and what it may answer."""

import sys

import numpy as np
import pytest

from skyrelay.core.errors import ScenarioError, SkyRelayError
from skyrelay.core.scenario import load_scenario
from skyrelay.mobility import load_tracks

OWN = """
import numpy as np


def circle(times, mobility, random):
    radius = 0.4 * mobility.area
    phase = random.uniform(0, 2 * np.pi, 5) + times[:, None] * mobility.speed[0] / radius
    x, y = 0.5 * mobility.area + radius * np.cos(phase), 0.5 * mobility.area + radius * np.sin(phase)
    x[0, 0] = y[0, 0] = np.nan
    return [f"car {number}" for number in range(5)], x, y


def far(times, mobility, random):
    return ["a"], np.full((len(times), 1), 1e9), np.zeros((len(times), 1))


def half(times, mobility, random):
    return ["a"], np.zeros((len(times), 1)), np.full((len(times), 1), np.nan)


def twice(times, mobility, random):
    return ["a", "a"], np.zeros((len(times), 2)), np.zeros((len(times), 2))


def short(times, mobility, random):
    return ["a"], np.zeros((2, 1)), np.zeros((2, 1))


def nobody(times, mobility, random):
    return ["a"], np.full((len(times), 1), np.nan), np.full((len(times), 1), np.nan)


def raises(times, mobility, random):
    raise OSError("no road")


def text(times, mobility, random):
    return ["a"], "here", "there"
"""


@pytest.fixture(autouse=True)
def own(tmp_path, monkeypatch):
    (tmp_path / "own_roads.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_roads", raising=False)


def tracks(name, seed=1):
    return load_tracks(load_scenario("bologna", [f"mobility.source=own_roads:{name}", "mobility.area=2000"], seed))


def test_an_own_model_drives():
    found = tracks("circle")
    assert found.ids == tuple(f"car {number}" for number in range(5))
    assert found.x.shape == (101, 5)
    assert np.isnan(found.x[0, 0])
    assert np.hypot(found.x - 1000, found.y - 1000)[1:] == pytest.approx(800)
    assert found.box == (0.0, 0.0, 2000.0, 2000.0)
    assert np.array_equal(found.x, tracks("circle").x, equal_nan=True)
    assert not np.array_equal(found.x, tracks("circle", seed=2).x, equal_nan=True)
    assert load_scenario("bologna", ["mobility.source=own_roads:circle"]).name == "circle"


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("far", "from 0 to mobility.area, 2000 m"),
        ("half", "NaN for both where absent"),
        ("twice", "1 of them distinct"),
        ("short", r"of shape \(2, 1\)'; expected \[101, 1\]"),
        ("nobody", "at least one vehicle"),
        ("raises", "OSError: no road"),
        ("text", "ids, x and y"),
        ("nothing", "a name in that module"),
    ],
)
def test_what_no_vehicle_can_drive_is_one_line(name, told):
    with pytest.raises(SkyRelayError, match=told):
        tracks(name)


def test_an_unknown_model_is_refused_when_the_scenario_is_read():
    with pytest.raises(ScenarioError, match="did you mean 'manhattan'"):
        load_scenario("bologna", ["mobility.source=manhatan"])


def test_a_file_cannot_have_code_loaded(tmp_path):
    (tmp_path / "theirs.toml").write_text('[mobility]\nsource = "their_roads:circle"\n')
    (tmp_path / "their_roads.py").write_text("raise SystemExit(3)\n")
    with pytest.raises(SkyRelayError, match="code that you name yourself"):
        load_tracks(load_scenario(tmp_path / "theirs.toml"))
