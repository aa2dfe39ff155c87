"""PPO's loss against plain loops, the symmetries against the game, and what collecting keeps."""

from __future__ import annotations

import dataclasses
import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.airspace.flight import unit_moves
from skyrelay.airspace.maps import normalise, outlook_maps
from skyrelay.airspace.observation import Scene
from skyrelay.coordination.observation import six_maps
from skyrelay.coordination.settings import physical
from skyrelay.learning import networks, ppo
from skyrelay.learning.networks import Architecture


@partial(jax.jit, static_argnums=(5, 6))
def look(uavs, active, vehicles, owner, reach, n, zoom):
    return six_maps(Scene(uavs, vehicles, owner, reach), active, n, zoom)


@pytest.fixture(scope="module")
def batch():
    random = np.random.default_rng(0)
    rows = 24
    return ppo.Experience(
        maps=jnp.asarray(random.integers(0, 3, (rows, 6, 5, 5)), jnp.uint8),
        action=jnp.asarray(random.integers(0, 9, rows)),
        log_probability=jnp.asarray(random.normal(-2.2, 0.4, rows), jnp.float32),
        value=jnp.asarray(random.normal(size=rows), jnp.float32),
        advantage=jnp.asarray(random.normal(size=rows), jnp.float32),
        active=jnp.asarray(random.random(rows) < 0.7),
    )


def test_loss_against_plain_loops(batch, tiny):
    config, zoom = tiny.hyperparameters, 2
    architecture = Architecture(n=5, channels=(), strides=(), pools=(), hidden=(8,))
    actor = networks.actor(jax.random.key(1), architecture)
    actor = eqx.tree_at(lambda net: net.layers[-1].weight, actor, actor.layers[-1].weight * 50)
    critic = networks.critic(jax.random.key(2), architecture)
    total, parts = ppo.loss((actor, critic), batch, config, zoom)

    maps = normalise(batch.maps, zoom)
    logits, values = np.asarray(actor(maps), np.float64), np.asarray(critic(maps), np.float64)[:, 0]
    rows = [row for row in range(len(values)) if batch.active[row]]
    advantages = [float(batch.advantage[row]) for row in rows]
    mean = sum(advantages) / len(rows)
    deviation = (sum((a - mean) ** 2 for a in advantages) / len(rows)) ** 0.5
    surrogate = error = entropy = 0.0
    for row, advantage in zip(rows, advantages, strict=True):
        odds = np.exp(logits[row] - logits[row].max())
        chances = odds / odds.sum()
        ratio = chances[int(batch.action[row])] / np.exp(float(batch.log_probability[row]))
        scaled = (advantage - mean) / (deviation + 1e-8)
        bounded = min(max(ratio, 1 - config.clip), 1 + config.clip)
        surrogate += min(ratio * scaled, bounded * scaled) / len(rows)
        error += 0.5 * (values[row] - float(batch.value[row]) - advantage) ** 2 / len(rows)
        entropy -= sum(p * np.log(p) for p in chances) / len(rows)
    assert float(parts["policy_loss"]) == pytest.approx(-surrogate, rel=1e-4)
    assert float(parts["value_loss"]) == pytest.approx(error, rel=1e-4)
    assert float(parts["entropy"]) == pytest.approx(entropy, rel=1e-4)
    assert float(total) == pytest.approx(-surrogate + config.value * error - config.entropy * entropy, rel=1e-4)
    assert 0 < float(parts["clipped"]) < 1


def turn(points, side):
    """A symmetry of the square about its centre, on positions."""
    mirror, turns = divmod(side, 4)
    points = (points - 0.5) * (-1, 1) if mirror else points - 0.5
    for _ in range(turns):
        points = np.stack([points[:, 1], -points[:, 0]], axis=1)
    return (points + 0.5).astype(np.float32)


@pytest.mark.parametrize("side", range(ppo.SYMMETRIES))
def test_turned_experience_is_what_a_turned_game_shows(side):
    random = np.random.default_rng(side)
    uavs, vehicles = random.uniform(0, 1, (2, 2)), random.uniform(0, 1, (8, 2))
    owner, active, n = jnp.asarray(random.integers(0, 2, 8)), jnp.ones(2, bool), 7

    def see(uavs, vehicles):
        return look(jnp.asarray(uavs), active, jnp.asarray(vehicles), owner, jnp.float32(0.37), n, 2)

    zeros = jnp.zeros(2)
    seen = ppo.Experience(see(uavs.astype(np.float32), vehicles.astype(np.float32)), jnp.array([3, 0]), *[zeros] * 4)
    turned = ppo.turned(seen, jnp.int32(side))
    np.testing.assert_array_equal(turned.maps, see(turn(uavs, side), turn(vehicles, side)))
    moves = unit_moves()
    expected = turn(moves[np.array([3, 0])] + 0.5, side) - 0.5
    np.testing.assert_allclose(moves[np.asarray(turned.action)], expected, atol=1e-6)


