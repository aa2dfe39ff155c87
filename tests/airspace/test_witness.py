"""Claimed places against what others hear: honest crowds are believed, far lies found, accusers outvoted."""

import numpy as np
import pytest

from skyrelay.airspace.witness import STATISTICS, Hearing, implausibility

LAW = Hearing(300.0)
TIMES, MEMBERS = 10, 60


def crowd(seed=0):
    random = np.random.default_rng(seed)
    start = random.uniform(0, 800, (MEMBERS, 2))
    drive = random.uniform(-10, 10, (MEMBERS, 2))
    ground = start + np.arange(TIMES)[:, None, None] * 2.0 * drive
    true = np.concatenate([ground, np.full((TIMES, MEMBERS, 1), 1.5)], axis=2)
    distance = np.linalg.norm(true[:, :, None] - true[:, None], axis=3)
    heard = LAW.strength(distance) + random.normal(0.0, LAW.shadowing, distance.shape)
    heard[(heard < 0) | np.eye(MEMBERS, dtype=bool)] = np.nan
    return true, heard


def column(statistics, name):
    return statistics[:, STATISTICS.index(name)]


@pytest.mark.parametrize("offset", [0.5, 1.0])
def test_who_claims_another_place_stands_out_against_all_honest_ones(offset):
    true, heard = crowd()
    claimed = true.copy()
    claimed[:, 7, 0] += offset * LAW.radius
    found = column(implausibility(claimed, heard, 2.0, LAW), "another place")
    assert found.argmax() == 7
    assert found[7] > 2 * np.delete(found, 7).max()


def test_more_power_is_no_lie_about_the_place():
    true, heard = crowd()
    louder = heard.copy()
    louder[:, :, 7] += 6.0
    quiet, loud = (column(implausibility(true, one, 2.0, LAW), "another place") for one in (heard, louder))
    assert loud[7] == pytest.approx(quiet[7], abs=1e-6)


def test_a_fifth_of_accusers_does_not_make_an_honest_member_the_worst():
    true, heard = crowd()
    claimed = true.copy()
    claimed[:, 7, 1] -= LAW.radius
    accusing = heard.copy()
    accusers = np.arange(20, 32)
    accusing[:, accusers, 8] += 15.0
    found = column(implausibility(claimed, accusing, 2.0, LAW), "another place")
    assert found[7] > found[8]


def test_speed_and_silence_speak_where_nobody_hears():
    true, heard = crowd()
    claimed = true.copy()
    claimed[5:, 7, :2] += 2_000.0
    claimed[:, 9, :2] = 400.0, 400.0
    heard[:, :, 9] = np.nan
    statistics = implausibility(claimed, heard, 2.0, LAW)
    assert column(statistics, "speed")[7] > 1 > np.delete(column(statistics, "speed"), 7).max()
    assert column(statistics, "silence")[9] == 1.0
    assert np.isfinite(statistics).all()


def test_of_a_member_with_too_few_witnesses_nothing_is_said():
    true, heard = crowd()
    heard[:, 3:, 7] = np.nan
    statistics = implausibility(true, heard, 2.0, LAW)
    assert not statistics[7, :3].any()
