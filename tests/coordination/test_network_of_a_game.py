"""What a game's vehicles have is what the run's network gives them in the same places."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.airspace import flight
from skyrelay.airspace.network import Network
from skyrelay.airspace.radio import air
from skyrelay.coordination import game
from skyrelay.coordination.service import serve
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.scenario import Gateway, Radio

SIDE = 2000.0
SHAPE = Shape(4, 30)
GATEWAYS = (
    Gateway(name="corner", x=300.0, y=300.0, capacity=8.0),
    Gateway(name="station", kind="base-station", x=1500.0, y=1200.0, height=30.0, capacity=20.0),
)


@pytest.mark.parametrize("model", ["disc", "air-to-ground", "tr36777"])
def test_a_game_and_a_run_have_the_same(model):
    law = air(Radio(model=model, channels=2, bandwidth=2.0), 100.0, seed=1)
    demand, available = np.linspace(500, 4000, 30), np.array([20_000.0, 9_000.0, 4_000.0, 0.0])
    states = [
        game.reset(key, SHAPE, physical((4, 4), (30, 30)).draw(key)) for key in jax.random.split(jax.random.key(3), 12)
    ]
    many = jax.tree.map(lambda *rows: jnp.stack(rows), *states)
    network = Network(gateways=GATEWAYS, air=law)
    together = jax.jit(jax.vmap(lambda state: serve(state, network, SIDE, jnp.asarray(demand), jnp.asarray(available))))
    carried, delivered = together(many)
    some = 0
    for state, got, out in zip(states, carried, delivered, strict=True):
        uavs, ground = SIDE * np.asarray(state.uavs, float), SIDE * np.asarray(state.traffic.position, float)
        owner, aloft, reach = np.asarray(state.served_by, int), np.asarray(state.flying), float(state.parameters.reach)
        run = Network(SIDE * reach, law, GATEWAYS)
        covered = flight.served(uavs / SIDE, ground / SIDE, owner, reach)
        expected = run.carried(demand, owner, covered, ground, uavs, aloft, available)
        np.testing.assert_allclose(got, expected, rtol=5e-3, atol=5.0)
        flow = run.delivered(expected, owner, uavs, aloft).sum()
        assert out >= flow * 0.995 - 10
        assert out <= expected.sum() * 1.005 + 10
        some += flow > 0
    assert some > 3


def test_without_gateways_all_that_is_carried_counts():
    key = jax.random.key(1)
    state = game.reset(key, SHAPE, physical((4, 4), (30, 30)).draw(key))
    carried, delivered = serve(state, Network(), SIDE, jnp.full(30, 1000.0), jnp.full(4, 1e6))
    assert float(delivered) == pytest.approx(float(carried.sum()))
    assert float(carried.sum()) == 30_000.0  # every vehicle starts in range
