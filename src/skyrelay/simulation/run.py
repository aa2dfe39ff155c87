"""A whole scenario: a clock and a world around the agents, wherever these are, and the record of what they did."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from skyrelay.chain.abi import Event
from skyrelay.chain.claims import IN_NO_LOG
from skyrelay.chain.client import QOV_UNIT
from skyrelay.core.entities import IntArray, UavTable, VehicleTable
from skyrelay.core.files import write_text
from skyrelay.core.progress import Progress
from skyrelay.core.scenario import Scenario, Selection, to_toml
from skyrelay.net.http import public_address
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.authority import ReputationAuthority
from skyrelay.protocol.coordinator import ZoneCoordinator
from skyrelay.protocol.history import History, Period
from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import RESELECTION, Fix, Phase, Tick
from skyrelay.protocol.rule import Decider
from skyrelay.protocol.uav import UavAgent
from skyrelay.protocol.vehicle import Choice, VehicleAgent
from skyrelay.protocol.zone_view import ZoneView
from skyrelay.runfolder.folder import SCENARIO
from skyrelay.runfolder.manifest import write_manifest
from skyrelay.runfolder.writer import write_summary
from skyrelay.selection import select
from skyrelay.selection.methods import require_method
from skyrelay.simulation.consortium import Consortium, chain_facts
from skyrelay.simulation.flight import NOBODY
from skyrelay.simulation.payment import Cashier
from skyrelay.simulation.record import Record
from skyrelay.simulation.team import METHOD_SECONDS, Team
from skyrelay.simulation.world import World
from skyrelay.store.cid import Cid

UAV_COLUMNS = ("x", "y", "zone", "bandwidth", "battery", "reputation")

AnyScenario = TypeVar("AnyScenario", bound=Scenario)
T = TypeVar("T")


@runtime_checkable
class Hosts(Protocol):
    """Whoever hosts the agents of a run: `Host` in this process, or others elsewhere."""

    @property
    def transactions(self) -> int:
        """Mined for the agents so far."""

    @property
    def gas_used(self) -> int:
        """By these transactions."""

    @property
    def chain_seconds(self) -> float:
        """Waited for the chain so far [s]."""

    def tell(self, fixes: Mapping[str, Fix]) -> None:
        """New positions, by address."""

    def advise(self, advice: Mapping[str, str]) -> None:
        """The UAV that a method outside of the contract gives each vehicle; both by address."""

    def tick(self, tick: Tick, timestamp: int) -> None:
        """The clock, to all agents; returns when nothing is left to do about it."""

    def spread(self) -> None:
        """The beacons of this step reach those whom they are for."""

    def take_moves(self) -> dict[str, int]:
        """The actions of the UAVs that have decided since this was last called, by address."""

    def take_fixes(self) -> dict[str, Fix]:
        """Where UAVs with an airframe of their own say that they are, since this was last called, by address."""

    def choices(self) -> dict[str, Choice]:
        """What Algorithm 1 gave the vehicles in this period, by address."""

    def view(self, zone: int) -> ZoneView | None:
        """A zone as the chain has it at the latest block."""

    def cid_of(self, model: str) -> Cid:
        """Where a model's bytes are, by the contract."""


def play(
    scenario: Scenario, folder: Path, progress: Progress, finish: Callable[[Path], None] = lambda _: None
) -> dict[str, Any]:
    """Play a scenario in this process and leave its record in ``folder``.

    Args:
        finish: adds to the complete record (charts, the page) before its manifest is written and signed.
    Returns: the summary, as in ``summary.json``.
    Raises:
        TraceError, ModelError, StoreError, ChainError: naming what was wrong with what.
    """
    begin = time.monotonic()
    progress.stage("Vehicles", 1)
    world = World.of(scenario)
    write_text(folder / SCENARIO, to_toml(without_credentials(world.scenario)))
    with Consortium(world.scenario, folder) as consortium:
        run = Run(world, consortium.account)
        agents = world_agents(world, consortium.account, consortium.hangar.load)
        run.hosts = host = Host(
            agents, consortium.client, consortium.store, run.hear, relay=consortium.relay, book=consortium.book
        )
        progress.stage("Consortium and members", 1)
        founded = time.monotonic()
        consortium.found()
        host.chain_seconds += time.monotonic() - founded
        for event in consortium.client.events():
            run.hear(event)
        run.cashier = consortium.cashier(world)
        run.play(progress)
        progress.stage("Record", 1)
        facts = chain_facts(consortium.chain, consortium.client.address)
        summary = run.write(folder, consortium.parties(), consortium.deciders(), facts, begin)
        finish(folder)
        write_manifest(folder, consortium.signer)
    return summary