@pytest.mark.parametrize("side", range(ppo.SYMMETRIES))
def test_a_turned_outlook_is_what_a_turned_game_shows(side):
    random = np.random.default_rng(side)
    uavs, vehicles = random.uniform(0.2, 0.8, (3, 2)).astype(np.float32), random.uniform(0, 1, (9, 2))
    own = jnp.asarray(random.integers(0, 3, 9) == np.arange(3)[:, None])

    def see(uavs, vehicles):
        places, active = (jnp.asarray(x, jnp.float32) for x in (uavs, vehicles)), jnp.ones(3, bool)
        uavs, vehicles = places
        return jnp.stack(outlook_maps(uavs, active, own, vehicles, jnp.float32(0.2), jnp.float32(0.05), 7), axis=1)

    zeros = jnp.zeros(3)
    turned = ppo.turned(ppo.Experience(see(uavs, vehicles), jnp.zeros(3, int), *[zeros] * 4), jnp.int32(side))
    np.testing.assert_array_equal(turned.maps, see(turn(uavs, side), turn(vehicles, side)))
    assert 0 < np.asarray(turned.maps)[:, 0].sum() < 27


def test_a_guarded_team_loses_no_link_while_it_learns(tiny):
    """It explores, and yet: once linked, always linked."""
    shape = dataclasses.replace(tiny.shape, outlook=True, steps=100)
    actor = dataclasses.replace(tiny.hyperparameters.actor, maps=shape.maps)
    config = dataclasses.replace(tiny.hyperparameters, actor=actor, critic=actor, games=32, horizon=50)
    domain = physical((2, 2), (4, 4))
    learner = eqx.filter_jit(ppo.begin)(jax.random.key(0), config, shape, domain, 4)
    _, experience, score = eqx.filter_jit(lambda learner: ppo.collect(learner, config, domain))(learner)
    linked, clock = np.asarray(score.connectivity), np.asarray(learner.games.time) + np.arange(1, 51)[:, None]
    before = (linked == 1.0) & (clock != shape.steps)  # then another game begins
    assert 0.5 < before.mean() < 1.0
    assert (linked[1:][before[:-1]] == 1.0).all()
    assert len(np.unique(np.asarray(experience.action))) == 9


def test_collecting_goes_through_time_limits(tiny):
    config, domain = tiny.hyperparameters, tiny.domain
    learner = eqx.filter_jit(ppo.begin)(jax.random.key(0), config, tiny.shape, domain, tiny.updates)
    clocks = learner.games.time
    collect = eqx.filter_jit(lambda learner: ppo.collect(learner, config, domain))
    after, experience, score = collect(learner)
    np.testing.assert_array_equal(after.games.time, (clocks + config.horizon) % tiny.shape.steps)
    assert experience.maps.shape == (config.horizon, config.games, 2, 6, 5, 5)
    assert experience.maps.dtype == jnp.uint8
    assert score.reward.shape == (config.horizon, config.games)
    assert ((np.asarray(score.reward) >= -2) & (np.asarray(score.reward) <= 0)).all()
    np.testing.assert_array_equal(np.asarray(experience.maps)[~np.asarray(experience.active)], 0)
    for _ in range(5):
        after, _, _ = collect(after)
    assert (np.asarray(after.games.time) < tiny.shape.steps).all()


def test_a_link_margin_takes_links_near_the_edge_from_the_reward(tiny):
    def rewards(margin):
        # Without a discount the advantage is the reward less the value expected.
        config = dataclasses.replace(tiny.hyperparameters, gamma=0.0, shaping=0.0, link_margin=margin)
        learner = eqx.filter_jit(ppo.begin)(jax.random.key(0), config, tiny.shape, tiny.domain, tiny.updates)
        _, experience, score = eqx.filter_jit(lambda learner: ppo.collect(learner, config, tiny.domain))(learner)
        return np.asarray(experience.advantage + experience.value), experience, score

    plain, experience, score = rewards(0.0)
    some, _, _ = rewards(3.0)
    none, _, _ = rewards(1000.0)
    alone = np.asarray(experience.active).sum(-1) == 1
    connected = np.where(alone, 0.0, score.connectivity)[..., None]
    active = np.asarray(experience.active)
    np.testing.assert_allclose((plain - none)[active], np.broadcast_to(connected, plain.shape)[active], atol=1e-5)
    assert ((plain - some >= -1e-5) & (some - none >= -1e-5))[active].all()
    assert connected.any()


