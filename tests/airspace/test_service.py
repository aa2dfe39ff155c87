"""What is carried and delivered: by hand, against every cut of the network, and in JAX as in NumPy."""

from __future__ import annotations

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrelay.airspace import service

ROOMY = np.array([1e9, 1e9])


def carried(demand, owner, efficiency, spectrum=1e6, available=ROOMY):
    arrays = (np.array(demand, dtype=float), np.array(owner), np.array(efficiency, dtype=float))
    return service.carried(*arrays, spectrum, np.asarray(available, dtype=float))


def test_the_disc_carries_the_demand_of_who_is_in_range():
    demand, covered = np.array([1000.0, 2000.0, 3000.0]), np.array([True, False, True])
    owner = np.array([0, 0, 1])
    np.testing.assert_array_equal(service.in_disc(demand, owner, covered, ROOMY), [1000, 0, 3000])


def test_the_disc_shares_the_bandwidth_of_a_uav_that_promised_more_than_it_has():
    demand, covered = np.array([1000.0, 3000.0, 500.0]), np.array([True, True, True])
    found = service.in_disc(demand, np.array([0, 0, 1]), covered, np.array([1000.0, 0.0]))
    np.testing.assert_allclose(found, [250, 750, 0])
    compiled = service.in_disc(*map(jnp.asarray, (demand, np.array([0, 0, 1]), covered, np.array([1000.0, 0.0]))))
    np.testing.assert_allclose(compiled, found)


def test_a_radio_that_is_wide_enough_carries_all():
    # 1 MHz at 4 bit/s/Hz holds 4 Mbit/s: parts of 0.25 and 0.75
    np.testing.assert_allclose(carried([1000, 3000], [0, 0], [4, 4]), [1000, 3000])


def test_vehicles_of_a_crowded_radio_get_the_same_share():
    # parts of 0.5 and of 1.5 of the spectrum: half of each
    np.testing.assert_allclose(carried([1000, 3000, 700], [0, 0, 1], [2, 2, 2]), [500, 1500, 700])


def test_a_dead_link_takes_up_nothing_and_nobody_s_vehicle_gets_nothing():
    np.testing.assert_allclose(carried([1000, 9000, 500], [0, 0, -1], [1, 0, 6]), [1000, 0, 0])


def test_a_uav_gives_no_more_than_its_bandwidth():
    np.testing.assert_allclose(carried([1000, 3000], [0, 0], [9, 9], available=[1000, 0]), [250, 750])
    np.testing.assert_allclose(carried([1000, 3000], [1, 1], [9, 9], available=[1000, 0]), [0, 0])
    np.testing.assert_allclose(carried([0, 0], [1, 1], [9, 9], available=[1000, 0]), [0, 0])


@given(seed=st.integers(0, 2**32 - 1), vehicles=st.integers(0, 12))
@settings(max_examples=60, deadline=None)
def test_nothing_is_carried_that_is_not_there(seed, vehicles):
    random = np.random.default_rng(seed)
    demand, owner = random.uniform(0, 4000, vehicles), random.integers(-1, 3, vehicles)
    efficiency, available = random.choice([0.0, 0.1, 2.0, 7.4], vehicles), random.uniform(0, 9000, 3)
    found = carried(demand, owner, efficiency, 2e6, available)
    assert ((found >= 0) & (found <= demand * (1 + 1e-12))).all()
    brought = service.of_uavs(found, owner, 3)
    assert brought.sum() == pytest.approx(found.sum())
    assert (brought <= available * (1 + 1e-9)).all()
    on_air = found[efficiency > 0] * 1000 / efficiency[efficiency > 0]
    assert (service.of_uavs(on_air, owner[efficiency > 0], 3) <= 2e6 * (1 + 1e-9)).all()


def test_traffic_takes_several_hops_and_the_narrowest_counts():
    links = np.array([[0, 800, 0], [800, 0, 500], [0, 500, 0]], dtype=float)
    gateways = np.array([[0], [0], [2000]], dtype=float)
    found = service.delivered(np.array([700.0, 0.0, 1000.0]), links, gateways, np.array([1e9]))
    np.testing.assert_array_equal(found, [500, 0, 1000])


def test_traffic_is_split_over_two_ways():
    links = np.array([[0, 300, 400], [0, 0, 0], [0, 0, 0]], dtype=float)
    gateways = np.array([[0, 0], [1000, 0], [0, 1000]], dtype=float)
    np.testing.assert_array_equal(service.delivered(np.array([900.0, 0, 0]), links, gateways, ROOMY), [700, 0, 0])


