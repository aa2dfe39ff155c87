"""The zone coordinator: calls allocateZone() every period, asks for the policy, and closes the period."""

from __future__ import annotations

from skyrelay.chain.chain import Call
from skyrelay.chain.client import IovClient
from skyrelay.protocol.sequence import ZONE, Machine, ZoneMessage, ZoneState


class ZoneCoordinator:
    """The coordinator of one zone.

    Args:
        zone: its id.
        address: an account with the coordinator's role.
        proposals_per_call: largest piece of an allocation in one transaction [proposals].
    """

    def __init__(self, zone: int, address: str, proposals_per_call: int) -> None:
        self.zone, self.address = zone, address
        self.machine = Machine(f"zone {zone}", ZONE, ZoneState.COLLECTING)
        self._piece = proposals_per_call

    def allocate(self, client: IovClient) -> Call:
        """allocateZone(): the next piece of Algorithm 2; call again until `allocated`."""
        return client.allocate_zone(self.address, self.zone, self._piece)

    def allocated(self) -> None:
        """The chain has decided every proposal of the round."""
        self.machine.advance(ZoneMessage.ALLOCATE)

    def open_round(self) -> None:
        """Rejected vehicles may propose again."""
        self.machine.advance(ZoneMessage.OPEN_ROUND)

    def determine_model(self, client: IovClient) -> Call:
        """determineMDRLModel(): assign the zone's team a policy."""
        self.machine.advance(ZoneMessage.DETERMINE_MODEL)
        return client.determine_mdrl_model(self.address, self.zone)

    def reset(self, client: IovClient) -> Call:
        """resetListsForZone(): close the period."""
        self.machine.advance(ZoneMessage.RESET)
        return client.reset_lists_for_zone(self.address, self.zone)
