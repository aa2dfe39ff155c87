"""UAVs of a zone in a whole run, crowded by choice: none comes nearer to another than the scenario says."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from skyrelay.core.progress import Silent
from skyrelay.core.scenario import load_scenario
from skyrelay.simulation import play


def nearer(folder, separation):
    """How many pairs of a zone are nearer than the separation, and than a step before."""
    uavs = pq.read_table(folder / "uavs.parquet").to_pandas()
    count, before = 0, {}
    for (step, _), team in uavs[uavs.zone > 0].groupby(["step", "zone"]):
        names, places = team.uav.tolist(), team[["x", "y"]].to_numpy()
        apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
        for one, other in zip(*np.triu_indices(len(names), 1), strict=True):
            pair, distance = (names[one], names[other]), apart[one, other]
            count += step > 0 and distance < min(separation, before.get(pair, np.inf)) * (1 - 1e-4)
            before[pair] = distance
    return count


@pytest.mark.parametrize("policy", ["auto", "cover"])
def test_no_policy_brings_two_uavs_nearer_than_the_separation(tmp_path, policy):
    crowd = ["coordination.steps=12", "fleet.uavs=80", "fleet.battery=[50, 100]", f"coordination.policy={policy}"]
    found = {}
    for separation in (0, 120):
        folder = tmp_path / str(separation)
        folder.mkdir()
        play(load_scenario("bologna", [*crowd, f"fleet.separation={separation}"]), folder, Silent())
        found[separation] = nearer(folder, 120)
    assert found[120] == 0
    assert found[0] > 20
