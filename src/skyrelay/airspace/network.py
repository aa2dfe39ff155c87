"""The network of an area: what its radio carries for vehicles, and what its links bring on to gateways (NumPy).

One place for the run that measures and for the audit that measures again. The laws themselves are those of
`skyrelay.airspace.radio` and `skyrelay.airspace.service`, as in the compiled game.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from skyrelay.airspace import flight, service
from skyrelay.airspace.radio import Air, air
from skyrelay.core.entities import FloatArray, IntArray
from skyrelay.core.scenario import Gateway, Scenario

Bools = npt.NDArray[np.bool_]

AT_ONCE = 1_000_000
"""Pairs of a UAV and a vehicle whose powers are worked out together: of all pairs memory would not hold them."""
WIDE = float(service.LARGEST)
"""What a link of the paper's disc holds [kbit/s]: anything."""


@dataclass(frozen=True)
class Network:
    """One area's.

    Attributes:
        reach: of the links between UAVs, and from UAVs to gateways [m].
        air: what links carry; None: the paper's disc.
        gateways: none: whatever is carried is delivered.
        walls: as in `skyrelay.airspace.law.Law`.
    """

    reach: float = 0.0
    air: Air | None = None
    gateways: tuple[Gateway, ...] = ()
    walls: FloatArray | None = None

    @classmethod
    def of(cls, scenario: Scenario, reach: float, walls: FloatArray | None) -> Network:
        """A scenario's."""
        return cls(reach, air(scenario.radio, scenario.fleet.altitude, scenario.seed), scenario.gateways, walls)

    def carried(
        self,
        demand: FloatArray,
        owner: IntArray,
        covered: Bools,
        ground: FloatArray,
        uavs: FloatArray,
        aloft: Bools,
        available: FloatArray,
    ) -> FloatArray:
        """[V] what each vehicle's link carries [kbit/s].

        With the disc that goes by ``covered`` alone; with another radio by the link, however far the UAV is.

        Args:
            demand: [V] [kbit/s].
            owner: [V] row of the vehicle's UAV, negative for none.
            covered: [V] inside its range and in its sight.
            ground: [V, 2] of the vehicles [m], NaN for one that is not there.
            uavs: [N, 2] [m].
            aloft: [N] in the air.
            available: [N] each UAV's bandwidth [kbit/s].
        """
        if self.air is None:
            return np.asarray(service.in_disc(demand, owner, covered, available), dtype=np.float64)
        there = (owner >= 0) & np.isfinite(ground[:, 0])
        there[there] = aloft[owner[there]]
        efficiency = np.zeros(len(demand))
        efficiency[there] = self._efficiency(self.air, ground[there], owner[there], uavs, aloft)
        spectrum = self.air.radio.bandwidth * 1e6
        held = np.where(there, owner, -1)
        return np.asarray(service.carried(demand, held, efficiency, spectrum, available), dtype=np.float64)

    def _efficiency(self, air: Air, ground: FloatArray, owner: IntArray, uavs: FloatArray, aloft: Bools) -> FloatArray:
        """[V] what a hertz carries to each vehicle [bit/s/Hz]; a UAV that serves someone sends, and disturbs others."""
        sending = np.isin(np.arange(len(uavs)), owner) & aloft
        place = np.zeros(len(uavs), dtype=np.int64)
        seen = None
        if self.walls is not None:
            seen = np.asarray(flight.in_sight(ground, uavs[owner], self.walls), dtype=bool)
        result = np.zeros(len(ground))
        channel = np.arange(len(uavs)) % air.radio.channels
        # Channels do not disturb each other: each one's pairs are worked out apart, so many at once.
        for one in np.unique(channel[sending]).tolist():
            rows = np.flatnonzero(sending & (channel == one))
            place[rows] = np.arange(len(rows))
            mine = np.flatnonzero(channel[owner] == one)
            size = max(AT_ONCE // len(rows), 1)
            for part in (mine[first : first + size] for first in range(0, len(mine), size)):
                sight = None if seen is None else seen[part]
                result[part] = air.efficiency(uavs[rows], ground[part], place[owner[part]], np.zeros(len(rows)), sight)
        return result

    def delivered(self, carried: FloatArray, owner: IntArray, uavs: FloatArray, aloft: Bools) -> FloatArray:
        """[V] of what is carried, what reaches a gateway over the UAVs' links [kbit/s]; all of it without gateways.

        Args: as in `carried`.
        """
        if not self.gateways:
            return carried
        places = np.array([(gateway.x, gateway.y) for gateway in self.gateways])
        capacity = np.array([gateway.capacity for gateway in self.gateways]) * 1000.0
        rows = np.flatnonzero(aloft)
        index = np.full(len(uavs) + 1, -1)  # the last one stands for nobody
        index[rows] = np.arange(len(rows))
        at, by = uavs[rows], index[owner]
        one, other = (
            cKDTree(at).query_pairs(self.reach, output_type="ndarray").T if len(rows) else np.empty((2, 0), int)
        )
        apart = np.hypot(*(at[one] - at[other]).T)
        rate = np.full(len(one), WIDE) if self.air is None else self.air.backhaul(apart, None)
        both = (np.concatenate([one, other]), np.concatenate([other, one]))
        links = coo_array((np.concatenate([rate, rate]), both), shape=(len(rows), len(rows)))
        away = np.hypot(*(at[:, None] - places[None]).transpose(2, 0, 1))
        down = np.full(away.shape, WIDE)
        if self.air is not None:
            down = np.column_stack(
                [self.air.backhaul(away[:, column], gateway.height) for column, gateway in enumerate(self.gateways)]
            )
        ways = np.where(away <= self.reach, down, 0.0)
        brought = service.of_uavs(carried, by, len(rows))
        return service.reached_by(service.delivered(brought, links, ways, capacity), carried, by)
