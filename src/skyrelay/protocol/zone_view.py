"""What a member reads of a zone from the contract before it proposes: getZoneUAV() and getUAVInfo()."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyrelay.chain.client import IovClient, UavInfo
from skyrelay.core.entities import FloatArray, UavTable


@dataclass(frozen=True)
class ZoneView:
    """A zone as the chain has it at one block.

    Attributes:
        zone: its id.
        round: that proposals have to name now.
        uavs: its UAVs in the contract's list order, ids being their addresses. Bandwidth is what each offers in the
            whole period, so that a vehicle's preferences do not change between the rounds of a period.
        room: [U] of that, what is not committed to a vehicle [kbit/s].
    """

    zone: int
    round: int
    uavs: UavTable
    room: FloatArray


def read_zone(client: IovClient, zone: int) -> ZoneView | None:
    """The view of a zone, or None where no UAV ever was."""
    info = client.zone_info(zone)
    if info is None:
        return None
    infos = client.uav_infos(client.zone_uavs(zone))
    room = np.array([uav.available for uav in infos], dtype=np.float64)
    return ZoneView(zone, info.round, _table(infos), room)


def _table(infos: Sequence[UavInfo]) -> UavTable:
    def column(name: str) -> FloatArray:
        return np.array([getattr(info, name) for info in infos], dtype=np.float64)

    return UavTable(
        ids=tuple(info.address for info in infos),
        x=column("x"),
        y=column("y"),
        zone=np.array([info.zone for info in infos], dtype=np.int64),
        bandwidth=column("bandwidth"),
        battery=column("battery"),
        reputation=column("reputation"),
    )
