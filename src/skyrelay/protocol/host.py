"""Hosts agents: hands them what concerns them, and carries out what they want done, on a chain and a store."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import ParamSpec, TypeVar

from skyrelay.airspace.law import Law
from skyrelay.airspace.sight import Sight
from skyrelay.chain.abi import Event
from skyrelay.chain.chain import Call, Receipt
from skyrelay.chain.client import IovClient, Model
from skyrelay.core.errors import ModelError, SkyRelayError, StoreError
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.calls import to_call
from skyrelay.protocol.claims import ClaimBook
from skyrelay.protocol.dispatch import Books
from skyrelay.protocol.messages import (
    Advised,
    AllocateZone,
    Beacon,
    ChainCall,
    Command,
    Decide,
    Decided,
    FetchModel,
    Fix,
    LeftOut,
    Mined,
    ModelFetched,
    ModelRead,
    Move,
    Offer,
    Phase,
    ReadModel,
    ReadStation,
    ReadZone,
    Refused,
    SendBeacon,
    StationRead,
    Tick,
    ZoneRead,
)
from skyrelay.protocol.relay import Relay
from skyrelay.protocol.rotation import stations
from skyrelay.protocol.rule import Decider, Rule
from skyrelay.protocol.sight import decide
from skyrelay.protocol.vehicle import Choice, VehicleAgent
from skyrelay.protocol.zone_view import ZoneView, read_zone
from skyrelay.store.cid import Cid
from skyrelay.store.model_store import ModelStore

P = ParamSpec("P")
T = TypeVar("T")
Wish = tuple[Agent, Command]


class Host:
    """Agents that share a process, though nothing of what they know.

    What they want of the contract at one tick is mined together, in the order of the agents.

    Args:
        agents: in the order in which they are asked.
        client: the contract.
        store: where policies come from; whatever it answers has been hashed again.
        heard: is called with every event, after the agents have heard it.
        refused: is called with every call that the contract refuses, after its agent has been told, and with every
            policy that cannot be had, does not fit or fails in flight, whose UAV then hovers; None: it raises.
        relay: hands in what the vehicles here sign; None where none of them does.
        book: of the coordinator here, where it claims what they sign instead; None: the contract decides.
        alone: whether nobody else writes to the contract, so that what is mined here is all there is to hear.

    Attributes:
        transactions, gas_used, chain_seconds: so far.
    """

    def __init__(
        self,
        agents: Sequence[Agent],
        client: IovClient,
        store: ModelStore,
        heard: Callable[[Event], None],
        refused: Callable[[Agent, SkyRelayError], None] | None = None,
        *,
        relay: Relay | None = None,
        book: ClaimBook | None = None,
        alone: bool = True,
    ) -> None:
        self.client, self.store = client, store
        self._refused, self._alone, self._next_block = refused, alone, 0
        self._relay, self._book = relay, book
        self.agents = list(agents)
        self.transactions = self.gas_used = 0
        self.chain_seconds = 0.0
        self._heard = heard
        self._named = {agent.address: agent for agent in agents}
        self._hearers: dict[str, list[Agent]] = defaultdict(list)
        for agent in agents:
            for name in agent.HEARS:
                self._hearers[name].append(agent)
        self._views: dict[int, ZoneView | None] = {}
        self._models: dict[str, Model] = {}
        self._books = Books()
        self._moves_between: dict[str, int] | None = None  # by UAV; worked out when first asked for
        self._beacons: list[Beacon] = []
        self._moves: dict[str, int] = {}

    # What comes in

    def tick(self, tick: Tick, timestamp: int | None = None) -> None:
        """The clock, to all agents; returns when nothing is left to do about it.

        Args:
            timestamp: of the blocks on the embedded chain [s].
        """
        if not self._alone:
            self._settle(self._route(self._news()), timestamp)
        self._settle([(agent, command) for agent in self.agents for command in agent.receive(tick)], timestamp)

    def catch_up(self) -> None:
        """Let agents that begin, or begin again, hear what has been; what they would have done about it is done."""
        self._route(self._news())

    def undone(self, phase: Phase) -> bool:
        """Whether the contract still lacks something that an agent here would do in a phase."""
        return any(agent.undone(phase) for agent in self.agents)

    def tell(self, fixes: Mapping[str, Fix]) -> None:
        """New positions, by address, each to whose receiver it is."""
        for agent in self.agents:
            if agent.address in fixes:
                agent.receive(fixes[agent.address])

    def advise(self, advice: Mapping[str, str]) -> None:
        """Tell every vehicle here the UAV that a method outside of the contract gives it; both by address."""
        for agent in self.agents:
            if isinstance(agent, VehicleAgent):
                agent.receive(Advised(advice.get(agent.address)))

    def spread(self) -> None:
        """Every beacon sent here reaches everyone here whom it is for."""
        self.hear(self.take_beacons())

    def hear(
        self, beacons: Iterable[Beacon], reaches: Callable[[Beacon, Agent], bool] = lambda _beacon, _agent: True
    ) -> None:
        """Beacons, each to whom it is for: the UAV that a vehicle tells, or the other UAVs of a UAV's zone.

        Args:
            reaches: whether a beacon gets as far as an agent that it is for.
        """
        tuned_in: dict[int, list[Agent | None]] = defaultdict(list)
        for agent in self.agents:
            if agent.tuned_in:
                tuned_in[agent.tuned_in].append(agent)
        for beacon in beacons:
            hearers = tuned_in[beacon.zone] if beacon.to is None else [self._named.get(beacon.to)]
            for hearer in hearers:
                if hearer is not None and hearer.address != beacon.sender and reaches(beacon, hearer):
                    hearer.receive(beacon)

    # What goes out

    def take_fixes(self) -> dict[str, Fix]:
        """None: no UAV of this process has an airframe of its own."""
        return {}

    def choices(self) -> dict[str, Choice]:
        """What Algorithm 1 gave the vehicles here in this period, by address."""
        return {
            agent.address: agent.choice
            for agent in self.agents
            if isinstance(agent, VehicleAgent) and agent.choice is not None
        }

    def take_beacons(self) -> list[Beacon]:
        """What the agents have sent since this was last called."""
        beacons, self._beacons = self._beacons, []
        return beacons

    def take_moves(self) -> dict[str, int]:
        """The actions of the UAVs that have decided since this was last called, by address."""
        moves, self._moves = self._moves, {}
        return moves

    def view(self, zone: int) -> ZoneView | None:
        """A zone as the chain has it at the latest block; its members all read the same."""
        if zone not in self._views:
            self._views[zone] = self._timed(read_zone, self.client, zone)
        return self._views[zone]

    def model(self, model_id: str) -> Model:
        """A model as the contract has it at the latest block."""
        if model_id not in self._models:
            self._models[model_id] = self._timed(self.client.model, model_id)
        return self._models[model_id]

    def cid_of(self, model: str) -> Cid:
        """Where a model's bytes are, by the contract."""
        return Cid.from_bytes(self.model(model).cid, f"model {model}")

    # Within

    def _settle(self, wishes: Sequence[Wish], timestamp: int | None) -> None:
        """Carry out what is wanted, and what is wanted because of that, until nothing is."""
        while wishes:
            calls: list[tuple[Agent, ChainCall]] = []
            offers: list[tuple[Agent, Offer]] = []
            undecided: list[tuple[Agent, Decide]] = []
            for agent, command in wishes:
                self._carry_out(agent, command, calls, offers, undecided)
            self._decide(undecided)
            wishes = self._hand_in(offers, timestamp) if offers else []
            if not calls:
                continue
            receipts = self._mine([self._call_of(agent, call) for agent, call in calls], timestamp)
            wishes += self._route(self._told(self.client.events_of(receipts)) if self._alone else self._news())
            for (agent, call), receipt in zip(calls, receipts, strict=True):
                wishes += [(agent, wish) for wish in self._answer(agent, call, receipt)]

    def _carry_out(
        self,
        agent: Agent,
        command: Command,
        calls: list[tuple[Agent, ChainCall]],
        offers: list[tuple[Agent, Offer]],
        undecided: list[tuple[Agent, Decide]],
    ) -> None:
        """Do what can be done at once; note calls and offers, and decisions, each to be dealt with together."""
        match command:
            case ReadZone(zone):
                answer: Sequence[Command] = agent.receive(ZoneRead(self.view(zone)))
            case ReadStation(law):
                answer = agent.receive(StationRead(self._stations(law).get(agent.address)))
            case ReadModel() | FetchModel():
                answer = self._equip(agent, command)
            case SendBeacon(beacon):
                self._beacons.append(beacon)
                return
            case Move(action):
                self._moves[agent.address] = action
                return
            case Decide():
                undecided.append((agent, command))
                return
            case Offer():
                offers.append((agent, command))
                return
            case _:
                calls.append((agent, command))
                return
        for wish in answer:
            self._carry_out(agent, wish, calls, offers, undecided)

    def _equip(self, agent: Agent, command: ReadModel | FetchModel) -> Sequence[Command]:
        """Give a UAV what it asks for to have its zone's policy."""
        try:
            if isinstance(command, ReadModel):
                return agent.receive(ModelRead(self.model(command.model)))
            return agent.receive(ModelFetched(command.cid, self.store.get(command.cid)))
        except (ModelError, StoreError) as error:
            self._excuse([agent], error)
            return ()

    def _excuse(self, agents: Sequence[Agent], error: ModelError | StoreError) -> None:
        """One policy must not end the flight of all others here: who would fly by it hovers, and asks for it again.

        Raises:
            ModelError, StoreError: nobody here takes such errors.
        """
        if self._refused is None:
            raise error
        for agent in agents:
            self._refused(agent, error)

    def _decide(self, undecided: Sequence[tuple[Agent, Decide]]) -> None:
        """One run of the network for all UAVs that fly the same policy, each on its own sight."""
        by_policy: dict[Decider, list[tuple[Agent, Sight]]] = defaultdict(list)
        for agent, command in undecided:
            by_policy[command.policy].append((agent, command.sight))
        for policy, group in by_policy.items():
            sights = [sight for _, sight in group]
            try:
                actions = policy.decide(sights) if isinstance(policy, Rule) else decide(policy, sights)
            except ModelError as error:
                self._excuse([agent for agent, _ in group], error)
                continue
            for (agent, _), action in zip(group, actions, strict=True):
                for wish in agent.receive(Decided(action)):
                    self._carry_out(agent, wish, [], [], [])

    def _hand_in(self, offers: Sequence[tuple[Agent, Offer]], timestamp: int | None) -> list[Wish]:
        """Have the relayer hand in what vehicles offer; each hears whether the contract has taken it."""
        if self._relay is None:
            raise RuntimeError("vehicles that sign need a relayer")
        signed = self._timed(self._relay.sign, self.client, [(agent.address, offer) for agent, offer in offers])
        if self._book is None:
            receipts = self._mine(self._relay.calls(self.client, signed), timestamp)
            events = self.client.events_of(receipts)
        else:
            events = self._timed(self._book.take, signed)
        taken = {event.args["vehicle"] for event in events if event.name == "VehSelectionSubmitted"}
        wishes = self._route(events if self._alone else self._news())
        for agent, offer in offers:
            answer = Mined(offer) if agent.address in taken else LeftOut(offer)
            wishes += [(agent, wish) for wish in agent.receive(answer)]
        return wishes

    def _call_of(self, agent: Agent, call: ChainCall) -> Call:
        """The transaction for what an agent wants; an allocation is a claim where there is a book of them."""
        if self._book is not None and isinstance(call, AllocateZone):
            return self._timed(self._book.call, agent.address, call.zone)
        return to_call(call, agent.address, self.client)

    def _told(self, events: Sequence[Event]) -> list[Event]:
        """The contract's events, and what claims among them stand for."""
        if self._book is None:
            return list(events)
        told: list[Event] = []
        for event in events:
            if event.name == "ZoneAllocated":
                told += self._book.decided(event.args["zone"], event)
            told.append(event)
        return told

    def _answer(self, agent: Agent, call: ChainCall, receipt: Receipt) -> Sequence[Command]:
        """Tell an agent what became of its call."""
        if receipt.status:
            return agent.receive(Mined(call))
        error = self.client.refusal(to_call(call, agent.address, self.client), receipt)
        if self._refused is None:
            raise error
        wishes = agent.receive(Refused(call, error))
        self._refused(agent, error)
        return wishes

    def _news(self) -> list[Event]:
        """The events of blocks that have come since this was last called."""
        last = self._timed(lambda: self.client.chain.block_number)
        if last < self._next_block:
            return []
        events = self._timed(self.client.events, self._next_block, last)
        self._next_block = last + 1
        self._views.clear()
        self._models.clear()
        return events

    def _mine(self, calls: Sequence[Call], timestamp: int | None) -> list[Receipt]:
        """Have calls mined, refused ones included."""
        receipts = self._timed(self.client.chain.send, calls, timestamp)
        self.transactions += len(receipts)
        self.gas_used += sum(receipt.gas_used for receipt in receipts)
        self._views.clear()
        self._models.clear()
        return receipts

    def _route(self, events: Sequence[Event]) -> list[Wish]:
        """Every event to the agents that want its kind, and to those that it names."""
        wishes: list[Wish] = []
        for event in events:
            hearers = self._hearers.get(event.name, [])
            named = (self._named.get(value) for value in event.args.values() if isinstance(value, str))
            for agent in [*hearers, *(agent for agent in named if agent and event.name not in agent.HEARS)]:
                wishes += [(agent, command) for command in agent.receive(event)]
            self._books.hear(event)
            self._moves_between = None
            self._heard(event)
        return wishes

    def _stations(self, law: Law) -> dict[str, int]:
        """Where UAVs go between two periods, as the chain is at the latest block; all of them go by one plan."""
        if self._moves_between is None:
            self._moves_between = stations(self._books, law)
        return self._moves_between

    def _timed(self, ask: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call, and count the time as the chain's."""
        begin = time.monotonic()
        try:
            return ask(*args, **kwargs)
        finally:
            self.chain_seconds += time.monotonic() - begin
