"""From what an agent wants of the contract to the transaction that asks for it."""

from __future__ import annotations

from skyrelay.chain.chain import Call
from skyrelay.chain.client import IovClient
from skyrelay.protocol.messages import (
    AllocateZone,
    ChainCall,
    ChangeZone,
    DetermineModel,
    Propose,
    RegisterUav,
    RegisterVehicle,
    ResetZone,
    SetReputations,
    UpdateUav,
    UpdateVehicle,
)


def to_call(command: ChainCall, sender: str, client: IovClient) -> Call:
    """The transaction of ``sender``."""
    match command:
        case RegisterVehicle(record):
            return client.register_vehicle(sender, record)
        case UpdateVehicle(record):
            return client.update_vehicle_info(sender, record)
        case Propose(uav, demand, round_):
            return client.submit_veh_selection(sender, uav, demand, round_)
        case RegisterUav(record):
            return client.register_uav(sender, record)
        case UpdateUav(record):
            return client.update_uav_info(sender, record)
        case ChangeZone(zone):
            return client.update_uav_zone(sender, zone)
        case AllocateZone(zone, proposals):
            return client.allocate_zone(sender, zone, proposals)
        case DetermineModel(zone):
            return client.determine_mdrl_model(sender, zone)
        case ResetZone(zone):
            return client.reset_lists_for_zone(sender, zone)
        case SetReputations(reputations):
            return client.set_reputations(sender, reputations)
