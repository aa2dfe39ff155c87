"""A whole scenario on one machine: a clock and a world around the agents, and the record of what they did."""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from skyrelay.chain.abi import Event
from skyrelay.chain.client import QOV_UNIT
from skyrelay.core.files import write_text
from skyrelay.core.law import Law
from skyrelay.core.progress import Progress
from skyrelay.core.resolved import ResolvedScenario, resolve
from skyrelay.core.scenario import Scenario, to_toml
from skyrelay.core.zones import ZoneGrid
from skyrelay.mobility import Tracks, load_tracks
from skyrelay.protocol.coordinator import ZoneCoordinator
from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import Fix, Phase, Tick
from skyrelay.protocol.uav import UavAgent
from skyrelay.protocol.vehicle import VehicleAgent
from skyrelay.simulation.consortium import Consortium
from skyrelay.simulation.ledger import Ledger
from skyrelay.simulation.record import Record
from skyrelay.simulation.team import Team
from skyrelay.simulation.world import deploy_fleet, draw_members

REPUTATIONS_PER_CALL = 100


def play(scenario: Scenario, folder: Path, progress: Progress) -> dict[str, Any]:
    """Play a scenario and leave its record in ``folder``.

    Returns: the summary, as in ``summary.json``.
    Raises:
        TraceError, ModelError, StoreError, ChainError: naming what was wrong with what.
    """
    begin = time.monotonic()
    progress.stage("Vehicles", 1)
    tracks = load_tracks(scenario)
    grid = ZoneGrid.over(*tracks.box, scenario.zones.columns, scenario.zones.rows)
    resolved = resolve(scenario, grid)
    write_text(folder / "scenario.toml", to_toml(resolved))
    config = resolved.coordination
    starts = range(0, config.steps, config.period_steps)
    with Consortium(resolved, folder) as consortium:
        run = _Run(resolved, tracks, grid, consortium)
        progress.stage("Consortium and members", 1)
        run.found()
        progress.stage("Selection and flight", config.steps)
        for period, start in enumerate(starts):
            run.select(period, start)
            for step in range(start, min(start + config.period_steps, config.steps)):
                run.fly(period, step)
                progress.advance()
        progress.stage("Record", 1)
        summary = run.summary(len(starts)) | {"wall_seconds": round(time.monotonic() - begin, 3)}
        run.record(folder)
    write_text(folder / "summary.json", json.dumps(summary, indent=2) + "\n")
    return summary


