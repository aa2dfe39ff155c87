"""The vehicle's agent: registers, keeps its record true, runs Algorithm 1 and submits its proposal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skyrelay.chain.chain import Call
from skyrelay.chain.client import IovClient, VehicleRecord
from skyrelay.core.entities import FloatArray, VehicleTable
from skyrelay.core.scenario import Selection as Settings
from skyrelay.protocol.sequence import VEHICLE, Machine, VehicleMessage, VehicleState
from skyrelay.protocol.zone_view import ZoneView
from skyrelay.selection.proposal import propose
from skyrelay.selection.quality import are_candidates, pair_qou

_OPEN = frozenset({VehicleState.PROPOSED, VehicleState.SERVED, VehicleState.UNSERVED})


@dataclass(frozen=True)
class Choice:
    """What Algorithm 1 gave.

    Attributes:
        uav: address of the chosen UAV; None where there is no candidate left.
        qou: of the chosen UAV [0-100]; 0 where there is none.
        weighed: QoU of every candidate by its address.
    """

    uav: str | None
    qou: float
    weighed: dict[str, float]


class VehicleAgent:
    """One connected vehicle.

    Args:
        name: its id.
        address: its account on the chain.
        demand: [kbit/s].
        payment: [cents per Mbit/s].
        settings: of the selection (weights, maxima, candidates).
    """

    def __init__(self, name: str, address: str, demand: int, payment: int, settings: Settings) -> None:
        self.name, self.address = name, address
        self.demand, self.payment = demand, payment
        self.machine = Machine(f"vehicle {name}", VEHICLE, VehicleState.NEW)
        self.uav: str | None = None
        """Address of the UAV that serves it, or that it has proposed to."""
        self._settings = settings
        self._refused_by: set[str] = set()
        self._served_by: str | None = None
        self._table: VehicleTable | None = None

    @property
    def state(self) -> VehicleState:
        """Where it stands in the sequence."""
        return self.machine.state

    def report(self, client: IovClient, x: float, y: float, zone: int) -> Call:
        """Tell the contract where it is [m, to 0.1 m]: registerVehicle() the first time, then updateVehicleInfo()."""
        first = self.state is VehicleState.NEW
        self.machine.advance(VehicleMessage.REGISTER if first else VehicleMessage.UPDATE)
        # Algorithm 1 weighs the UAVs alone, so the vehicle's own reputation does not matter here.
        self._table = VehicleTable(
            ids=(self.name,),
            x=_one(x),
            y=_one(y),
            zone=np.array([zone], dtype=np.int64),
            demand=_one(self.demand),
            payment=_one(self.payment),
            reputation=_one(0.0),
        )
        send = client.register_vehicle if first else client.update_vehicle_info
        return send(self.address, VehicleRecord(x, y, self.payment, zone))

    def choose(self, view: ZoneView) -> Choice:
        """Algorithm 1 over the zone's UAVs, leaving out those that refused it in this period.

        With `selection.hysteresis` the UAV that served it in the last period is asked again unless another is so much
        better: every hand-over costs the user the link.
        """
        if self._table is None:
            raise RuntimeError("a vehicle reports before it chooses")
        self.machine.advance(VehicleMessage.READ_ZONE)
        refused = np.array([[address in self._refused_by for address in view.uavs.ids]], dtype=bool)
        column = int(propose(self._table, view.uavs, self._settings, refused)[0])
        columns = np.arange(len(view.uavs.ids))
        pairs = (self._table, view.uavs, np.zeros_like(columns), columns, self._settings)
        qou = np.where(are_candidates(*pairs), pair_qou(*pairs), -np.inf)
        column = self._or_stay(column, qou, view)
        weighed = {
            address: float(score) for address, score in zip(view.uavs.ids, qou, strict=True) if np.isfinite(score)
        }
        if column < 0:
            self.machine.advance(VehicleMessage.ABSTAIN)
            return Choice(None, 0.0, weighed)
        return Choice(view.uavs.ids[column], float(qou[column]), weighed)

    def _or_stay(self, column: int, qou: FloatArray, view: ZoneView) -> int:
        """The best UAV's column, or that of the one before."""
        if self._settings.hysteresis == 0.0 or column < 0:
            return column
        if self._served_by not in view.uavs.ids or self._served_by in self._refused_by:
            return column
        before = view.uavs.ids.index(self._served_by)
        stays = qou[before] > 0.0 and qou[before] + self._settings.hysteresis >= qou[column]
        return before if stays else column

    def submit(self, client: IovClient, uav: str, view: ZoneView) -> Call:
        """submitVehSelection() to the chosen UAV, for the zone's present round."""
        self.machine.advance(VehicleMessage.PROPOSE)
        self.uav = uav
        return client.submit_veh_selection(self.address, uav, self.demand, view.round)

    def learn(self, selected: bool) -> None:
        """What allocateZone() decided, or that a better proposal has displaced it."""
        if self.state is VehicleState.SERVED:
            if selected:
                return
            self.machine.advance(VehicleMessage.DISPLACED)
        else:
            self.machine.advance(VehicleMessage.ACCEPTED if selected else VehicleMessage.REJECTED)
        if not selected and self.uav is not None:
            self._refused_by.add(self.uav)
            self.uav = None

    def leave(self) -> None:
        """The vehicle has left the area; what it holds ends with the period."""
        if self.state in _OPEN or self.state is VehicleState.IDLE:
            self.machine.advance(VehicleMessage.LEAVE)
        self.uav = None

    def end_period(self) -> None:
        """resetListsForZone() has closed its zone's period."""
        self._served_by = self.uav if self.state is VehicleState.SERVED else None
        if self.state is not VehicleState.NEW:
            self.machine.advance(VehicleMessage.RESET)
        self.uav = None
        self._refused_by.clear()


def _one(value: float) -> FloatArray:
    return np.array([value], dtype=np.float64)
