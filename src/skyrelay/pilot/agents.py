"""A process that hosts agents: opens its keys, chain, store and bus, and answers the world until that stops."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient
from skyrelay.chain.node.chain import NodeChain
from skyrelay.core.errors import UsageError
from skyrelay.pilot.bus import Bus
from skyrelay.pilot.config import HostConfig
from skyrelay.pilot.lockstep import Radio, serve
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.authority import ReputationAuthority
from skyrelay.protocol.coordinator import ZoneCoordinator
from skyrelay.protocol.host import Host
from skyrelay.protocol.uav import UavAgent
from skyrelay.protocol.vehicle import VehicleAgent
from skyrelay.simulation.consortium import Hangar
from skyrelay.store.kubo import KuboStore
from skyrelay.store.local import LocalStore
from skyrelay.store.model_store import ModelStore

Kind = Literal["vehicle", "uav", "coordinator"]


def run_agents(kind: Kind, config: HostConfig, say: Callable[[str], None]) -> None:
    """Host the members of one kind, until the world stops.

    Args:
        say: is called with every line that a person should read.
    Raises:
        UsageError: the file has no member of this kind.
        ChainError: keystore, endpoint, chain or contract are not what the file says.
        BusError: the bus is not there, or the world has stopped.
    """
    access = config.chain
    keyring = Keyring.open(Path(access.keystore))
    agents = make_agents(kind, config, keyring)
    if not agents:
        raise UsageError(config.name, None, f"at least one {kind} to host in its file")
    chain = NodeChain(access.urls, keyring, chain_id=access.chain_id, confirmations=access.confirmations)
    client = IovClient.connect(chain, access.contract, access.chain_id)
    at = config.bus
    with Bus(config.name, at.connect, at.listen, weather=at.weather(), lossless=True) as bus:
        zones = {keyring.account(uav.name): uav.zone for uav in config.uav} if kind == "uav" else {}
        radio = Radio(bus, (access.contract, access.chain_id), keyring, zones, config.law().patience)
        host = Host(
            agents,
            client,
            open_store(config),
            heard=radio.note,
            refused=lambda agent, error: say(f"{agent.name}: {error}"),
            alone=False,
        )
        host.catch_up()
        say(f"ready: {len(agents)} of kind {kind}, at block {chain.block_number}")
        serve(host, bus, access.contract, config.name, radio, config.patience)


def make_agents(kind: Kind, config: HostConfig, keyring: Keyring) -> list[Agent]:
    """The agents of one kind that a host's file names, with the addresses that its keys give them."""
    if kind == "vehicle":
        selection, grid = config.resolved().selection, config.grid()
        return [
            VehicleAgent(vehicle.name, keyring.account(vehicle.name), vehicle.demand, vehicle.payment, grid, selection)
            for vehicle in config.vehicle
        ]
    if kind == "uav":
        law, altitude, hangar = config.law(), config.resolved().fleet.altitude, Hangar()
        return [
            UavAgent(uav.name, keyring.account(uav.name), uav.zone, altitude, uav.bandwidth, law, hangar.load)
            for uav in config.uav
        ]
    piece = config.resolved().chain.proposals_per_call
    address = keyring.account("coordinator")
    agents: list[Agent] = [ZoneCoordinator(zone, address, piece) for zone in config.coordinator.zones]
    if config.coordinator.reputations:
        agents.append(ReputationAuthority(keyring.account("reputation authority"), config.coordinator.reputations))
    return agents


def open_store(config: HostConfig) -> ModelStore:
    """Where the host's policies come from."""
    return KuboStore(config.store.url) if config.store.url else LocalStore(Path(config.store.path or ""))
