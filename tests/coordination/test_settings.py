"""What games are drawn with."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from skyrelay.coordination.settings import Domain, varied


@pytest.mark.parametrize("weighted", [False, True])
def test_team_sizes_come_up_as_often_as_they_should(weighted):
    domain = Domain((2, 5), (3, 4), weighted=weighted)
    draws = jax.jit(jax.vmap(domain.draw))(jax.random.split(jax.random.key(0), 20_000))
    share = np.bincount(draws.uavs, minlength=6)[2:] / 20_000
    np.testing.assert_allclose(share, domain.team_sizes, atol=0.015)
    assert np.mean(draws.uavs) == pytest.approx(domain.mean_uavs, abs=0.03)
    assert set(np.asarray(draws.vehicles).tolist()) == {3, 4}
    decisions = share * np.arange(2, 6)
    assert (decisions.max() < 1.1 * decisions.min()) == weighted


@pytest.mark.parametrize(("weighted", "wider"), [(False, 0.5), (True, 0.5625)])
def test_wide_zones_come_up_more_often_where_weighted(weighted, wider):
    """Of zones 1.5 to 2.5 ranges wide, how many are wider than 2."""
    domain = Domain((2, 2), (3, 3), ratio=(1.5, 2.5), weighted=weighted)
    ratio = 1.0 / np.asarray(jax.jit(jax.vmap(domain.draw))(jax.random.split(jax.random.key(0), 20_000)).reach)
    assert ratio.min() == pytest.approx(1.5, abs=0.01)
    assert ratio.max() == pytest.approx(2.5, abs=0.01)
    # Uniform in the ratio: half; uniform in area: (2.5^2 - 2^2) / (2.5^2 - 1.5^2).
    assert np.mean(ratio > 2.0) == pytest.approx(wider, abs=0.015)


def test_one_team_size_is_that_size():
    domain = replace(varied(), uavs=(3, 3))
    draws = jax.vmap(domain.draw)(jax.random.split(jax.random.key(0), 50))
    assert set(np.asarray(draws.uavs).tolist()) == {3}
    assert domain.mean_uavs == 3.0
