"""The rules of the games as every UAV flies them in a run: from its own sight."""

import jax
import numpy as np
import pytest

from skyrelay.airspace.law import Law
from skyrelay.airspace.sight import Sight
from skyrelay.baselines.catalogue import BASELINES
from skyrelay.baselines.flown import FlownPlayer, flown
from skyrelay.coordination.settings import Shape, physical
from skyrelay.core.scenario import Energy
from skyrelay.core.zones import ZoneGrid
from skyrelay.learning.evaluation import starts

SIDE, REACH = 6000.0, 3000.0
LAW = Law(ZoneGrid(0.0, 0.0, SIDE, 1, 1), REACH, 30.0, 10.0, Energy(), None, 10.0)


def sights(state):
    """What each UAV of a game knows, in metres."""
    uavs, vehicles = np.asarray(state.uavs) * SIDE, np.asarray(state.traffic.position) * SIDE
    served_by = np.asarray(state.served_by)
    for row in range(len(uavs)):
        team = tuple(map(tuple, np.delete(uavs, row, axis=0).tolist()))
        own = tuple(map(tuple, vehicles[served_by == row].tolist()))
        yield Sight(LAW, 1, tuple(uavs[row].tolist()), team, (0.0,) * len(team), own, 90.0, f"u{row}")


@pytest.mark.parametrize("name", ["cover", "centroid"])
def test_a_rule_for_each_uav_alone_does_as_in_the_game(name):
    games = starts(jax.random.key(3), 12, Shape(3, 9), physical((3, 3), (9, 9), zone_side=SIDE, reach=REACH))
    player, same = FlownPlayer(BASELINES[name], seed=0), 0
    for number in range(12):
        state = jax.tree.map(lambda leaf, number=number: leaf[number], games)
        actions, _ = jax.jit(lambda state: BASELINES[name].act(state, None))(state)
        same += sum(player(sight) == int(action) for sight, action in zip(sights(state), actions, strict=True))
    assert same >= 35  # of 36: metres and back may round a tie to the other side


def test_large_teams_and_crowds_are_cut_to_the_nearest():
    far = tuple((10.0 + row, 20.0) for row in range(400))
    team = tuple((5000.0, 10.0 * row) for row in range(40))
    sight = Sight(LAW, 1, (3000.0, 3000.0), team, (0.0,) * 40, (*far, (3100.0, 3000.0)), 90.0, "u")
    assert flown(BASELINES["centroid"], 1)(sight) in range(1, 9)


def test_nobody_to_serve_and_no_team():
    sight = Sight(LAW, 1, (3000.0, 3000.0), (), (), (), 90.0, "u")
    for name in ("centroid", "cover", "pso"):
        assert flown(BASELINES[name], 1)(sight) in range(9)


def test_the_same_seed_draws_the_same_and_each_selection_anew():
    def drawn(seed):
        player = flown(BASELINES["random"], seed)
        return [
            player(Sight(LAW, 1, (1.0, 1.0), (), (), (), 90.0, "u", decisions))
            for _ in range(2)
            for decisions in range(12)
        ]

    assert drawn(1) == drawn(1)
    assert drawn(1) != drawn(2)
    assert drawn(1)[:12] != drawn(1)[12:]


def test_a_placement_links_a_team_that_is_not():
    """Coverage is whole where it is; what can be gained is the link, to the east."""
    vehicles = ((1500.0, 3000.0),)
    sight = Sight(LAW, 1, (1000.0, 3000.0), ((4300.0, 3000.0),), (0.0,), vehicles, 90.0, "u")
    assert flown(BASELINES["pso"], 1)(sight) in {1, 2, 8}