def test_even_credit_counts_the_share_of_the_own_vehicles_that_is_out_of_range(tiny):
    """After one step from the start of games the states that the rewards are of are still at hand."""
    config = dataclasses.replace(tiny.hyperparameters, gamma=0.0, shaping=0.0, even_credit=True, horizon=1, games=16)
    domain = dataclasses.replace(tiny.domain, astray=(0.5, 0.5))
    learner = eqx.filter_jit(ppo.begin)(jax.random.key(0), config, tiny.shape, domain, tiny.updates)
    learner = eqx.tree_at(lambda state: state.games.time, learner, jnp.zeros(config.games, jnp.int32))
    after, experience, score = eqx.filter_jit(lambda learner: ppo.collect(learner, config, domain))(learner)
    reward, games = np.asarray(experience.advantage + experience.value)[0], after.games
    shares = []
    for g in range(config.games):
        for i in np.flatnonzero(games.active[g]):
            own = [v for v in range(tiny.shape.vehicles) if games.served_by[g, v] == i]
            away = [math.dist(games.uavs[g, i], games.traffic.position[g, v]) for v in own]
            missed = sum(distance > float(games.parameters.reach[g]) for distance in away)
            shares.append(missed / max(len(own), 1))
            assert float(reward[g, i]) == pytest.approx(float(score.connectivity[0, g]) - 1.0 - shares[-1], abs=1e-5)
    assert len(set(shares)) > 3


@pytest.mark.parametrize(("pieces", "size"), [(2, 6), (4, 2), (3, 4)])
def test_rows_with_a_uav_are_dealt_evenly_and_before_any_other(pieces, size):
    random = np.random.default_rng(pieces)
    for filled in (12, pieces * size, 3):
        active = np.zeros(12, bool)
        active[random.permutation(12)[:filled]] = True
        dealt = np.asarray(ppo.dealt(jnp.asarray(random.permutation(12)), jnp.asarray(active), pieces, size))
        assert dealt.shape == (pieces, size)
        assert len(set(dealt.ravel().tolist())) == dealt.size
        full = active[dealt].sum(1)
        assert full.sum() == min(active.sum(), dealt.size)
        assert full.max() - full.min() <= 1


def test_advantages_by_agent_leave_what_the_critic_is_to_expect(tiny):
    random = np.random.default_rng(0)
    shape = (5, 4, 2)
    active = random.random(shape) < 0.7
    value, advantage = random.normal(size=(2, *shape)) * np.array([1.0, 7.0])
    maps, action = jnp.zeros((*shape, 6, 5, 5), jnp.uint8), jnp.zeros(shape, jnp.int32)
    chosen, wanted, gained = (jnp.asarray(array, jnp.float32) for array in (np.zeros(shape), value, advantage))
    before = ppo.Experience(maps, action, chosen, wanted, gained, jnp.asarray(active))
    after = ppo.normalised_by_agent(before)
    for agent in range(2):
        mine = active[..., agent]
        own = advantage[..., agent][mine]
        expected = (own - own.mean()) / own.std()
        np.testing.assert_allclose(after.advantage[..., agent][mine], expected, rtol=1e-4)
    np.testing.assert_allclose((after.advantage + after.value)[active], (value + advantage)[active], atol=1e-5)
    # They go into the loss as they are; else each minibatch has its own.
    flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[3:]), after)
    config = tiny.hyperparameters
    key = jax.random.key(0)
    nets = networks.actor(key, config.actor), networks.critic(key, config.actor)
    scaled = flat._replace(advantage=3.0 * flat.advantage)
    own, other = (
        [float(ppo.loss(nets, batch, one, 2)[1]["policy_loss"]) for batch in (flat, scaled)]
        for one in (dataclasses.replace(config, per_agent=True), config)
    )
    assert own[1] == pytest.approx(3.0 * own[0], rel=1e-4)
    assert other[1] == pytest.approx(other[0], rel=1e-4)


def test_where_the_time_limit_is_the_end_nothing_is_expected_after_it(tiny):
    def last_step(ends):
        config = dataclasses.replace(tiny.hyperparameters, horizon=1, shaping=0.0, time_limit_ends=ends, gamma=0.9)
        learner = ppo.begin(jax.random.key(0), config, tiny.shape, tiny.domain, tiny.updates)
        clocks = jnp.asarray([tiny.shape.steps - 1, 2, tiny.shape.steps - 1, 3], jnp.int32)
        learner = eqx.tree_at(lambda state: state.games.time, learner, clocks)
        _, experience, score = eqx.filter_jit(lambda learner: ppo.collect(learner, config, tiny.domain))(learner)
        return (experience.advantage + experience.value)[0], score.credit[0], experience.active[0]

    (gone, credit, active), (kept, _, _) = last_step(True), last_step(False)
    np.testing.assert_allclose(gone[0::2][active[0::2]], credit[0::2][active[0::2]], atol=1e-5)
    np.testing.assert_array_equal(gone[1::2], kept[1::2])
    assert (np.abs(gone[0::2] - kept[0::2])[active[0::2]] > 1e-4).any()


def test_a_critic_may_have_a_rate_of_its_own(tiny):
    config = dataclasses.replace(tiny.hyperparameters, learning_rate=1e-4, critic_rate=1e-2, anneal=False)
    weights = {"weight": jnp.ones(3)}, {"weight": jnp.ones(3)}
    adam = ppo.optimizer(config, 10)
    steps, _ = adam.update(weights, adam.init(weights), weights)
    np.testing.assert_allclose(steps[0]["weight"], -1e-4, rtol=1e-3)
    np.testing.assert_allclose(steps[1]["weight"], -1e-2, rtol=1e-3)