def world_agents(world: World, account: Callable[[str], str], load: Callable[[bytes], Decider]) -> list[Agent]:
    """An agent for every member and party of a world; ``account`` gives the address of a name."""
    scenario, fleet = world.scenario, world.fleet
    addresses = world.addresses(account)
    members, selection = world.members, scenario.selection
    signs = scenario.chain.signs
    vehicles = zip(world.tracks.ids, members.demand.tolist(), members.payment.tolist(), strict=True)
    uavs = zip(fleet.ids, fleet.zone.tolist(), fleet.bandwidth.tolist(), strict=True)
    return [
        *(
            VehicleAgent(
                name,
                addresses[name],
                demand,
                payment,
                world.law.grid,
                selection,
                signs=signs,
                tells=scenario.coordination.dispatch,
            )
            for name, demand, payment in vehicles
        ),
        *(
            UavAgent(name, addresses[name], zone, scenario.fleet.altitude, bandwidth, world.law, load)
            for name, zone, bandwidth in uavs
        ),
        *(
            ZoneCoordinator(zone, account("coordinator"), scenario.chain.proposals_per_call)
            for zone in world.law.grid.ids
        ),
        ReputationAuthority(account("reputation authority"), world.reputations(account)),
    ]


class Run:
    """The clock, the world and the record of one run; who proposes, decides and flies are the agents.

    Args:
        world: who is where.
        account: the address of a member's name.

    Attributes:
        hosts: of the agents; given before the first tick.
        cashier: settles what vehicles pay; None where they do not.
        events: of the contract, each with its step.
        written: the tables so far.
    """

    hosts: Hosts
    cashier: Cashier | None = None

    def __init__(self, world: World, account: Callable[[str], str]) -> None:
        require_method(world.scenario.selection.method)
        self.world, self.scenario, self.tracks = world, world.scenario, world.tracks
        demand, selection = world.members.demand, world.scenario.selection
        self.flying = Team(world.law, selection, world.fleet, demand)
        self.hovering = Team(world.law, selection, world.fleet.copy(), demand)
        seconds = world.scenario.coordination.step_seconds
        self.written = Record(self.tracks, world.law.grid, world.members, seconds, self.flying, self.hovering)
        self.vehicles = {name: account(name) for name in self.tracks.ids}
        self.uavs = {name: account(name) for name in world.fleet.ids}
        self.uav_row = {address: row for row, address in enumerate(self.uavs.values())}
        self._vehicle_row = {name: row for row, name in enumerate(self.vehicles)}
        flight = world.scenario.coordination
        names = {address: name for name, address in (self.vehicles | self.uavs).items()}
        self._reselections = world.scenario.reselections
        periods = -(-flight.steps // flight.period_steps)
        self.history = History(names, periods, flight.period_steps, self._reselections)
        self.events: list[tuple[int, Event]] = []
        self.step = 0
        self.shown = 0  # the step whose row is the next to show what the chain says
        self.periods = 0
        self._zones: dict[int, int] = {}  # that UAVs have changed to since they were last stationed, by row; 0: left
        self._fleet_order: list[str] = []  # names, as the zones' lists on the chain have them
        self._qou: dict[int, float] = {}  # of a period's proposals, by their order, as the vehicles told
        self._weighed: dict[str, Mapping[str, float]] = {}  # in a period: by vehicle, QoU by the UAVs' addresses
        self.qou: list[float] = []
        self.qov: list[float] = []
        self.served: set[str] = set()
        self._served_in: list[int] = []  # by period, how many vehicles
        self.there: list[set[str]] = []  # by period, the vehicles that told the chain where they are

    # The clock

    def play(self, progress: Progress) -> None:
        """All of it: the registration of every UAV, then period after period; vehicles register when they appear."""
        config = self.scenario.coordination
        progress.stage("Selection and flight", config.steps)
        self._tell_positions()
        self._tick(Phase.JOIN)
        self._tick(Phase.RATE)
        for period, start in enumerate(range(0, config.steps, config.period_steps)):
            self.select(period, start)
            for step in range(start, min(start + config.period_steps, config.steps)):
                if step in self._reselections:
                    self.reselect(period, step)
                self.fly(period, step)
                progress.advance()
            self._note_period(period)
        if self.cashier is not None:
            self.written.payments(self.cashier.settle(self._timestamp()))

    def select(self, period: int, step: int) -> None:
        """One selection period: records brought up to date, proposals, allocation, a policy for each zone."""
        self.periods = period + 1
        if self.cashier is not None:
            self.written.payments(self.cashier.settle(self._timestamp()))
        self._tick(Phase.CLOSE, period)
        self._land(period)
        self._tick(Phase.REPORT, period)
        if self.scenario.coordination.dispatch or self.world.law.places:
            self._tick(Phase.DISPATCH, period)
            self._station()
        self._tick(Phase.RATE, period)
        if self.cashier is not None:
            self.cashier.deposit(np.flatnonzero(np.isfinite(self.tracks.x[step])), self._timestamp())
        views = [view for zone in self.world.law.grid.ids if (view := self.hosts.view(zone)) is not None]
        self._fleet_order = [self._name_of(address) for view in views for address in view.uavs.ids]
        if self.scenario.selection.method != "two-sided":
            self.hosts.advise(self._advice(views, period, step))
        proposals = self.history.periods[period].proposals
        for round_ in range(1, self.scenario.selection.rounds + 1):
            before = len(proposals)
            self._tick(Phase.PROPOSE, period, round_)
            self._note_choices(period)
            if len(proposals) == before:
                break
            self._tick(Phase.ALLOCATE, period, round_)
            self._note_choices(period)
        self._tick(Phase.DETERMINE, period)
        self._note_choices(period)
        self.flying.assign(self._owner(period))
        if self.cashier is not None:
            self.cashier.open(period, self._owner(period), self._timestamp())
        self.hovering.assign(
            self.hovering.selection(self.tracks, self.world.members, step, self.scenario.seed + period)
        )
        if step == 0:
            self.written.step(0)

    def reselect(self, period: int, step: int) -> None:
        """Within a period: who left gives its UAV up, and who has none asks those that have room."""
        for phase in RESELECTION:
            self._tick(phase, period)
            self._note_choices(period)
        self.hovering.correct(self.hovering.reselection(self.tracks, self.world.members, step))

    def fly(self, period: int, step: int) -> None:
        """From ``step`` to the next: UAVs decide on what they were told, everyone moves, the result is measured."""
        self._tick(Phase.BEACON, period)
        self.hosts.spread()
        self._tick(Phase.DECIDE, period)
        self.flying.flight.correct(self._by_row(self.hosts.take_fixes()))
        self.flying.flight.move(self._by_row(self.hosts.take_moves()))
        self.hovering.flight.move({})
        self.step = step + 1
        self._tell_positions()
        self._land(period)
        self.flying.correct(self._owner(period))
        carried = self.written.step(self.step)
        if self.cashier is not None:
            self.cashier.carry(carried)

    def _tick(self, phase: Phase, period: int = 0, round_: int = 1) -> None:
        now = self.step * self.scenario.coordination.step_seconds
        # A step's row is written before its beacons: what is heard with them shows in the next one.
        self.shown = self.step + (phase in {Phase.BEACON, Phase.DECIDE})
        self.hosts.tick(Tick(phase, period, round_, self.step, now), self._timestamp())

    def _timestamp(self) -> int:
        """Of the embedded chain's next blocks [s]."""
        return 1 + math.floor(self.step * self.scenario.coordination.step_seconds)

    def _land(self, period: int) -> None:
        """UAVs whose battery lasts no longer leave: the flying fleet's by the chain, the comparator's do not ask."""
        self._tick(Phase.LAND, period)
        self._station()
        self.hovering.flight.retire(self.hovering.flight.spent())

    def _by_row(self, told: Mapping[str, T]) -> dict[int, T]:
        """Of what hosts say, by address, that which is of UAVs of this run."""
        return {self.uav_row[uav]: what for uav, what in told.items() if uav in self.uav_row}

    def _station(self) -> None:
        """UAVs fly in the zones that the chain has them in by now."""
        self.flying.flight.station(self._zones)
        self._zones.clear()

    # The world

    def _tell_positions(self) -> None:
        """Every member's receiver has a new position."""
        x, y = self.tracks.x[self.step].tolist(), self.tracks.y[self.step].tolist()
        fixes = {
            address: Fix(None if math.isnan(x[row]) else (x[row], y[row]))
            for row, address in enumerate(self.vehicles.values())
        }
        fleet = self.flying.fleet
        x, y, battery = fleet.x.tolist(), fleet.y.tolist(), fleet.battery.tolist()
        for address, row in self.uav_row.items():
            fixes[address] = Fix((x[row], y[row]), battery[row])
        self.hosts.tell(fixes)

    # A method outside of the contract

    def _advice(self, views: Sequence[ZoneView], period: int, step: int) -> dict[str, str]:
        """The UAV that the method gives each vehicle, from the records that the contract has and the demands."""
        rows = np.flatnonzero(np.isfinite(self.tracks.x[step]))
        addresses, members = list(self.vehicles.values()), self.world.members
        x, y = self.tracks.x[step, rows], self.tracks.y[step, rows]
        vehicles = VehicleTable(
            ids=tuple(addresses[row] for row in rows),
            x=np.round(x, 1),
            y=np.round(y, 1),
            zone=self.world.law.grid.zone_of(x, y),
            demand=members.demand[rows].astype(np.float64),
            payment=members.payment[rows].astype(np.float64),
            reputation=members.reputation[rows],
        )
        there = [view.uavs for view in views if len(view.uavs)]
        if not there:
            return {}
        columns = {name: np.concatenate([getattr(uavs, name) for uavs in there]) for name in UAV_COLUMNS}
        uavs = UavTable(ids=tuple(address for table in there for address in table.ids), **columns)
        chosen = select(
            vehicles,
            uavs,
            settings=self.scenario.selection,
            seed=self.scenario.seed + period,
            time_limit=METHOD_SECONDS,
            within=True,
        ).assignment
        return {vehicle: uavs.ids[uav] for vehicle, uav in zip(vehicles.ids, chosen.tolist(), strict=True) if uav >= 0}

    # The record

    def hear(self, event: Event) -> None:
        """Note an event of the contract, or one that a claim stands for, which is in no log."""
        if event.index != IN_NO_LOG:
            self.events.append((self.shown, event))
        self.history.hear(event, self.shown)
        if event.name == "UAVZoneUpdated":
            self._zones[self.uav_row[event.args["uav"]]] = event.args["to"]

    def _owner(self, period: int) -> IntArray:
        """[V] the row of the UAV that serves each vehicle by now, or -1."""
        served = self.history.periods[period].served
        owner = np.full(len(self.vehicles), NOBODY)
        for vehicle, uav in served.items():
            owner[self._vehicle_row[vehicle]] = self.uav_row[self.uavs[uav]]
        return owner

    def _note_choices(self, period: int) -> None:
        """Whom each vehicle weighed, in every round the same, and the QoU of whom it has asked."""
        choices = self.hosts.choices()
        for name, address in self.vehicles.items():
            if address in choices and choices[address].weighed and self.step not in self._reselections:
                self._weighed[name] = choices[address].weighed
        for row in self.history.periods[period].proposals:
            choice = choices.get(self.vehicles[row["vehicle"]])
            if row["order"] not in self._qou and choice is not None:
                uav = self.uavs[row["uav"]]
                self._qou[row["order"]] = choice.qou if choice.uav == uav else choice.weighed.get(uav, 0.0)

    def _note_period(self, period: int) -> None:
        """The records that the period's selection worked with, its proposals, and QoU and QoV of those accepted."""
        self.history.open(period)
        told = self.history.periods[period]
        place = {name: number for number, name in enumerate(self._fleet_order)}
        fleet = sorted(told.fleet.items(), key=lambda one: place.get(one[0], len(place)))
        members = sorted(told.members.items(), key=lambda one: self._vehicle_row[one[0]])
        self.written.period(period, fleet, members)
        for name in filter(self._weighed.__contains__, self.vehicles):
            weighed = {self._name_of(uav): value for uav, value in self._weighed[name].items() if uav in self.uav_row}
            self.written.candidates(period, name, weighed)
        for row in told.proposals:
            row["qou"] = self._qou.get(row["order"], 0.0)
            if row["accepted"]:
                self.qou.append(row["qou"])
                self.qov.append(row["qov"] * QOV_UNIT)
        self.written.proposals(told.proposals)
        served = {row["vehicle"] for row in told.proposals if row["accepted"]}
        self.served |= served
        self._served_in.append(len(served))
        self.there.append(set(told.members))
        self.history.periods[period] = Period()  # it is written: a long run does not hold on to it
        self._qou.clear()
        self._weighed.clear()

    def _name_of(self, address: str) -> str:
        return self.world.fleet.ids[self.uav_row[address]]

    def write(
        self,
        folder: Path,
        parties: Mapping[str, str],
        deciders: Mapping[str, str],
        facts: Mapping[str, Any],
        begin: float,
    ) -> dict[str, Any]:
        """Write the tables and the summary, and return this.

        Args:
            parties: addresses of those with a role, by name.
            deciders: names of the policies and rules that UAVs may have flown by, by CID.
            facts: of the chain (`chain_facts`).
            begin: when the run began (`time.monotonic`).
        """
        accounts = {"party": dict(parties), "vehicle": self.vehicles, "uav": self.uavs}
        self.written.streets(self.world.streets)
        self.written.write(folder, self.events, accounts)
        summary = self.summary()
        summary |= {
            "decided_by": [deciders[cid] for cid in summary["model_cids"]],
            **facts,
            "wall_seconds": round(time.monotonic() - begin, 3),
        }
        write_summary(folder, summary)
        return summary

    def summary(self) -> dict[str, Any]:
        """The figures of the run; see docs/reference/run-folder.md."""
        flying, hovering = self.flying, self.hovering
        config = self.scenario.coordination
        return {
            "name": self.scenario.name,
            "seed": self.scenario.seed,
            "vehicles": len(set().union(*self.there)),
            "vehicles_per_period": round(float(np.mean([len(there) for there in self.there])), 2),
            "uavs": len(self.uavs),
            "zones": len(self.world.law.grid.ids),
            "periods": self.periods,
            "steps": config.steps,
            "served": len(self.served),
            "served_per_period": round(float(np.mean(self._served_in)), 2),
            "static_served_per_period": round(float(np.mean(list(map(len, hovering.served)))), 2),
            "mean_qou": _mean(self.qou),
            "mean_qov": _mean(self.qov),
            **self.written.figures(),
            "uavs_retired": int(flying.fleet.spent.sum()),
            **(self.written.charging_figures() if self.world.law.places else {}),
            "transactions": self.hosts.transactions,
            "gas_used": self.hosts.gas_used,
            "chain_url": without_credentials(self.scenario).chain.url,
            "selected_by": _selected_by(self.scenario.selection),
            "model_cids": sorted({str(self.hosts.cid_of(model)) for model in self.history.models}),
            "range_m": self.scenario.fleet.range,
            "step_seconds": config.step_seconds,
            "period_steps": config.period_steps,
            "grid": asdict(self.world.law.grid),
            "attribution": self.tracks.attribution,
            "trace_notes": list(self.tracks.notes),
            "chain_seconds": round(self.hosts.chain_seconds, 3),
        }


def _selected_by(selection: Selection) -> str:
    """Which method selected, and what of it the contract has checked."""
    if selection.method == "two-sided":
        return f"two-sided, {selection.rounds} rounds, by the contract"
    return f"{selection.method}, worked out outside the contract, which checked candidates and bandwidth only"


def _mean(values: list[float]) -> float | None:
    return round(float(np.mean(values)), 6) if values else None


def without_credentials(scenario: AnyScenario) -> AnyScenario:
    """The scenario as a folder may hold it: of addresses, no name, password or token."""

    def shown(urls: str | None) -> str | None:
        return None if urls is None else ", ".join(public_address(url) for url in urls.split(","))

    chain = scenario.chain.model_copy(update={"url": shown(scenario.chain.url)})
    store = scenario.store.model_copy(update={"url": shown(scenario.store.url)})
    return scenario.model_copy(update={"chain": chain, "store": store})
