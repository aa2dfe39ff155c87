"""Lost and late beacons, over the default run."""

import importlib.util
from pathlib import Path

import pytest

_spec = importlib.util.spec_from_file_location("weather", Path(__file__).parents[2] / "benchmarks" / "weather.py")
assert _spec is not None
weather = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(weather)


@pytest.fixture(scope="module")
def perfect():
    return weather.play(1, 0.0, 0.0)


@pytest.mark.parametrize(("loss", "delay"), [(0.1, 0.2), (0.3, 0.0), (0.0, 1.0)])
def test_a_team_flies_about_as_well_on_lost_and_late_beacons(perfect, loss, delay):
    found = weather.play(1, loss, delay)
    assert found != perfect
    assert found["coverage"] > perfect["coverage"] - 0.02
    assert found["connectivity"] > perfect["connectivity"] - 0.01


def test_uavs_that_hear_nothing_cover_less(perfect):
    """What a UAV never heard of it does not follow: the figures above are not those of any flight."""
    assert weather.play(1, 1.0, 0.0)["coverage"] < perfect["coverage"] - 0.02
