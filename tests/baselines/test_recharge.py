"""The rule for games with energy."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from skyrelay.baselines.centroid import Centroid
from skyrelay.baselines.player import play
from skyrelay.baselines.recharge import ENOUGH, Recharge
from skyrelay.coordination import game
from skyrelay.coordination.energy import Batteries
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.errors import UsageError
from skyrelay.learning.evaluation import starts

SHAPE = Shape(3, 6, n=5, steps=60, energy=True)
DOMAIN = replace(physical((3, 3), (6, 6)), batteries=Batteries())


def test_it_turns_back_in_time_and_leaves_with_enough(key):
    state = jax.tree.map(lambda x: x[0], starts(key, 1, SHAPE, DOMAIN))
    player = Recharge()
    state, memory = player.begin(key, replace(state, charge=state.charge.at[0].set(0.25)))
    act, step = jax.jit(player.act), jax.jit(game.step)
    left_at = []
    for _ in range(SHAPE.steps):
        was = np.asarray(memory)
        actions, memory = act(state, memory)
        left_at += np.asarray(state.charge)[was & ~np.asarray(memory)].tolist()
        state, _ = step(state, actions)
        assert bool(state.flying.all())
    assert left_at
    assert min(left_at) >= ENOUGH


def test_it_is_worth_its_way(key):
    with_charging, without = (
        np.asarray(play(player, key, 16, SHAPE, DOMAIN).measures)[0].mean()
        for player in (Recharge(), Centroid(linked=True))
    )
    assert with_charging > without + 10


def test_without_batteries_it_says_so(key, shape, moving):
    with pytest.raises(UsageError, match="games with energy"):
        play(Recharge(), key, 1, shape, moving)