class _Run:
    """The clock, the world and the record of one run; who proposes, decides and flies are the agents."""

    def __init__(self, scenario: ResolvedScenario, tracks: Tracks, grid: ZoneGrid, consortium: Consortium) -> None:
        self.scenario, self.tracks, self.grid, self.consortium = scenario, tracks, grid, consortium
        self.members = draw_members(scenario.demand, scenario.seed, len(tracks.ids))
        law = Law.of(scenario, grid)
        fleet = deploy_fleet(scenario.fleet, scenario.seed, tracks, grid)
        self.flying = Team(law, scenario.selection, fleet, self.members.demand)
        self.hovering = Team(law, scenario.selection, fleet.copy(), self.members.demand)
        seconds = scenario.coordination.step_seconds
        self.written = Record(tracks, grid, self.members, seconds, self.flying, self.hovering)
        self.vehicles = [
            VehicleAgent(name, consortium.account(name), int(demand), int(payment), grid, scenario.selection)
            for name, demand, payment in zip(tracks.ids, self.members.demand, self.members.payment, strict=True)
        ]
        self.uavs = [
            UavAgent(
                name,
                consortium.account(name),
                zone,
                scenario.fleet.altitude,
                bandwidth,
                law,
                consortium.hangar.load,
            )
            for name, zone, bandwidth in zip(fleet.ids, fleet.zone.tolist(), fleet.bandwidth.tolist(), strict=True)
        ]
        coordinators = [
            ZoneCoordinator(zone, consortium.coordinator, scenario.chain.proposals_per_call) for zone in grid.ids
        ]
        self.uav_row = {agent.address: row for row, agent in enumerate(self.uavs)}
        self.ledger = Ledger({agent.address: row for row, agent in enumerate(self.vehicles)}, self.uav_row)
        self.events: list[tuple[int, Event]] = []
        self.step = 0
        agents = [*self.vehicles, *self.uavs, *coordinators]
        self.host = Host(agents, consortium.client, consortium.store, self._hear)
        reputations = [*self.members.reputation.tolist(), *fleet.reputation.tolist()]
        members = [*self.vehicles, *self.uavs]
        self.reputation = {agent.address: value for agent, value in zip(members, reputations, strict=True)}
        self.qou: list[float] = []
        self.qov: list[float] = []

    # The clock

    def found(self) -> None:
        """Roles, models, and the registration of every UAV; vehicles register when they appear."""
        begin = time.monotonic()
        self.consortium.found()
        self.host.chain_seconds += time.monotonic() - begin
        self.events += [(0, event) for event in self.consortium.client.events()]
        self._tell_positions()
        self._tick(Phase.JOIN)
        self._rate_newcomers()

    def select(self, period: int, step: int) -> None:
        """One selection period: records brought up to date, proposals, allocation, a policy for each zone."""
        self.ledger.open_period()
        self._tick(Phase.CLOSE, period)
        self._land(period)
        self._tick(Phase.REPORT, period)
        self._rate_newcomers()
        views = [view for zone in self.grid.ids if (view := self.host.view(zone)) is not None]
        self.written.period(period, step, views, self._name_of)
        for round_ in range(1, self.scenario.selection.rounds + 1):
            before = len(self.ledger.proposals)
            self._tick(Phase.PROPOSE, period, round_)
            if round_ == 1:
                self._note_candidates(period)
            submitted = self.ledger.proposals[before:]
            if not submitted:
                break
            for row in submitted:
                choice = self.vehicles[row["vehicle"]].choice
                row |= {"period": period, "round": round_, "qou": 0.0 if choice is None else choice.qou}
            self._tick(Phase.ALLOCATE, period, round_)
        self._note_proposals()
        self._tick(Phase.DETERMINE, period)
        self.flying.assign(self.ledger.owner())
        self.hovering.assign(self.hovering.selection(self.tracks, self.members, step))
        if step == 0:
            self.written.step(0)

    def fly(self, period: int, step: int) -> None:
        """From ``step`` to the next: UAVs decide on what they were told, everyone moves, the result is measured."""
        self._tick(Phase.BEACON, period)
        self.host.hear(self.host.take_beacons())
        self._tick(Phase.DECIDE, period)
        self.flying.flight.move({self.uav_row[uav]: action for uav, action in self.host.take_moves().items()})
        self.hovering.flight.move({})
        self.step = step + 1
        self._tell_positions()
        self._land(period)
        self.written.step(self.step)

    def _tick(self, phase: Phase, period: int = 0, round_: int = 1) -> None:
        now = self.step * self.scenario.coordination.step_seconds
        self.host.tick(Tick(phase, period, round_, self.step, now), timestamp=1 + math.floor(now))

    def _land(self, period: int) -> None:
        """UAVs with an empty battery leave: the flying fleet's by the chain, the comparator's in the air only."""
        self._tick(Phase.LAND, period)
        self.flying.flight.retire(self.ledger.take_left())
        self.hovering.flight.retire(self.hovering.flight.spent())

    # The world

    def _tell_positions(self) -> None:
        """Every member's receiver has a new position."""
        x, y = self.tracks.x[self.step].tolist(), self.tracks.y[self.step].tolist()
        for row, vehicle in enumerate(self.vehicles):
            vehicle.receive(Fix(None if math.isnan(x[row]) else (x[row], y[row])))
        fleet = self.flying.fleet
        x, y, battery = fleet.x.tolist(), fleet.y.tolist(), fleet.battery.tolist()
        for row, uav in enumerate(self.uavs):
            uav.receive(Fix((x[row], y[row]), battery[row]))

    def _rate_newcomers(self) -> None:
        """The consortium's authority gives new members what the scenario draws (the paper's uniform reputations)."""
        joined = self.ledger.take_joined()
        pieces = [joined[i : i + REPUTATIONS_PER_CALL] for i in range(0, len(joined), REPUTATIONS_PER_CALL)]
        client, authority = self.consortium.client, self.consortium.authority
        calls = [client.set_reputations(authority, {m: self.reputation[m] for m in piece}) for piece in pieces]
        self.host.execute(calls, timestamp=1 + math.floor(self.step * self.scenario.coordination.step_seconds))

    # The record

    def _hear(self, event: Event) -> None:
        self.events.append((self.step, event))
        self.ledger.hear(event)

    def _note_candidates(self, period: int) -> None:
        """Whom each vehicle weighed in the period's first round."""
        for agent in self.vehicles:
            if agent.choice is not None and agent.choice.weighed:
                weighed = {self._name_of(address): value for address, value in agent.choice.weighed.items()}
                self.written.candidates(period, agent.name, weighed)

    def _note_proposals(self) -> None:
        """Of the period's proposals, whether each UAV held on to them to the end; QoU and QoV of those it did."""
        owner, proposals = self.ledger.owner(), self.ledger.proposals
        last = {row["vehicle"]: row["order"] for row in proposals}
        for row in proposals:
            row["accepted"] = bool(owner[row["vehicle"]] == row["uav"]) and last[row["vehicle"]] == row["order"]
            if row["accepted"]:
                self.qou.append(row["qou"])
                self.qov.append(row["qov"] * QOV_UNIT)
        self.written.proposals(proposals)

    def _name_of(self, address: str) -> str:
        return self.uavs[self.uav_row[address]].name

    def record(self, folder: Path) -> None:
        """Write the tables."""
        accounts = {
            "party": self.consortium.parties(),
            "vehicle": {agent.name: agent.address for agent in self.vehicles},
            "uav": {agent.name: agent.address for agent in self.uavs},
        }
        self.written.write(folder, self.events, accounts)

    def summary(self, periods: int) -> dict[str, Any]:
        """The figures of the run; see docs/reference/run-folder.md."""
        flying, hovering = self.flying, self.hovering
        config = self.scenario.coordination
        there = np.isfinite(self.tracks.x[:: config.period_steps][:periods])
        return {
            "name": self.scenario.name,
            "seed": self.scenario.seed,
            "vehicles": int(there.any(axis=0).sum()),
            "vehicles_per_period": round(float(there.sum(axis=1).mean()), 2),
            "uavs": len(self.uavs),
            "zones": len(self.grid.ids),
            "periods": periods,
            "steps": config.steps,
            "served": len(flying.ever_served),
            "served_per_period": round(float(np.mean(flying.served)), 2),
            "static_served_per_period": round(float(np.mean(hovering.served)), 2),
            "mean_qou": _mean(self.qou),
            "mean_qov": _mean(self.qov),
            "coverage": flying.coverage,
            "connectivity": flying.mean("connectivity"),
            "connectivity_neighbor": flying.mean("connectivity_neighbor"),
            "served_mbps": flying.mean("served_mbps"),
            "static_coverage": hovering.coverage,
            "static_connectivity": hovering.mean("connectivity"),
            "static_served_mbps": hovering.mean("served_mbps"),
            "energy_percent": round(float(flying.fleet.battery.mean()), 4),
            "uavs_retired": int((flying.fleet.zone == 0).sum()),
            "transactions": self.host.transactions,
            "gas_used": self.host.gas_used,
            "blocks": self.consortium.chain.block_number,
            "chain_head": self.consortium.head,
            "contract": self.consortium.client.address,
            "chain_url": self.scenario.chain.url,
            "model_cids": sorted({str(self.host.cid_of(model)) for model in self.ledger.models}),
            "range_m": self.scenario.fleet.range,
            "step_seconds": config.step_seconds,
            "period_steps": config.period_steps,
            "grid": asdict(self.grid),
            "attribution": self.tracks.attribution,
            "chain_seconds": round(self.host.chain_seconds, 3),
        }


def _mean(values: list[float]) -> float | None:
    return round(float(np.mean(values)), 6) if values else None
