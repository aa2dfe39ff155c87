"""A process that hosts agents: opens its keys, chain, store and bus, and answers the world until that stops."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient
from skyrelay.chain.node.chain import NodeChain
from skyrelay.core.errors import UsageError
from skyrelay.pilot.autopilot import Autopilot
from skyrelay.pilot.bus import Bus
from skyrelay.pilot.config import HostConfig
from skyrelay.pilot.flown import FlownUav
from skyrelay.pilot.free import Wall, run_free
from skyrelay.pilot.geodesy import Frame
from skyrelay.pilot.lockstep import Radio, host_key, serve
from skyrelay.pilot.metrics import Metrics
from skyrelay.pilot.position import Gpsd, PositionSource
from skyrelay.pilot.receivers import Receivers
from skyrelay.pilot.standby import Standby
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.authority import ReputationAuthority
from skyrelay.protocol.coordinator import ZoneCoordinator
from skyrelay.protocol.host import Host
from skyrelay.protocol.relay import Relay
from skyrelay.protocol.uav import UavAgent
from skyrelay.protocol.vehicle import VehicleAgent
from skyrelay.simulation.consortium import Hangar
from skyrelay.store.kubo import KuboStore
from skyrelay.store.local import LocalStore
from skyrelay.store.model_store import ModelStore

METRICS_TOKEN = "SKYRELAY_METRICS_TOKEN"  # noqa: S105  (the variable's name)
Kind = Literal["vehicle", "uav", "coordinator"]


def run_agents(
    kind: Kind,
    config: HostConfig,
    say: Callable[[str], None],
    *,
    airframe: tuple[str, Frame] | None = None,
    receiver: tuple[str, Frame] | None = None,
    metrics: str | None = None,
) -> None:
    """Host the members of one kind, until the world stops or the timetable ends.

    Args:
        say: is called with every line that a person should read.
        airframe: where the autopilot of the one UAV is reached, and where the scenario's plane is.
        receiver: where gpsd of the one vehicle is reached, and where the scenario's plane is.
        metrics: ``HOST:PORT`` at which Prometheus is answered.
    Raises:
        UsageError: the file has no member of this kind, or not one UAV for the airframe, one vehicle for the receiver.
        PositionError: gpsd is not there.
        AutopilotError: it is not there, or does not take off.
        ChainError: keystore, endpoint, chain or contract are not what the file says.
        BusError: the bus is not there, or the world has stopped.
    """
    access = config.chain
    keyring = Keyring.open(Path(access.keystore))
    agents = make_agents(kind, config, keyring)
    if not agents:
        raise UsageError(config.name, None, f"at least one {kind} to host in its file")
    if airframe is not None and (kind != "uav" or len(agents) != 1):
        raise UsageError("--autopilot", f"{len(agents)} of kind {kind}", "one UAV: name it by --members")
    if airframe is not None and config.resolved().coordination.dispatch:
        # The fence is the zone's that it takes off in: it would never arrive in another.
        raise UsageError("--autopilot", "coordination.dispatch = true", "a scenario without dispatch")
    if airframe is not None and config.law().places:
        raise UsageError("--autopilot", "charging places", "a scenario without energy.places and [[charging]]")
    if receiver is not None and (kind != "vehicle" or len(agents) != 1):
        raise UsageError("--gpsd", f"{len(agents)} of kind {kind}", "one vehicle: name it by --members")
    chain = NodeChain(access.urls, keyring, chain_id=access.chain_id, confirmations=access.confirmations)
    client = IovClient.connect(chain, access.contract, access.chain_id)
    at = config.bus
    with ExitStack() as stack:
        asked = config.clock is None  # in lock-step: whoever is asked waits for what others sent
        bus = stack.enter_context(
            Bus(
                config.name,
                at.connect,
                at.listens(),
                weather=at.weather(),
                lossless=asked,
                certificates=at.certificates(),
            )
        )
        zones = {keyring.account(uav.name): uav.zone for uav in config.uav} if kind == "uav" else {}
        radio = Radio(bus, (access.contract, access.chain_id), keyring, zones, config.law().patience)
        host = Host(
            agents,
            client,
            open_store(config),
            heard=radio.note,
            refused=lambda agent, error: say(f"{agent.name}: {error}"),
            relay=Relay(keyring, agents[0].address),
            alone=False,
        )
        host.catch_up()
        if metrics is not None:
            server = _metrics(config.name, host, radio, bus).serve(metrics, os.environ.get(METRICS_TOKEN) or None)
            say(f"metrics at {stack.enter_context(server).url}")
        flown: dict[str, FlownUav] = {}
        if airframe is not None:
            (uav,) = config.uav
            autopilot = stack.enter_context(Autopilot(*airframe))
            law, altitude = config.law(), config.resolved().fleet.altitude
            body = stack.enter_context(FlownUav(autopilot, law, uav.zone, altitude, say))
            flown[keyring.account(uav.name)] = body
        own: dict[str, PositionSource] = {}
        if receiver is not None:
            own[agents[0].address] = stack.enter_context(Gpsd(*receiver))
        bus.claim(f"{host_key(access.contract, config.name)}/alive")
        seconds = config.coordinator.standby
        standby = Standby(host, seconds, say) if kind == "coordinator" and seconds is not None else None
        say(f"ready: {len(agents)} of kind {kind}, at block {chain.block_number}")
        receivers = Receivers(bus, access.contract, config.name, _moving(agents), own, flown)
        if config.clock is not None:
            off = config.clock.off
            wall = Wall(lambda: time.time() + off, say)
            run_free(host, bus, config, config.clock, radio, receivers, standby, wall)
            return
        serve(host, bus, access.contract, config.name, radio, config.patience, receivers, standby)


def _moving(agents: Sequence[Agent]) -> list[str]:
    """Addresses of those who have a receiver."""
    return [agent.address for agent in agents if isinstance(agent, VehicleAgent | UavAgent)]


def _metrics(name: str, host: Host, radio: Radio, bus: Bus) -> Metrics:
    """What a host counts."""
    metrics = Metrics(name)
    metrics.gauge("members", "Agents in this process", lambda: len(host.agents))
    metrics.counter("transactions", "Mined for these agents", lambda: host.transactions)
    metrics.counter("gas", "Used by these transactions", lambda: host.gas_used)
    metrics.counter("chain_wait_seconds", "Waited for the chain", lambda: host.chain_seconds)
    metrics.gauge("peers", "On the bus, that this process is linked to", lambda: bus.peers)
    metrics.counter("beacons_admitted", "Beacons let in", lambda: radio.gate.admitted)
    metrics.counter("beacons_dropped", "Beacons dropped", radio.gate.dropped_by_reason, label="reason")
    return metrics


def make_agents(kind: Kind, config: HostConfig, keyring: Keyring) -> list[Agent]:
    """The agents of one kind that a host's file names, with the addresses that its keys give them."""
    if kind == "vehicle":
        scenario, grid = config.resolved(), config.grid()
        signs = scenario.chain.signs
        return [
            VehicleAgent(
                vehicle.name,
                keyring.account(vehicle.name),
                vehicle.demand,
                vehicle.payment,
                grid,
                scenario.selection,
                signs=signs,
                tells=scenario.coordination.dispatch,
            )
            for vehicle in config.vehicle
        ]
    if kind == "uav":
        scenario = config.resolved()
        law, altitude, hangar = config.law(), scenario.fleet.altitude, Hangar(scenario)
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
