"""The tests check the package's types while they run (conftest.py): here it is seen that they do."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

from skyrelay.coordination import dynamics, game
from skyrelay.coordination.settings import Shape, physical


def test_a_wrong_shape_or_kind_of_array_is_refused():
    assert dynamics.mirrored(jnp.zeros((3, 2))).shape == (3, 2)
    wrong: Any
    for wrong in (jnp.zeros((3, 3)), jnp.zeros(2), jnp.zeros((3, 2), int), np.zeros((3, 2), np.float32)):
        with pytest.raises(TypeCheckError, match="mirrored"):
            dynamics.mirrored(wrong)


def test_axes_of_one_name_are_of_one_length():
    halted, two = jnp.zeros(3, bool), jnp.float32(0.5)
    with pytest.raises(TypeCheckError, match="halting"):
        dynamics.halting(jnp.zeros(4), halted, two, two)


def test_the_fields_of_a_state_fit_each_other_also_of_many_games():
    shape = Shape(uavs=2, vehicles=3)
    draw = physical((2, 2), (3, 3)).draw
    one = game.reset(jax.random.key(0), shape, draw(jax.random.key(1)))
    many = jax.vmap(lambda key: game.reset(key, shape, draw(key)))(jax.random.split(jax.random.key(0), 5))
    for state in (one, many):
        assert dataclasses.replace(state, owner=state.owner).served_by.shape == state.owner.shape
        with pytest.raises(TypeCheckError, match="State"):
            dataclasses.replace(state, present=state.present[..., :2])
        with pytest.raises(TypeCheckError, match="State"):
            dataclasses.replace(state, uavs=state.uavs[..., :1])


def test_what_is_no_array_is_checked_too():
    wrong: Any = "3"
    with pytest.raises(TypeCheckError, match="Shape"):
        Shape(uavs=wrong, vehicles=3)
    with pytest.raises(TypeCheckError, match="physical"):
        physical((2, 2), (3, 3), zone_side=wrong)
    assert physical((2, 2), (3, 3), zone_side=1000) == physical((2, 2), (3, 3), zone_side=1000.0)  # whole is real, too


@pytest.mark.usefixtures("unchecked")
def test_a_test_may_do_without():
    numpys: Any = np.zeros((3, 3), np.float32)
    assert dynamics.mirrored(numpys).shape == (3, 3)


def test_nobody_else_pays_for_it():
    program = "import sys, skyrelay.coordination.dynamics; sys.exit('beartype' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)
