"""Algorithms 1 and 2, the fast path against the plain loops, and the rounds beyond the paper."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from selection_tables import drawn, settings_drawn, tables, uavs_at, vehicles_at

from skyrelay.core.errors import SelectionError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection import allocate, is_valid, proposal, propose, qou, qov, reference, select

DEFAULT = Settings()


@given(tables(), settings_drawn)
def test_quality_equals_the_plain_loops(both, rule):
    vehicles, uavs = both
    for matrix, score in ((qou(vehicles, uavs, rule), reference.qou_of), (qov(vehicles, uavs, rule), reference.qov_of)):
        assert matrix.shape == (len(vehicles), len(uavs))
        for v, u in np.ndindex(matrix.shape):
            candidate = reference.is_candidate(vehicles, v, uavs, u, rule)
            assert matrix[v, u] == (score(vehicles, v, uavs, u, rule) if candidate else -np.inf)


def test_qou_of_a_hand_computed_pair():
    vehicles = vehicles_at([0.0], demand=[2000], payment=[350], reputation=[80])
    uavs = uavs_at([1500.0], bandwidth=[5000], battery=[40], reputation=[60])
    assert qou(vehicles, uavs, DEFAULT)[0, 0] == pytest.approx(100 * 0.25 * (0.25 + 0.4 + 0.6 + 0.5))
    assert qov(vehicles, uavs, DEFAULT)[0, 0] == pytest.approx(100 * 0.25 * (0.5 + 0.5 + 0.8 + 0.5))


def test_distance_term_never_falls_below_zero():
    vehicles, uavs = vehicles_at([0.0]), uavs_at([30000.0], bandwidth=[0], battery=[0], reputation=[0])
    assert qou(vehicles, uavs, Settings(candidates="zone"))[0, 0] == 0.0


def test_the_range_gate_is_closed_and_the_zone_rule_drops_it():
    vehicles, uavs = vehicles_at([0.0, 0.0]), uavs_at([3000.0, 3000.5])
    np.testing.assert_array_equal(np.isfinite(qou(vehicles, uavs, DEFAULT)), [[True, False]] * 2)
    assert np.isfinite(qou(vehicles, uavs, Settings(candidates="zone"))).all()


@given(tables(), settings_drawn)
def test_proposals_equal_algorithm_1(both, rule):
    vehicles, uavs = both
    expected = [reference.propose(vehicles, v, uavs, rule) for v in range(len(vehicles))]
    assert propose(vehicles, uavs, rule).tolist() == expected


@given(tables(max_vehicles=12, max_uavs=8), settings_drawn, st.integers(1, 4))
def test_blocks_of_neighbours_change_nothing(both, rule, block_pairs):
    vehicles, uavs = both
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(proposal, "_BLOCK_PAIRS", block_pairs)
        patch.setattr(proposal, "_BLOCK_VEHICLES", 2)
        blocked = select(vehicles, uavs, settings=rule, rounds="full").assignment.tolist()
        once = propose(vehicles, uavs, rule).tolist()
    assert once == [reference.propose(vehicles, v, uavs, rule) for v in range(len(vehicles))]
    assert blocked == reference.two_sided(vehicles, uavs, rule, rounds=1000)


@pytest.mark.parametrize("candidates", ["range", "zone"])
def test_a_city_in_blocks_equals_the_plain_loops(candidates):
    vehicles, uavs = drawn(3, vehicles=3000, uavs=300, side=12000.0, zones=2, whole=False)
    rule = Settings(candidates=candidates)
    score = qou(vehicles, uavs, rule)
    best = np.where(score.max(axis=1) > 0, score.argmax(axis=1), -1)
    np.testing.assert_array_equal(propose(vehicles, uavs, rule), best)


def test_the_first_of_equal_uavs_is_asked():
    vehicles, uavs = vehicles_at([0.0]), uavs_at([500.0, -500.0])
    assert propose(vehicles, uavs, DEFAULT).tolist() == [0]


def test_a_uav_of_no_quality_is_never_asked():
    vehicles, uavs = vehicles_at([0.0]), uavs_at([3000.0], bandwidth=[0], battery=[0], reputation=[0])
    assert propose(vehicles, uavs, DEFAULT).tolist() == [-1]


@given(tables(), settings_drawn, st.randoms(use_true_random=False))
def test_excluded_uavs_are_not_asked(both, rule, chance):
    vehicles, uavs = both
    excluded = np.array(
        [[chance.random() < 0.4 for _ in range(len(uavs))] for _ in range(len(vehicles))], dtype=bool
    ).reshape(len(vehicles), len(uavs))
    expected = [
        reference.propose(vehicles, v, uavs, rule, frozenset(np.flatnonzero(excluded[v]).tolist()))
        for v in range(len(vehicles))
    ]
    assert propose(vehicles, uavs, rule, excluded).tolist() == expected


def test_excluded_of_another_shape_is_refused():
    with pytest.raises(SelectionError, match=r"excluded.shape: is \(1,\); expected the shape \(2, 1\)"):
        propose(vehicles_at([0.0, 1.0]), uavs_at([0.0]), DEFAULT, [True])


def test_a_proposal_that_does_not_fit_is_skipped_and_a_smaller_one_still_fits():
    accepted = allocate(
        uav=np.array([0, 0, 0]),
        score=np.array([9.0, 8.0, 7.0]),
        demand=np.array([3000, 2000, 1000]),
        capacity=np.array([4000]),
    )
    assert accepted.tolist() == [True, False, True]


def test_equal_scores_go_to_the_earlier_submission():
    uav, score, demand = np.zeros(2, dtype=np.int64), np.array([5, 5]), np.array([3000, 3000])
    assert allocate(uav, score, demand, np.array([4000])).tolist() == [True, False]
    assert allocate(uav, score, demand, np.array([4000]), order=np.array([7, 2])).tolist() == [False, True]


@given(tables(), settings_drawn, st.integers(1, 5))
def test_rounds_equal_the_plain_loops(both, rule, rounds):
    vehicles, uavs = both
    chosen = select(vehicles, uavs, settings=rule, rounds=rounds)
    assert chosen.assignment.tolist() == reference.two_sided(vehicles, uavs, rule, rounds)
    assert is_valid(vehicles, uavs, chosen.assignment, rule)
    assert len(chosen.rounds) <= rounds


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("rounds", [1, 2, 1000])
def test_drawn_instances_equal_the_plain_loops(seed, rounds):
    vehicles, uavs = drawn(seed, vehicles=120, uavs=25, zones=2, whole=False)
    assert select(vehicles, uavs, rounds=rounds).assignment.tolist() == reference.two_sided(
        vehicles, uavs, DEFAULT, rounds
    )


def test_a_refused_vehicle_is_served_in_the_second_round():
    vehicles = vehicles_at([0.0, 0.0], demand=[2000, 2000], reputation=[90, 10])
    uavs = uavs_at([100.0, 200.0], bandwidth=[2000, 2000])
    assert select(vehicles, uavs, rounds=1).assignment.tolist() == [0, -1]
    assert select(vehicles, uavs, rounds=2).assignment.tolist() == [0, 1]


def test_a_later_proposal_displaces_a_held_vehicle_which_asks_on():
    # v1 is refused by u0 and displaces v2 at u1; v2 is refused by u0 as well and ends at u2.
    vehicles = vehicles_at([0.0, 0.0, 2000.0], reputation=[90, 50, 1])
    uavs = uavs_at([0.0, 1000.0, 2900.0], bandwidth=[2000, 2000, 2000], battery=[90, 80, 10])
    chosen = select(vehicles, uavs, rounds="full")
    assert [r.uav.tolist() for r in chosen.rounds] == [[0, 0, 1], [1], [0], [2]]
    assert chosen.rounds[0].accepted.tolist() == [True, False, True]
    assert chosen.assignment.tolist() == [0, 1, 2]


@given(tables(), settings_drawn)
@hypothesis_settings(max_examples=50)
def test_full_acceptance_leaves_no_unserved_vehicle_a_uav_it_never_asked(both, rule):
    vehicles, uavs = both
    chosen = select(vehicles, uavs, settings=rule, rounds="full")
    asked = {(v, u) for r in chosen.rounds for v, u in zip(r.vehicle.tolist(), r.uav.tolist(), strict=True)}
    assert len(asked) == sum(len(r.vehicle) for r in chosen.rounds), "a vehicle asked a UAV twice"
    score = qou(vehicles, uavs, rule)
    for v in np.flatnonzero(chosen.assignment < 0).tolist():
        assert {(v, u) for u in np.flatnonzero(score[v] > 0).tolist()} <= asked
