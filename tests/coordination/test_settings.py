"""What games are drawn with."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from skyrelay.coordination.settings import Domain, varied


@pytest.mark.parametrize("even", [False, True])
def test_team_sizes_come_up_as_often_as_they_should(even):
    domain = Domain((2, 5), (3, 4), even=even)
    draws = jax.jit(jax.vmap(domain.draw))(jax.random.split(jax.random.key(0), 20_000))
    share = np.bincount(draws.uavs, minlength=6)[2:] / 20_000
    np.testing.assert_allclose(share, domain.team_sizes, atol=0.015)
    assert np.mean(draws.uavs) == pytest.approx(domain.mean_uavs, abs=0.03)
    assert set(np.asarray(draws.vehicles).tolist()) == {3, 4}
    decisions = share * np.arange(2, 6)
    assert (decisions.max() < 1.1 * decisions.min()) == even


def test_one_team_size_is_that_size():
    domain = replace(varied(), uavs=(3, 3))
    draws = jax.vmap(domain.draw)(jax.random.split(jax.random.key(0), 50))
    assert set(np.asarray(draws.uavs).tolist()) == {3}
    assert domain.mean_uavs == 3.0
