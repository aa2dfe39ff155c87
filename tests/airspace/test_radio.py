"""The laws of the radio link against values worked by hand from their sources, and in JAX as in NumPy."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.airspace import radio
from skyrelay.core.scenario import Radio

GHZ = 1e9
AIR = radio.air(Radio(model="tr36777"), 100.0, seed=1)


@pytest.mark.parametrize(
    ("distance", "frequency", "loss"),
    # 20 log10(d) + 20 log10(f) - 147.552: the textbook's form
    [(1000.0, 2 * GHZ, 98.468), (100.0, 2.4 * GHZ, 80.052), (1.0, 1 * GHZ, 32.448)],
)
def test_free_space_loses_what_the_textbook_says(distance, frequency, loss):
    assert radio.free_space_loss(np.asarray(distance), frequency) == pytest.approx(loss, abs=1e-3)


def test_a_link_of_no_length_gains_nothing():
    assert radio.free_space_loss(np.asarray(0.0), GHZ) == 0.0


@pytest.mark.parametrize(
    ("environment", "probability"),
    # 1 / (1 + a exp(-b (45 - a))): a times 3.287e-8, 3.474e-3, 2.6751e-2 and 0.24133
    [("suburban", 1.0), ("urban", 0.96769), ("dense-urban", 0.75577), ("high-rise", 0.13208)],
)
def test_sight_at_45_degrees(environment, probability):
    seen = radio.sight_probability(np.asarray(100.0), 100.0, radio.ENVIRONMENTS[environment])
    assert seen == pytest.approx(probability, abs=1e-5)


@pytest.mark.parametrize(
    ("environment", "angle"), [("suburban", 20.34), ("urban", 42.44), ("dense-urban", 54.62), ("high-rise", 75.52)]
)
def test_the_best_angle_is_the_paper_s(environment, angle):
    """Al-Hourani et al. give the elevation at which a given loss reaches furthest, for each environment."""
    angles = np.radians(np.arange(5.0, 89.0, 0.01))
    # Where the loss at a given radius is least, the radius of a given loss is largest.
    losses = [
        radio.air_to_ground_loss(np.asarray([1000.0]), 1000.0 * np.tan(t), 2 * GHZ, radio.ENVIRONMENTS[environment])
        for t in angles
    ]
    assert np.degrees(angles[np.argmin(losses)]) == pytest.approx(angle, abs=0.1)


def test_the_mean_loss_lies_between_sight_and_none():
    urban = radio.ENVIRONMENTS["urban"]
    # 100 m up, 100 m across: free space over 141.42 m at 2 GHz is 81.479 dB; 1 x 0.967688 + 20 x 0.032312 dB more
    loss = radio.air_to_ground_loss(np.asarray(100.0), 100.0, 2 * GHZ, urban)
    assert loss == pytest.approx(81.479 + 1.61392, abs=2e-3)


@pytest.mark.parametrize(
    ("cell", "altitude", "across", "probability"),
    [
        # UMa-AV at 50 m: p1 = 4300 x 1.69897 - 3800 = 3505.57, d1 = max(460 x 1.69897 - 700, 18) = 81.526
        ("UMa-AV", 50.0, 80.0, 1.0),
        ("UMa-AV", 50.0, 1000.0, 0.081526 + np.exp(-1000 / 3505.571) * 0.918474),
        ("UMa-AV", 150.0, 3000.0, 1.0),
        # UMi-AV at 100 m: p1 = 467.01, d1 = 155.16
        ("UMi-AV", 100.0, 155.0, 1.0),
        ("UMi-AV", 100.0, 500.0, 0.31032 + np.exp(-500 / 467.01) * 0.68968),
    ],
)
def test_sight_by_the_table_of_tr_36777(cell, altitude, across, probability):
    assert radio.tr36777_sight_probability(np.asarray(across), altitude, cell) == pytest.approx(probability, abs=1e-5)


def test_path_loss_by_the_table_of_tr_36777():
    # 300 m across and 400 m up from the vehicle's antenna would be 500 m; at 100 m: across such that d3D = 1000 m.
    across = np.asarray(np.sqrt(1000.0**2 - 98.5**2))
    sight, hidden = radio.tr36777_losses(across, 100.0, 2 * GHZ, "UMa-AV")
    assert sight == pytest.approx(28 + 66 + 6.0206, abs=1e-3)
    assert hidden == pytest.approx(-17.5 + 32 * 3 + 20 * np.log10(40 * np.pi * 2 / 3), abs=1e-3)  # 116.96
    sight, hidden = radio.tr36777_losses(across, 100.0, 2 * GHZ, "UMi-AV")
    assert sight == pytest.approx(30.9 + 21.25 * 3 + 6.0206, abs=1e-3)
    assert hidden == pytest.approx(32.4 + 28.0 * 3 + 6.0206, abs=1e-3)
    assert radio.tr36777_shadowing(100.0, "UMa-AV") == (pytest.approx(4.64 * np.exp(-0.66)), 6.0)
    assert radio.tr36777_shadowing(100.0, "UMi-AV") == (2.0, 8.0)


@pytest.mark.parametrize("altitude", [22.5, 300.1])
def test_the_tables_end_somewhere(altitude):
    with pytest.raises(ValueError, match=r"above 22\.5 m and up to 300 m"):
        radio.tr36777_loss(np.asarray(100.0), altitude, 2 * GHZ, "UMa-AV")


def test_shadowing_has_its_deviation_and_correlates_by_the_way_of_both_ends():
    random = np.random.default_rng(1)
    here = random.uniform(0, 20_000, (400, 2))
    drawn: list[list[Any]] = [[], [], []]
    for seed in range(40):
        field = radio.Shadowing.drawn(seed, 50.0)
        uav, gone = np.array([[500.0, 300.0]]), np.array([[500.0, 325.0]])
        drawn[0].append(field.between(uav, here)[0])
        drawn[1].append(field.between(uav, here + np.array([50.0, 0.0]))[0])
        drawn[2].append(field.between(gone, here + np.array([15.0, 20.0]))[0])
    first, moved, both = (np.concatenate(values) for values in drawn)
    assert first.mean() == pytest.approx(0.0, abs=0.05)
    assert first.std() == pytest.approx(1.0, rel=0.05)
    # 50 m by one end, or 25 m by each: one correlation distance
    assert np.corrcoef(first, moved)[0, 1] == pytest.approx(np.exp(-1.0), abs=0.06)
    assert np.corrcoef(first, both)[0, 1] == pytest.approx(np.exp(-1.0), abs=0.06)


def test_noise_of_ten_megahertz():
    assert radio.noise(10e6, 7.0) == pytest.approx(-97.0)


def test_only_uavs_on_the_same_channel_that_send_disturb():
    received = np.array([[-90.0], [-93.0], [-93.0], [-50.0]])
    owner, floor = np.array([0]), -93.0
    channel, sending = np.array([1, 1, 2, 1]), np.array([True, True, True, False])
    # 10^-9 over (two of 10^-9.3): noise and the one on its channel
    assert radio.sinr(received, owner, channel, sending, floor)[0] == pytest.approx(10**0.3 / 2)
    assert radio.sinr(received, owner, np.arange(4), sending, floor)[0] == pytest.approx(10**0.3)
    assert radio.sinr(received, np.array([-1]), channel, sending, floor)[0] == 0.0
    assert radio.sinr(received, np.array([3]), channel, sending, floor)[0] == 0.0


def test_rate_follows_shannon_up_to_the_cap():
    ratios = np.array([0.0, 0.1, 3.0, 1e9])
    efficiency = radio.spectral_efficiency(ratios, cap=5.55, least=0.2)
    np.testing.assert_allclose(efficiency, [0.0, 0.0, 2.0, 5.55])


def test_links_between_uavs_fall_with_distance():
    rate = radio.link_capacity(np.array([1000.0, 8000.0]), 20.0, 5 * GHZ, 20e6, -94.0, 20.0)
    # 1 km at 5 GHz: 106.43 dB; an SNR of 7.57 dB = 5.716: log2(6.716) = 2.7476 bit/s/Hz
    assert rate[0] == pytest.approx(2.7476 * 20_000, rel=1e-3)
    assert 0 < rate[1] < rate[0]


def law(**keys):
    return radio.air(Radio(**({"model": "air-to-ground", "antenna": 0.0} | keys)), 100.0, seed=1)


def test_a_vehicle_beneath_its_uav_has_what_the_budget_says():
    # Urban, straight up: sight for certain. 100 m at 2 GHz: 78.468 + 1 dB; 10 - 79.468 dBm against -97 dBm of noise.
    ratio = 10 ** ((10.0 - 79.468 + 97.0) / 10)
    found = law(power=10.0, efficiency=99).efficiency(np.zeros((1, 2)), np.zeros((1, 2)), np.array([0]), np.zeros(1))
    assert found[0] == pytest.approx(np.log2(1 + ratio), rel=1e-3)
    capped = law(power=10.0).efficiency(np.zeros((1, 2)), np.zeros((1, 2)), np.array([0]), np.zeros(1))
    assert capped[0] == 7.4
    assert law(least_sinr=50.0).efficiency(np.zeros((1, 2)), np.full((1, 2), 4e3), np.array([0]), np.zeros(1))[0] == 0


@pytest.mark.parametrize("model", ["air-to-ground", "tr36777"])
def test_a_uav_on_the_same_channel_disturbs_and_a_wall_hides(model):
    uavs, vehicle, own = np.array([[0.0, 0.0], [400.0, 0.0]]), np.array([[200.0, 90.0]]), np.array([0])
    air = law(model=model, shadowing=0.0, power=20.0, efficiency=99)
    alone = air.efficiency(uavs, vehicle, own, np.array([0, 1]))
    beside = air.efficiency(uavs, vehicle, own, np.array([0, 0]))
    assert beside[0] == pytest.approx(
        1.0, abs=1e-2
    )  # as far away as one's own: a ratio of 1, a hair below it for noise
    assert alone[0] > 2.0
    seen, hidden = (air.efficiency(uavs, vehicle, own, np.array([0, 1]), np.array([there])) for there in (True, False))
    assert hidden < alone <= seen


def test_shadowing_is_left_out_where_the_model_has_none_and_by_the_report_where_it_has():
    assert law().field is None
    assert law(shadowing=3.0).deviations() == (3.0, 3.0)
    assert law(model="tr36777").deviations() == radio.tr36777_shadowing(100.0, "UMa-AV")
    uavs, vehicles = np.zeros((1, 2)), np.random.default_rng(2).uniform(0, 5000, (3000, 2))
    spread = law(shadowing=8.0).received(uavs, vehicles) - law().received(uavs, vehicles)
    assert spread.std() == pytest.approx(8.0, rel=0.15)
    assert radio.air(Radio(), 100.0, seed=1) is None


def test_the_laws_are_the_same_in_jax():
    random = np.random.default_rng(3)
    across = random.uniform(1.0, 3000.0, (4, 6)).astype(np.float32)
    owner, channel, sending = random.integers(-1, 4, 6), np.array([0, 1, 0, 1]), np.array([True, True, True, False])

    def both(law):
        return np.asarray(law(jnp)), np.asarray(law(np))

    for law in (
        lambda xp: radio.air_to_ground_loss(xp.asarray(across), 100.0, 2 * GHZ, radio.ENVIRONMENTS["urban"]),
        lambda xp: radio.tr36777_loss(xp.asarray(across), 80.0, 2 * GHZ, "UMa-AV"),
        lambda xp: radio.tr36777_loss(xp.asarray(across), 80.0, 2 * GHZ, "UMi-AV"),
        lambda xp: radio.sinr(
            xp.asarray(-60.0 - across / 50), xp.asarray(owner), xp.asarray(channel), xp.asarray(sending), -97.0
        ),
        lambda xp: radio.link_capacity(xp.asarray(across), 20.0, 5 * GHZ, 20e6, -94.0, 8.0),
        lambda xp: AIR.efficiency(*map(xp.asarray, (across[:, :2], across.T[:, :2], owner, channel))),
    ):
        compiled, plain = both(law)
        np.testing.assert_allclose(compiled, plain, rtol=1e-3)
