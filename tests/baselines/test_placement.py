import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from skyrelay.baselines.placement import Placement, maximise
from skyrelay.baselines.player import play
from skyrelay.coordination import game
from skyrelay.learning.evaluation import starts


def test_the_swarm_finds_the_optimum_of_a_bowl(key):
    goal = jnp.array([[0.3, 0.8], [0.55, 0.1], [0.9, 0.9]])
    found = maximise(key, lambda x: -jnp.sum((x - goal) ** 2), jnp.zeros((3, 2)), 40, 200)
    np.testing.assert_allclose(found, goal, atol=1e-2)


def test_the_swarm_finds_the_highest_of_many_peaks(key):
    """Rastrigin's function: 10 peaks along each axis."""

    def rastrigin(x):
        z = (x - 0.37) * 10.0
        return -jnp.sum(z**2 - 10.0 * jnp.cos(2.0 * jnp.pi * z) + 10.0)

    found = maximise(key, rastrigin, jnp.zeros(2), 60, 200)
    np.testing.assert_allclose(found, [0.37, 0.37], atol=1e-2)


def test_an_optimum_on_the_border_is_reached(key):
    found = maximise(key, lambda x: x[0] - x[1], jnp.full(2, 0.5), 20, 60)
    np.testing.assert_allclose(found, [1.0, 0.0], atol=1e-6)


def test_the_first_point_stays_where_nothing_is_better(key):
    first = jnp.array([0.25, 0.75])
    np.testing.assert_array_equal(maximise(key, lambda _: jnp.float32(1.0), first, 10, 20), first)


def test_a_placement_is_worth_at_least_its_start_and_usually_all(key, shape, still):
    games = starts(key, 32, shape, still)
    placed, _ = jax.jit(jax.vmap(Placement(placed=True).begin))(jax.random.split(key, 32), games)
    before, after = map(jax.jit(jax.vmap(game.measure)), (games, placed))
    assert (np.asarray(after.reward) >= np.asarray(before.reward)).all()
    assert (np.asarray(after.reward) == 0.0).mean() > 0.9


def test_placed_holds_its_placement_while_vehicles_stand(key, shape, still):
    played = play(Placement(placed=True), key, 16, shape, still)
    assert (np.asarray(played.steps.reward) == np.asarray(played.start.reward)).all()


def test_flown_starts_where_it_was_and_arrives(key, shape, still):
    flown, placed = (play(Placement(placed=placed), key, 16, shape, still) for placed in (False, True))
    static_start = jax.jit(jax.vmap(game.measure))(starts(key, 16, shape, still))
    np.testing.assert_array_equal(flown.start.reward, static_start.reward)
    # Half a step beside its target a UAV may lose a vehicle at the edge of its range, seldom more.
    gap = np.asarray(placed.steps.reward[-1] - flown.steps.reward[-1])
    assert np.mean(np.abs(gap) < 1e-6) >= 0.5


def test_replanning_follows_the_vehicles(key, shape, moving):
    shape = dataclasses.replace(shape, steps=80)
    never, often = (play(Placement(period=period), key, 48, shape, moving) for period in (0, 5))
    assert float(often.steps.coverage[-20:].mean()) > float(never.steps.coverage[-20:].mean()) + 0.02
