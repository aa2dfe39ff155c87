import jax
import numpy as np
import pytest

from skyrelay.airspace.flight import unit_moves
from skyrelay.baselines.catalogue import BASELINES, baseline, evaluate_baseline
from skyrelay.baselines.player import Learned, Random, Static, choices, play, towards
from skyrelay.coordination import game
from skyrelay.core.errors import UsageError
from skyrelay.learning.evaluation import greedy_episodes, starts, unseen_key
from skyrelay.learning.networks import Architecture, actor


def test_a_network_plays_the_episodes_of_the_evaluation(key, shape, moving):
    network = actor(jax.random.key(1), Architecture(5, (), (), (), (8,)))
    ours = play(Learned(actor=network), key, 5, shape, moving).measures
    np.testing.assert_allclose(ours, greedy_episodes(network, key, 5, shape, moving), atol=1e-5)


def test_players_meet_the_same_starts_and_the_same_vehicles(key, shape, moving):
    """A team that stays sees the coverage that the same vehicles give it under whatever randomness players have."""
    static, random = (play(player, key, 5, shape, moving) for player in (Static(), Random()))
    np.testing.assert_array_equal(static.start.coverage, random.start.coverage)
    assert not np.array_equal(static.steps.coverage, random.steps.coverage)


def test_static_keeps_what_it_starts_with(key, shape, still):
    played = play(Static(), key, 8, shape, still)
    assert (np.asarray(played.steps.coverage) == 1.0).all()
    assert (np.asarray(played.steps.connectivity) == np.asarray(played.start.connectivity)).all()


def test_measures_are_those_of_the_steps(key, shape, moving):
    played = play(Static(), key, 4, shape, moving)
    total, coverage, connectivity, _ = np.asarray(played.measures)
    np.testing.assert_allclose(total, shape.steps * (coverage + connectivity - 2.0), atol=1e-3)


def test_first_counts_from_the_start_and_is_nan_where_nothing_comes(key, shape, moving):
    played = play(Static(), key, 3, shape, moving)
    holds = np.zeros((shape.steps + 1, 3), bool)
    holds[0, 0] = holds[4:, 1] = True
    np.testing.assert_array_equal(played.first(jax.numpy.asarray(holds)), [0.0, 4.0, np.nan])


def test_towards_takes_the_nearest_of_the_nine_places(key, shape, moving):
    state = jax.tree.map(lambda x: x[0], starts(key, 1, shape, moving))
    moved = np.asarray(jax.jit(choices)(state))
    step = float(state.parameters.uav_step)
    np.testing.assert_allclose(
        moved, np.clip(np.asarray(state.uavs) + step * np.asarray(unit_moves())[:, None], 0, 1), atol=1e-6
    )
    target = np.random.default_rng(0).random((3, 2))
    for uav, action in enumerate(np.asarray(jax.jit(towards)(state, target))):
        distances = np.linalg.norm(moved[:, uav] - target[uav], axis=-1)
        assert distances[action] == distances.min()
    assert (np.asarray(jax.jit(towards)(state, state.uavs)) == 0).all()


def test_an_unknown_baseline_is_named_with_the_closest():
    with pytest.raises(UsageError, match="centroid-linked"):
        baseline("centroid-link")


def test_evaluate_baseline_gives_intervals_and_the_same_for_the_same_seed(shape, moving):
    games = starts(unseen_key(3), 6, shape, moving)
    first, second = (evaluate_baseline("static", 3, games) for _ in range(2))
    assert first == second
    assert set(first) == {"return", "coverage", "connectivity", "connectivity_neighbor"}
    assert first["return"]["low"] < first["return"]["mean"] < first["return"]["high"]
    assert first["return"]["mean"] < 0.0


@pytest.mark.parametrize("name", ["random", "pso-10"])
def test_the_players_own_randomness_repeats(name, key, shape, moving):
    first, second = (np.asarray(play(BASELINES[name], key, 3, shape, moving).measures) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_game_with_empty_rows_is_played(key, shape, moving):
    """Mixed team sizes leave rows empty; the score counts the active ones only."""
    import dataclasses

    domain = dataclasses.replace(moving, uavs=(1, 3), vehicles=(1, 6))
    state = jax.tree.map(lambda x: x[0], starts(key, 1, shape, domain))
    assert isinstance(state, game.State)
    played = play(BASELINES["centroid-linked"], key, 6, shape, domain)
    assert np.isfinite(np.asarray(played.measures)).all()
