"""Hosts agents: hands them what concerns them, and carries out what they want done, on a chain and a store."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import ParamSpec, TypeVar

from skyrelay.chain.abi import Event
from skyrelay.chain.chain import Call, Receipt
from skyrelay.chain.client import IovClient
from skyrelay.policy import Policy
from skyrelay.protocol.agent import Agent
from skyrelay.protocol.calls import to_call
from skyrelay.protocol.messages import (
    Beacon,
    ChainCall,
    Command,
    Decide,
    Decided,
    FetchModel,
    Mined,
    ModelFetched,
    ModelRead,
    Move,
    ReadModel,
    ReadZone,
    SendBeacon,
    Tick,
    ZoneRead,
)
from skyrelay.protocol.sight import Sight, decide
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

    Attributes:
        transactions, gas_used, chain_seconds: so far.
    """

    def __init__(
        self, agents: Sequence[Agent], client: IovClient, store: ModelStore, heard: Callable[[Event], None]
    ) -> None:
        self.client, self.store = client, store
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
        self._cids: dict[str, Cid] = {}
        self._beacons: list[Beacon] = []
        self._moves: dict[str, int] = {}

    # What comes in

    def tick(self, tick: Tick, timestamp: int | None = None) -> None:
        """The clock, to all agents; returns when nothing is left to do about it.

        Args:
            timestamp: of the blocks on the embedded chain [s].
        """
        self._settle([(agent, command) for agent in self.agents for command in agent.receive(tick)], timestamp)

    def hear(self, beacons: Iterable[Beacon]) -> None:
        """Beacons, each to whom it is for: the UAV that a vehicle tells, or the other UAVs of a UAV's zone."""
        tuned_in: dict[int, list[Agent]] = defaultdict(list)
        for agent in self.agents:
            if agent.tuned_in:
                tuned_in[agent.tuned_in].append(agent)
        for beacon in beacons:
            hearers = tuned_in[beacon.zone] if beacon.to is None else [self._named[beacon.to]]
            for agent in hearers:
                if agent.address != beacon.sender:
                    agent.receive(beacon)

    def execute(self, calls: Sequence[Call], timestamp: int | None = None) -> None:
        """Have calls mined that are no agent's; the agents hear what comes of them."""
        if calls:
            self._settle(self._route(self._mine(calls, timestamp)), timestamp)

    # What goes out

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

    def cid_of(self, model: str) -> Cid:
        """Where a model's bytes are, by the contract."""
        if model not in self._cids:
            self._cids[model] = Cid.from_bytes(self._timed(self.client.model, model).cid, f"model {model}")
        return self._cids[model]

    # Within

    def _settle(self, wishes: Sequence[Wish], timestamp: int | None) -> None:
        """Carry out what is wanted, and what is wanted because of that, until nothing is."""
        while wishes:
            calls: list[tuple[Agent, ChainCall]] = []
            undecided: list[tuple[Agent, Decide]] = []
            for agent, command in wishes:
                self._carry_out(agent, command, calls, undecided)
            self._decide(undecided)
            if not calls:
                return
            receipts = self._mine([to_call(call, agent.address, self.client) for agent, call in calls], timestamp)
            wishes = self._route(receipts)
            wishes += [(agent, wish) for agent, call in calls for wish in agent.receive(Mined(call))]

    def _carry_out(
        self,
        agent: Agent,
        command: Command,
        calls: list[tuple[Agent, ChainCall]],
        undecided: list[tuple[Agent, Decide]],
    ) -> None:
        """Do what can be done at once; note the calls, to be mined together, and the decisions, to be made together."""
        match command:
            case ReadZone(zone):
                answer: Sequence[Command] = agent.receive(ZoneRead(self.view(zone)))
            case ReadModel(model):
                answer = agent.receive(ModelRead(model, self.cid_of(model)))
            case FetchModel(cid):
                answer = agent.receive(ModelFetched(cid, self.store.get(cid)))
            case SendBeacon(beacon):
                self._beacons.append(beacon)
                return
            case Move(action):
                self._moves[agent.address] = action
                return
            case Decide():
                undecided.append((agent, command))
                return
            case _:
                calls.append((agent, command))
                return
        for wish in answer:
            self._carry_out(agent, wish, calls, undecided)

    def _decide(self, undecided: Sequence[tuple[Agent, Decide]]) -> None:
        """One run of the network for all UAVs that fly the same policy, each on its own sight."""
        by_policy: dict[Policy, list[tuple[Agent, Sight]]] = defaultdict(list)
        for agent, command in undecided:
            by_policy[command.policy].append((agent, command.sight))
        for policy, group in by_policy.items():
            for (agent, _), action in zip(group, decide(policy, [sight for _, sight in group]), strict=True):
                for wish in agent.receive(Decided(action)):
                    self._carry_out(agent, wish, [], [])

    def _mine(self, calls: Sequence[Call], timestamp: int | None) -> list[Receipt]:
        """Have calls mined; all of them must succeed."""
        receipts = self._timed(self.client.execute, calls, timestamp)
        self.transactions += len(receipts)
        self.gas_used += sum(receipt.gas_used for receipt in receipts)
        self._views.clear()
        return receipts

    def _route(self, receipts: Sequence[Receipt]) -> list[Wish]:
        """Every event to the agents that want its kind, and to those that it names."""
        wishes: list[Wish] = []
        for event in self.client.events_of(receipts):
            hearers = self._hearers.get(event.name, [])
            named = (self._named.get(value) for value in event.args.values() if isinstance(value, str))
            for agent in [*hearers, *(agent for agent in named if agent and event.name not in agent.HEARS)]:
                wishes += [(agent, command) for command in agent.receive(event)]
            self._heard(event)
        return wishes

    def _timed(self, ask: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call, and count the time as the chain's."""
        begin = time.monotonic()
        try:
            return ask(*args, **kwargs)
        finally:
            self.chain_seconds += time.monotonic() - begin
