"""The rules of a game, step by step: who leaves, who takes over."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.coordination import game
from skyrelay.coordination.settings import Domain, Shape, physical

GAMES, STEPS = 32, 30


def states(shape: Shape, domain: Domain, steps: int = STEPS) -> game.State:
    """Every state, the first included, of games that random actions play: leaves [steps + 1, games, ...]."""

    def play(games, key):
        actions = jax.random.randint(key, (GAMES, shape.uavs), 0, 9)
        games = jax.vmap(game.step)(games, actions)[0]
        return games, games

    @jax.jit
    def whole(key):
        new = jax.vmap(lambda k: game.reset(k, shape, domain.draw(k)))(jax.random.split(key, GAMES))
        _, rest = jax.lax.scan(play, new, jax.random.split(key, steps))
        return jax.tree.map(lambda first, later: jnp.concatenate([first[None], later]), new, rest)

    played = whole(jax.random.key(0))
    keyless = eqx.tree_at(lambda state: state.key, played, jax.random.key_data(played.key))  # NumPy has no keys
    return jax.tree.map(np.asarray, keyless)


@pytest.fixture(scope="module")
def dwindling() -> game.State:
    domain = replace(physical((1, 4), (9, 9)), drop_out=(0.05, 0.05), swap=(0.1, 0.1))
    return states(Shape(4, 9, n=5, mobility="mixed", drop_outs=True), domain)


def test_a_uav_leaves_at_its_rate_and_for_good_but_never_the_last(dwindling):
    active = dwindling.active
    assert (active[1:] <= active[:-1]).all()
    assert active.any(-1).all()
    could = active[:-1] & (active[:-1].sum(-1, keepdims=True) > 1)
    rate = (could & ~active[1:]).sum() / could.sum()
    assert rate == pytest.approx(0.05, abs=0.015)


def test_the_vehicles_of_a_uav_that_left_have_another_in_range_or_the_nearest(dwindling):
    active, owner = dwindling.active, dwindling.owner
    assert np.take_along_axis(active, owner, -1).all()
    before, after = owner[:-1], owner[1:]
    orphaned = ~np.take_along_axis(active[1:], before, -1)
    assert orphaned.any()
    apart = np.linalg.norm(dwindling.traffic.position[:, :, :, None] - dwindling.uavs[:, :, None], axis=-1)
    apart = np.where(active[:, :, None], apart, np.inf)[1:]
    chosen = np.take_along_axis(apart, after[..., None], -1)[..., 0]
    reach = dwindling.parameters.reach[1:, :, None]
    assert ((chosen <= reach) | (chosen <= apart.min(-1) + 1e-6))[orphaned].all()
    assert (chosen > apart.min(-1) + 1e-6)[orphaned].any()  # not always the nearest: any in range


def test_without_drop_outs_nobody_leaves():
    shape, domain = Shape(3, 5, n=5), replace(physical((3, 3), (5, 5)), drop_out=(0.5, 0.5))
    played = states(shape, domain, steps=5)
    assert played.active.all()
    assert (played.owner == played.owner[0]).all()


@pytest.mark.parametrize(
    ("apart", "margin", "expected"), [(0.45, 0.0, 1), (0.45, 0.9, 1), (0.45, 1.1, 0), (0.55, 0.0, 0)]
)
def test_a_margin_shortens_the_links(apart, margin, expected):
    shape, domain = Shape(2, 1, n=5), physical((2, 2), (1, 1))
    state = game.reset(jax.random.key(0), shape, domain.draw(jax.random.key(1)))
    state = replace(state, uavs=jnp.array([[0.1, 0.5], [0.1 + apart, 0.5]]))
    assert game.linked(state, margin).tolist() == [expected] * 2
