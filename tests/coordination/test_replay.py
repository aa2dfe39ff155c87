"""Games cut out of a trace: real places, real moments, and the same for the same key."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.coordination import game
from skyrelay.coordination.replay import Setting, replayed_games
from skyrelay.coordination.settings import Shape
from skyrelay.core.errors import UsageError
from skyrelay.mobility.trace import Trace

SHAPE = Shape(uavs=3, vehicles=6, n=5, steps=8)


def driving(count: int, seconds: int, speed: float = 7.0) -> Trace:
    """Vehicles that drive east, each on its own street of a 1 km square, sampled every 2 s."""
    time = np.arange(0.0, seconds + 1, 2.0)
    vehicle = np.repeat(np.arange(count), len(time))
    times = np.tile(time, count)
    y = np.linspace(0.0, 1000.0, count)[vehicle]
    x = (vehicle * 131.0) % 400.0 + speed * times
    return Trace(tuple(f"v{i}" for i in range(count)), vehicle, times, x, y, "")


def test_every_game_follows_vehicles_of_the_trace():
    setting = Setting((2, 3), (2, 6), zone_side=500.0, step_seconds=1.0)
    games, traces = replayed_games(jax.random.key(3), driving(30, 60), 5, SHAPE, setting)
    present, position = np.asarray(traces.present), np.asarray(traces.position)
    assert position.shape == (5, SHAPE.steps + 1, SHAPE.vehicles, 2)
    assert (present[:, 0].sum(1) >= 1).all()
    assert ((position >= 0) & (position <= 1))[present].all()
    steps = np.diff(position, axis=1)[present[:, 1:] & present[:, :-1]]
    # In zone sides: 7 m a step to the east, on straight streets.
    np.testing.assert_allclose(steps, np.broadcast_to([7.0 / 500.0, 0.0], steps.shape), atol=1e-5)
    assert set(np.asarray(games.parameters.uavs).tolist()) <= {2, 3}
    np.testing.assert_allclose(games.parameters.reach, 0.5)
    np.testing.assert_allclose(games.parameters.uav_step, 30.0 / 500.0)
    np.testing.assert_array_equal(games.traffic.position, position[:, 0])


def test_a_vehicle_that_leaves_the_square_counts_no_more():
    setting = Setting((2, 2), (6, 6), zone_side=120.0, step_seconds=4.0)
    games, traces = replayed_games(jax.random.key(4), driving(30, 60), 8, SHAPE, setting)
    present = np.asarray(traces.present)
    gone = present[:, 0] & ~present[:, -1]
    assert gone.any()
    stay = jnp.zeros((8, SHAPE.uavs), jnp.int32)
    for _ in range(SHAPE.steps):
        games, transition = jax.vmap(game.step)(games, stay, traces)
    served_by = np.asarray(games.served_by)
    assert (served_by[gone] == -1).all()
    assert np.isfinite(transition.score.reward).all()


def test_the_same_key_gives_the_same_games():
    setting = Setting((3, 3), (4, 4), zone_side=400.0)
    first, second, other = (
        replayed_games(jax.random.key(seed), driving(20, 60), 2, SHAPE, setting) for seed in (1, 1, 2)
    )
    equal = jax.tree.map(
        lambda a, b: (
            bool((jax.random.key_data(a) == jax.random.key_data(b)).all())
            if jax.dtypes.issubdtype(a.dtype, jax.dtypes.prng_key)
            else bool((a == b).all())
        ),
        first,
        second,
    )
    assert all(jax.tree.leaves(equal))
    assert not (first[1].position == other[1].position).all()


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        (Setting((2, 2), (2, 2), step_seconds=60.0), "trace: is '60 s long'; expected 480 s"),
        (Setting((2, 2), (2, 2), zone_side=5000.0), "zone side: is 5000"),
    ],
)
def test_what_does_not_fit_the_trace_is_refused(setting, message):
    with pytest.raises(UsageError, match=message):
        replayed_games(jax.random.key(0), driving(5, 60), 1, SHAPE, setting)