def test_a_team_without_a_gateway_delivers_nothing():
    links = np.zeros((4, 4))
    links[0, 1] = links[1, 0] = links[2, 3] = links[3, 2] = 1e9
    gateways = np.array([[0.0], [0.0], [1e9], [0.0]])
    brought = np.array([100.0, 200.0, 300.0, 400.0])
    np.testing.assert_array_equal(service.delivered(brought, links, gateways, np.array([1e9])), [0, 0, 300, 400])
    assert service.delivered_bound(brought, links, gateways, np.array([1e9])) == 700
    # The gateway's own way on is the narrowest.
    assert service.delivered(brought, links, gateways, np.array([500.0])).sum() == 500
    assert service.delivered_bound(brought, links, gateways, np.array([500.0])) == 500
    assert service.delivered(brought, links, np.zeros((4, 0)), np.zeros(0)).sum() == 0
    assert service.delivered_bound(brought, links, np.zeros((4, 0)), np.zeros(0)) == 0


def test_nobody_delivers_nothing():
    assert service.delivered(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 2)), ROOMY).shape == (0,)


@pytest.mark.parametrize("wrong", [-1.0, np.nan])
def test_a_capacity_is_a_number(wrong):
    with pytest.raises(ValueError, match="links: capacities of 0"):
        service.delivered(np.ones(2), np.full((2, 2), wrong), np.ones((2, 1)), np.ones(1))
    with pytest.raises(ValueError, match="at most 2147483647"):
        service.delivered(np.full(2, 2e9), np.zeros((2, 2)), np.ones((2, 1)), np.ones(1))


def network(seed, uavs):
    random = np.random.default_rng(seed)
    links = random.integers(0, 900, (uavs, uavs)) * (random.random((uavs, uavs)) < 0.5)
    gateways = random.integers(0, 2000, (uavs, 2)) * (random.random((uavs, 2)) < 0.3)
    brought, capacity = random.integers(0, 1000, uavs), random.integers(0, 2500, 2)
    return tuple(part.astype(float) for part in (brought, links, gateways, capacity))


def least_cut(brought, links, gateways, capacity):
    """Over every set of UAVs on the source's side: what enters the others, what leaves the set."""
    cuts = []
    for side in product([False, True], repeat=len(brought)):
        inside = np.array(side)
        out = np.minimum(gateways[inside].sum(axis=0), capacity)  # a gateway is on the side where less is cut
        crossing = links[inside][:, ~inside].sum() + out.sum()
        cuts.append(brought[~inside].sum() + crossing)
    return min(cuts)


@given(seed=st.integers(0, 2**32 - 1), uavs=st.integers(1, 6))
@settings(max_examples=80, deadline=None)
def test_the_flow_is_the_least_cut_and_the_bound_is_no_less(seed, uavs):
    brought, links, gateways, capacity = network(seed, uavs)
    found = service.delivered(brought, links, gateways, capacity)
    assert ((found >= 0) & (found <= brought)).all()
    assert found.sum() == least_cut(brought, links, gateways, capacity)
    assert found.sum() <= service.delivered_bound(brought, links, gateways, capacity)
    # With links both ways that hold everything, the bound is exact.
    joined = (links > 0) | (links > 0).T
    wide = np.where(joined, 1e6, 0.0)
    roomy = gateways.sum(axis=0)
    exact = service.delivered(brought, wide, gateways, roomy).sum()
    assert service.delivered_bound(brought, wide, gateways, roomy) == exact


def test_a_uav_s_vehicles_share_what_it_delivers():
    found = service.reached_by(np.array([500.0, 0.0]), np.array([600.0, 400.0, 100.0, 0.0]), np.array([0, 0, 1, -1]))
    np.testing.assert_allclose(found, [300, 200, 0, 0])


def test_batches_in_jax_are_the_same_as_one_by_one():
    random = np.random.default_rng(5)
    demand, owner = random.uniform(0, 4000, (8, 9)), random.integers(-1, 4, (8, 9))
    efficiency, available = random.choice([0.0, 0.5, 4.0], (8, 9)), random.uniform(0, 9000, (8, 4))
    many = jax.jit(service.carried, static_argnums=3)(
        *map(jnp.asarray, (demand, owner, efficiency)), 1e6, jnp.asarray(available)
    )
    one = [carried(*row[:3], 1e6, row[3]) for row in zip(demand, owner, efficiency, available, strict=True)]
    np.testing.assert_allclose(many, one, rtol=1e-5)

    networks = [network(seed, 5) for seed in range(8)]
    bounds = jax.jit(service.delivered_bound)(*(jnp.asarray(np.stack(part)) for part in zip(*networks, strict=True)))
    np.testing.assert_allclose(bounds, [service.delivered_bound(*each) for each in networks], rtol=1e-6)
