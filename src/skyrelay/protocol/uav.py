"""The UAV's agent: registers, keeps its record true, fetches its zone's policy by CID, checks and loads it."""

from __future__ import annotations

from collections.abc import Callable

from skyrelay.chain.chain import Call
from skyrelay.chain.client import IovClient, UavRecord
from skyrelay.policy import Policy
from skyrelay.protocol.sequence import UAV, Machine, UavMessage, UavState
from skyrelay.store.cid import Cid
from skyrelay.store.model_store import ModelStore


class UavAgent:
    """One UAV.

    Args:
        name: its id.
        address: its account on the chain.
        altitude: [m].
        bandwidth: that it offers in a period [kbit/s].
        store: where policies come from; whatever it answers is hashed again.
        load: from a policy file's bytes to a policy that has been checked to fit.
    """

    def __init__(
        self,
        name: str,
        address: str,
        altitude: float,
        bandwidth: float,
        store: ModelStore,
        load: Callable[[bytes], Policy],
    ) -> None:
        self.name, self.address = name, address
        self.machine = Machine(f"UAV {name}", UAV, UavState.NEW)
        self.policy: Policy | None = None
        self._altitude, self._bandwidth = altitude, bandwidth
        self._store, self._load = store, load
        self._loaded: Cid | None = None

    @property
    def state(self) -> UavState:
        """Where it stands in the sequence."""
        return self.machine.state

    def register(self, client: IovClient, x: float, y: float, battery: float, zone: int) -> Call:
        """registerUAV() at a position [m] with a battery [0-100]."""
        self.machine.advance(UavMessage.REGISTER)
        return client.register_uav(self.address, self._record(x, y, battery, zone))

    def update(self, client: IovClient, x: float, y: float, battery: float) -> Call:
        """updateUAVInfo() with the position [m] and the battery [0-100]."""
        self.machine.advance(UavMessage.UPDATE)
        return client.update_uav_info(self.address, self._record(x, y, battery))

    def _record(self, x: float, y: float, battery: float, zone: int = 0) -> UavRecord:
        return UavRecord(x, y, self._altitude, battery, self._bandwidth, zone)

    def learn(self, vehicles: int) -> None:
        """How many vehicles allocateZone() has selected for it so far in this period."""
        if vehicles:
            self.machine.advance(UavMessage.SELECTED)
        elif self.state is UavState.SELECTED:
            self.machine.advance(UavMessage.UNSELECTED)

    def equip(self, cid: Cid) -> Policy:
        """Fetch the policy that the contract names, check its hash and card, and load it.

        Raises:
            StoreError: the store does not have it, or answered with something else.
            ModelError: its card does not fit a UAV.
        """
        if self.policy is None or cid != self._loaded:
            self.policy, self._loaded = self._load(self._store.get(cid)), cid
        self.machine.advance(UavMessage.MODEL_VERIFIED)
        return self.policy

    def retire(self, client: IovClient) -> Call:
        """updateUAVZone(0): the battery is spent, the UAV leaves and frees its vehicles."""
        self.machine.advance(UavMessage.RETIRE)
        return client.update_uav_zone(self.address, zone=0)

    def end_period(self) -> None:
        """resetListsForZone() has closed its zone's period."""
        self.machine.advance(UavMessage.RESET)
