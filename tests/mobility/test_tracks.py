import numpy as np
import pytest

from skyrelay.core.errors import TraceError
from skyrelay.core.scenario import load_scenario
from skyrelay.mobility import load_tracks


def test_the_builtin_trace_has_the_share_of_vehicles_asked_for():
    few = load_tracks(load_scenario(overrides=["mobility.penetration=0.1"]))
    more = load_tracks(load_scenario(overrides=["mobility.penetration=0.4"]))
    assert set(few.ids) < set(more.ids)
    assert len(more.ids) / len(few.ids) == pytest.approx(4, rel=0.3)


def test_a_seed_gives_one_choice_and_another_seed_another():
    again = [load_tracks(load_scenario(seed=seed)).ids for seed in (1, 1, 2)]
    assert again[0] == again[1] != again[2]


def test_a_trace_shorter_than_the_run_says_so():
    with pytest.raises(TraceError, match="599 s long"):
        load_tracks(load_scenario(overrides=["coordination.steps=1000"]))


@pytest.mark.parametrize("source", ["manhattan", "random-waypoint"])
def test_synthetic_vehicles_stay_inside_and_keep_their_speed(source):
    scenario = load_scenario(overrides=[f"mobility.source={source}", "coordination.step_seconds=10"])
    tracks = load_tracks(scenario)
    assert tracks.x.shape == (101, 200)
    for axis in (tracks.x, tracks.y):
        assert axis.min() >= 0
        assert axis.max() <= scenario.mobility.area
    moved = np.hypot(np.diff(tracks.x, axis=0), np.diff(tracks.y, axis=0))
    assert moved.max() <= scenario.mobility.speed[1] * 10 + 1e-6
    assert np.median(moved) >= scenario.mobility.speed[0] * 10 * 0.9
