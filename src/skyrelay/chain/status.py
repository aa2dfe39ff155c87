"""How a deployed contract stands: who may do what, its zones, members and models, from its own events and views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from skyrelay.chain.client import IovClient, Model, Role, ZoneInfo


@dataclass(frozen=True, slots=True)
class Status:
    """A contract at the latest block.

    Attributes:
        block: number of that block.
        roles: who holds each role now, in the order in which they came to it.
        zones: that a UAV ever entered.
        coordinators: by zone, where it has one of its own; such a zone need not be entered yet.
        uavs, vehicles: how many ever registered.
        suspended: members that are suspended.
        models: all, the first registered first; retired ones too.
    """

    block: int
    roles: Mapping[Role, tuple[str, ...]]
    zones: tuple[ZoneInfo, ...]
    coordinators: Mapping[int, str]
    uavs: int
    vehicles: int
    suspended: tuple[str, ...]
    models: tuple[Model, ...]


def contract_status(client: IovClient) -> Status:
    """Ask a contract; its events say whom to ask about, its views what holds.

    Raises:
        ChainError: the chain is out of reach.
    """
    block = client.chain.block_number
    granted: dict[str, list[str]] = {}
    suspended: dict[str, bool] = {}
    zones: set[int] = set()
    coordinators: dict[int, str] = {}
    kinds = {"UAVRegistered": 0, "VehicleRegistered": 0}
    for event in client.events(0, block):
        if event.name == "RoleGranted":
            granted.setdefault(event.args["role"], []).append(event.args["account"])
        elif event.name in kinds:
            kinds[event.name] += 1
        elif event.name == "MemberSuspended":
            suspended[event.args["member"]] = event.args["suspended"]
        elif event.name == "ZoneOpened":
            zones.add(event.args["zone"])
        elif event.name == "ZoneCoordinatorSet":
            coordinators[event.args["zone"]] = event.args["coordinator"]
    return Status(
        block=block,
        roles={
            role: tuple(
                account
                for account in dict.fromkeys(granted.get(client.role_id(role), ()))
                if client.has_role(role, account)
            )
            for role in Role
        },
        zones=tuple(info for zone in sorted(zones) if (info := client.zone_info(zone)) is not None),
        coordinators={zone: account for zone, account in sorted(coordinators.items()) if int(account, 16)},
        uavs=kinds["UAVRegistered"],
        vehicles=kinds["VehicleRegistered"],
        suspended=tuple(member for member, on in suspended.items() if on),
        models=tuple(client.models()),
    )
