"""The network of an area: the radio of a whole fleet in pieces as in one, and gateways over several hops."""

from __future__ import annotations

import numpy as np
import pytest

from skyrelay.airspace import network as module
from skyrelay.airspace.network import Network
from skyrelay.airspace.radio import air
from skyrelay.core.scenario import Gateway, Radio

UAVS, VEHICLES = 12, 60


def crowd(seed=3):
    random = np.random.default_rng(seed)
    uavs, ground = random.uniform(0, 2000, (UAVS, 2)), random.uniform(0, 2000, (VEHICLES, 2))
    return random.uniform(500, 4000, VEHICLES), random.integers(-1, UAVS, VEHICLES), ground, uavs


def carried(network, demand, owner, ground, uavs, aloft=None, covered=None):
    aloft = np.ones(len(uavs), dtype=bool) if aloft is None else aloft
    covered = owner >= 0 if covered is None else covered
    return network.carried(demand, owner, covered, ground, uavs, aloft, np.full(len(uavs), 15_000.0))


@pytest.mark.parametrize("model", ["air-to-ground", "tr36777"])
@pytest.mark.parametrize("channels", [1, 3, 50])
def test_pieces_and_channels_apart_are_the_law_of_all_at_once(monkeypatch, model, channels):
    _, owner, ground, uavs = crowd()
    radio = Radio(model=model, channels=channels, shadowing=4.0)
    law = air(radio, 100.0, seed=1)
    assert law is not None
    monkeypatch.setattr(module, "AT_ONCE", 40)
    found = Network(900.0, law)._efficiency(law, ground[owner >= 0], owner[owner >= 0], uavs, np.ones(UAVS, bool))
    sending = np.isin(np.arange(UAVS), owner)
    whole = law.efficiency(uavs, ground, owner, np.arange(UAVS) % channels, sending=sending)
    np.testing.assert_allclose(found, whole[owner >= 0], rtol=1e-9)


def test_fewer_on_a_channel_carry_more_and_a_landed_uav_nothing():
    demand, owner, ground, uavs = crowd()
    laws = [air(Radio(model="air-to-ground", channels=channels), 100.0, 1) for channels in (1, UAVS)]
    one, many = (carried(Network(900.0, law), demand, owner, ground, uavs) for law in laws)
    assert one.sum() < many.sum() <= demand.sum()
    assert ((one >= 0) & (one <= demand)).all()
    aloft = np.arange(UAVS) != owner[owner >= 0][0]
    law = Network(900.0, air(Radio(model="air-to-ground"), 100.0, 1))
    assert carried(law, demand, owner, ground, uavs, aloft)[owner == owner[owner >= 0][0]].sum() == 0
    ground[owner >= 0] = np.nan
    assert carried(law, demand, owner, ground, uavs).sum() == 0


def test_a_wall_takes_what_the_open_ground_gives():
    uavs, ground, owner = np.array([[0.0, 0.0]]), np.array([[400.0, 0.0]]), np.array([0])
    wall = np.array([[395.0, -50.0, 395.0, 50.0, 0.9]])
    law = air(Radio(model="air-to-ground", bandwidth=1.0, power=0.0), 100.0, 1)
    open_ground, behind = (Network(900.0, law, walls=walls) for walls in (None, wall))
    demand = np.array([1e6])
    assert carried(behind, demand, owner, ground, uavs) < carried(open_ground, demand, owner, ground, uavs)


GATEWAY = Gateway(name="station", x=2000.0, y=0.0, height=30.0, capacity=5.0)


@pytest.mark.parametrize("law", [None, air(Radio(model="air-to-ground"), 100.0, 1)])
def test_traffic_goes_over_as_many_uavs_as_it_takes(law):
    chain = np.array([[0.0, 0.0], [900.0, 0.0], [1800.0, 0.0]])
    network = Network(1000.0, law, (GATEWAY,))
    got, owner = np.array([1000.0, 2000.0, 300.0]), np.array([0, 2, -1])
    aloft = np.ones(3, dtype=bool)
    np.testing.assert_allclose(network.delivered(got, owner, chain, aloft), [1000, 2000, 0])
    # Without the one in the middle the first is linked to no gateway; what it carries stays where it is.
    np.testing.assert_allclose(network.delivered(got, owner, chain, aloft & [True, False, True]), [0, 2000, 0])
    # More than the gateway takes: 5 Mbit/s in all.
    assert network.delivered(got * 4, owner, chain, aloft).sum() == pytest.approx(5000)
    assert network.delivered(got, owner, chain, ~aloft).sum() == 0
    assert Network(1000.0, law).delivered(got, owner, chain, aloft) is got
