"""The team's reward (Eq. 3) and the measures it is made of."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Array, Bool, Float, Int

from skyrelay.core.flight import connectivity, connectivity_neighbor, coverage, links


class Score(NamedTuple):
    """How a team stands at one instant.

    Attributes:
        reward: Eq. 3, in [-2, 0].
        coverage: share of the vehicles inside their own UAV's range.
        connectivity: 1 where a path of links joins every two UAVs, else 0.
        connectivity_neighbor: 1 where each UAV has at least one neighbour, else 0 (the paper's results text).
    """

    reward: Float[Array, ""]
    coverage: Float[Array, ""]
    connectivity: Float[Array, ""]
    connectivity_neighbor: Float[Array, ""]


def score(
    uavs: Float[Array, "uavs 2"],
    active: Bool[Array, " uavs"],
    vehicles: Float[Array, "vehicles 2"],
    owner: Int[Array, " vehicles"],
    reach: Float[Array, ""],
) -> Score:
    """Measure a team (arguments as `skyrelay.coordination.observation.observe`).

    Source: Eq. 3, reward = (coverage - 1) + (connectivity - 1), shared by all UAVs of the team.
    """
    graph = links(uavs, reach, active)
    covered = coverage(uavs, vehicles, owner, reach)
    connected = connectivity(graph, active).astype(covered.dtype)
    neighbored = connectivity_neighbor(graph, active).astype(covered.dtype)
    return Score((covered - 1.0) + (connected - 1.0), covered, connected, neighbored)
