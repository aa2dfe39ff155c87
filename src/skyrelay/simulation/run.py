"""A whole scenario, in the order of the paper's process sequence: register, select, fetch the policy, fly, repeat."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from skyrelay.chain.abi import Event
from skyrelay.chain.chain import Call
from skyrelay.chain.client import QOV_UNIT
from skyrelay.core.files import write_text
from skyrelay.core.progress import Progress
from skyrelay.core.scenario import Scenario, to_toml
from skyrelay.core.zones import ZoneGrid
from skyrelay.mobility import Tracks, load_tracks
from skyrelay.policy import Policy
from skyrelay.protocol.coordinator import ZoneCoordinator
from skyrelay.protocol.sequence import UavState, VehicleState, ZoneState
from skyrelay.protocol.uav import UavAgent
from skyrelay.protocol.vehicle import VehicleAgent
from skyrelay.protocol.zone_view import ZoneView, read_zone
from skyrelay.simulation.consortium import Consortium
from skyrelay.simulation.flight import NOBODY
from skyrelay.simulation.record import Record
from skyrelay.simulation.team import Team
from skyrelay.simulation.world import deploy_fleet, draw_members

REPUTATIONS_PER_CALL = 100
P = ParamSpec("P")
T = TypeVar("T")


def resolve(scenario: Scenario, grid: ZoneGrid) -> Scenario:
    """The scenario with what depends on the area filled in: the range, and the distance gate no further than it."""
    reach = scenario.fleet.range if scenario.fleet.range is not None else grid.side / 2
    # Down to the contract's 0.1 m, so that what a vehicle takes for a candidate the contract does too.
    gate = math.floor(min(scenario.selection.max_distance, reach) * 10) / 10
    return scenario.model_copy(
        update={
            "fleet": scenario.fleet.model_copy(update={"range": reach}),
            "selection": scenario.selection.model_copy(update={"max_distance": gate}),
        }
    )


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
    scenario = resolve(scenario, grid)
    write_text(folder / "scenario.toml", to_toml(scenario))
    config = scenario.coordination
    starts = range(0, config.steps, config.period_steps)
    with Consortium(scenario, folder) as consortium:
        run = _Run(scenario, tracks, grid, consortium)
        progress.stage("Consortium and members", 1)
        run.found()
        progress.stage("Selection and flight", config.steps)
        for period, start in enumerate(starts):
            run.select(period, start)
            for step in range(start + 1, min(start + config.period_steps, config.steps) + 1):
                run.fly(step)
                progress.advance()
        progress.stage("Record", 1)
        summary = run.summary(len(starts)) | {"wall_seconds": round(time.monotonic() - begin, 3)}
        run.record(folder)
    write_text(folder / "summary.json", json.dumps(summary, indent=2) + "\n")
    return summary


class _Run:
    """What lives as long as a run does."""

    def __init__(self, scenario: Scenario, tracks: Tracks, grid: ZoneGrid, consortium: Consortium) -> None:
        self.scenario, self.tracks, self.grid, self.consortium = scenario, tracks, grid, consortium
        self.client = consortium.client
        self.members = draw_members(scenario, len(tracks.ids))
        fleet = deploy_fleet(scenario, tracks, grid)
        self.flying = Team(scenario, fleet, grid, self.members.demand)
        self.hovering = Team(scenario, fleet.copy(), grid, self.members.demand)
        seconds = scenario.coordination.step_seconds
        self.written = Record(tracks, grid, self.members, seconds, self.flying, self.hovering)
        self.vehicles = [
            VehicleAgent(name, consortium.account(name), int(demand), int(payment), scenario.selection)
            for name, demand, payment in zip(tracks.ids, self.members.demand, self.members.payment, strict=True)
        ]
        self.uavs = [
            UavAgent(
                name,
                consortium.account(name),
                scenario.fleet.altitude,
                int(bandwidth),
                consortium.store,
                consortium.hangar.load,
            )
            for name, bandwidth in zip(fleet.ids, fleet.bandwidth, strict=True)
        ]
        self.vehicle_row = {agent.address: row for row, agent in enumerate(self.vehicles)}
        self.uav_row = {agent.address: row for row, agent in enumerate(self.uavs)}
        self.coordinators = {
            zone: ZoneCoordinator(zone, consortium.coordinator, scenario.chain.proposals_per_call) for zone in grid.ids
        }
        self.events: list[tuple[int, Event]] = []
        self.submissions = 0
        self.transactions = self.gas_used = 0
        self.chain_seconds = 0.0
        self.qou: list[float] = []
        self.qov: list[float] = []
        self.cids: set[str] = set()

    # The stages

    def found(self) -> None:
        """Roles, models, and the registration of every UAV; vehicles register when they appear."""
        self._timed(self.consortium.found)
        self.events += [(0, event) for event in self.client.events()]
        fleet = self.flying.fleet
        self._execute(
            [
                agent.register(
                    self.client,
                    fleet.x[row].item(),
                    fleet.y[row].item(),
                    fleet.battery[row].item(),
                    int(fleet.zone[row]),
                )
                for row, agent in enumerate(self.uavs)
            ],
            step=0,
        )
        self._set_reputations(
            {agent.address: value.item() for agent, value in zip(self.uavs, fleet.reputation, strict=True)}, step=0
        )

    def select(self, period: int, step: int) -> None:
        """One selection period: records brought up to date, proposals, allocation, a policy for each zone."""
        self._close_period(step)
        self._retire_spent(step)
        self._report_positions(step)
        views = self._views()
        self.written.period(period, step, views.values(), self._name_of)
        proposals: list[dict[str, Any]] = []
        for round_ in range(1, self.scenario.selection.rounds + 1):
            if round_ > 1:
                views = {zone: replace(view, round=self._round_of(zone)) for zone, view in views.items()}
            submitted = self._propose(period, round_, step, views)
            if not submitted:
                break
            proposals += submitted
            self._allocate({row["zone"] for row in submitted}, step)
        self._note_accepted(proposals)
        self.written.proposals(proposals)
        owner = np.array(
            [
                self.uav_row[agent.uav] if agent.state is VehicleState.SERVED and agent.uav else NOBODY
                for agent in self.vehicles
            ]
        )
        self.flying.assign(owner, self._equip(step))
        self.hovering.assign(self.hovering.selection(self.tracks, self.members, step), {})
        if step == 0:
            self.written.step(0)

    def fly(self, step: int) -> None:
        """From ``step - 1`` to ``step``: UAVs decide on what they see, everyone moves, the result is measured."""
        x, y = self.tracks.x[step - 1], self.tracks.y[step - 1]
        for team in (self.flying, self.hovering):
            team.flight.step(x, y)
        self._retire_spent(step)
        self.written.step(step)

    # Selection

    def _close_period(self, step: int) -> None:
        """resetListsForZone() where a period is open; everyone is free again."""
        zones = [c for c in self.coordinators.values() if c.machine.state is not ZoneState.COLLECTING]
        self._execute([coordinator.reset(self.client) for coordinator in zones], step)
        for vehicle in self.vehicles:
            vehicle.end_period()
        for uav in self.uavs:
            uav.end_period()

    def _retire_spent(self, step: int) -> None:
        """UAVs with an empty battery leave: the flying fleet's on the chain, the comparator's in the air only."""
        rows = self.flying.flight.spent()
        self._execute([self.uavs[row].retire(self.client) for row in rows], step)
        self.flying.flight.retire(rows)
        self.hovering.flight.retire(self.hovering.flight.spent())

    def _report_positions(self, step: int) -> None:
        """Everyone who is there tells the contract where: registerVehicle(), updateVehicleInfo(), updateUAVInfo()."""
        x, y = self.tracks.x[step].round(1), self.tracks.y[step].round(1)
        there = np.isfinite(x)
        zone = self.grid.zone_of(np.nan_to_num(self.tracks.x[step]), np.nan_to_num(self.tracks.y[step]))
        new = [row for row in np.flatnonzero(there) if self.vehicles[row].state is VehicleState.NEW]
        calls = []
        for row, agent in enumerate(self.vehicles):
            if there[row]:
                calls.append(agent.report(self.client, x[row].item(), y[row].item(), int(zone[row])))
            else:
                agent.leave()
        fleet = self.flying.fleet
        calls += [
            agent.update(self.client, fleet.x[row].item(), fleet.y[row].item(), fleet.battery[row].item())
            for row, agent in enumerate(self.uavs)
            if agent.state is UavState.AVAILABLE
        ]
        self._execute(calls, step)
        self._set_reputations({self.vehicles[row].address: self.members.reputation[row].item() for row in new}, step)

    def _set_reputations(self, reputations: dict[str, float], step: int) -> None:
        """The consortium's authority gives new members what the scenario draws (the paper's uniform reputations)."""
        members = list(reputations)
        pieces = [members[i : i + REPUTATIONS_PER_CALL] for i in range(0, len(members), REPUTATIONS_PER_CALL)]
        authority = self.consortium.authority
        self._execute(
            [self.client.set_reputations(authority, {m: reputations[m] for m in piece}) for piece in pieces], step
        )

    def _views(self) -> dict[int, ZoneView]:
        """What vehicles read of their zones; every vehicle of a zone reads the same block."""
        read = {zone: self._timed(read_zone, self.client, zone) for zone in self.grid.ids}
        return {zone: view for zone, view in read.items() if view is not None}

    def _round_of(self, zone: int) -> int:
        info = self._timed(self.client.zone_info, zone)
        if info is None:
            raise RuntimeError(f"zone {zone} was there a moment ago")
        return int(info.round)

    def _propose(self, period: int, round_: int, step: int, views: dict[int, ZoneView]) -> list[dict[str, Any]]:
        """Algorithm 1 at every vehicle without a UAV, then submitVehSelection()."""
        zone = self.grid.zone_of(np.nan_to_num(self.tracks.x[step]), np.nan_to_num(self.tracks.y[step]))
        calls: list[Call] = []
        rows: list[dict[str, Any]] = []
        for row, agent in enumerate(self.vehicles):
            view = views.get(int(zone[row]))
            if view is None or agent.state not in {VehicleState.IDLE, VehicleState.UNSERVED}:
                continue
            choice = agent.choose(view)
            if round_ == 1 and choice.weighed:
                weighed = {self._name_of(address): value for address, value in choice.weighed.items()}
                self.written.candidates(period, agent.name, weighed)
            if choice.uav is not None:
                calls.append(agent.submit(self.client, choice.uav, view))
                rows.append({"vehicle": row, "uav": self.uav_row[choice.uav], "zone": view.zone, "qou": choice.qou})
        submitted = [e.args for e in self._execute(calls, step) if e.name == "VehSelectionSubmitted"]
        for entry, args in zip(rows, submitted, strict=True):
            order, self.submissions = self.submissions, self.submissions + 1
            entry |= {"period": period, "round": round_, "qov": args["qov"], "score": args["score"], "order": order}
        return rows

    def _allocate(self, zones: set[int], step: int) -> None:
        """allocateZone() in pieces until every zone is decided; vehicles and UAVs learn the result."""
        pending = sorted(zones)
        for zone in pending:
            if self.coordinators[zone].machine.state is ZoneState.ALLOCATED:
                self.coordinators[zone].open_round()
        held: dict[str, list[str]] = {}
        while pending:
            events = self._execute([self.coordinators[zone].allocate(self.client) for zone in pending], step)
            for event in events:
                if event.name == "UAVAllocated":
                    held[event.args["uav"]] = event.args["selected"]
                    self.uavs[self.uav_row[event.args["uav"]]].learn(len(event.args["selected"]))
            done = {event.args["zone"] for event in events if event.name == "ZoneAllocated"}
            for zone in done:
                self.coordinators[zone].allocated()
            pending = [zone for zone in pending if zone not in done]
        for agent in self.vehicles:
            if agent.state in {VehicleState.PROPOSED, VehicleState.SERVED} and agent.uav in held:
                agent.learn(agent.address in held[agent.uav])

    def _equip(self, step: int) -> dict[int, Policy]:
        """determineMDRLModel() for every zone with a team; each of its UAVs fetches the policy by CID and checks it."""
        teams: dict[int, list[UavAgent]] = {}
        for row, agent in enumerate(self.uavs):
            if agent.state is UavState.SELECTED:
                teams.setdefault(int(self.flying.fleet.zone[row]), []).append(agent)
        events = self._execute([self.coordinators[zone].determine_model(self.client) for zone in sorted(teams)], step)
        policies = {}
        for event in events:
            if event.name == "ModelAssigned":
                cid = self._timed(self.consortium.cid_of_model, event.args["modelId"])
                self.cids.add(str(cid))
                for agent in teams[event.args["zone"]]:
                    policies[event.args["zone"]] = agent.equip(cid)
        return policies

    def _note_accepted(self, proposals: Sequence[dict[str, Any]]) -> None:
        """Of a period's proposals, whether each UAV held on to them to the end; QoU and QoV of those it did."""
        last = {row["vehicle"]: row["order"] for row in proposals}
        for row in proposals:
            served = self.vehicles[row["vehicle"]].state is VehicleState.SERVED
            row["accepted"] = served and last[row["vehicle"]] == row["order"]
            if row["accepted"]:
                self.qou.append(row["qou"])
                self.qov.append(row["qov"] * QOV_UNIT)

    # The chain

    def _execute(self, calls: Sequence[Call], step: int) -> list[Event]:
        """Have calls mined at a step's time; all of them must succeed."""
        if not calls:
            return []
        timestamp = 1 + math.floor(step * self.scenario.coordination.step_seconds)
        receipts = self._timed(self.client.execute, calls, timestamp)
        for receipt in receipts:
            self.gas_used += receipt.gas_used
        self.transactions += len(receipts)
        events = self.client.events_of(receipts)
        self.events += [(step, event) for event in events]
        return events

    def _timed(self, ask: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call, and count the time as the chain's."""
        begin = time.monotonic()
        try:
            return ask(*args, **kwargs)
        finally:
            self.chain_seconds += time.monotonic() - begin

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
            "transactions": self.transactions,
            "gas_used": self.gas_used,
            "blocks": self.consortium.chain.block_number,
            "chain_head": self.consortium.head,
            "contract": self.client.address,
            "chain_url": self.scenario.chain.url,
            "model_cids": sorted(self.cids),
            "range_m": self.scenario.fleet.range,
            "step_seconds": config.step_seconds,
            "period_steps": config.period_steps,
            "grid": asdict(self.grid),
            "attribution": self.tracks.attribution,
            "chain_seconds": round(self.chain_seconds, 3),
        }


def _mean(values: Sequence[float]) -> float | None:
    return round(float(np.mean(values)), 6) if values else None
