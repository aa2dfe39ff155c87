"""A world that is the clock: it asks every host of agents what it does at a tick, and goes on when all have."""

from __future__ import annotations

import math
import queue
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from skyrelay.chain.abi import Event
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import IovClient
from skyrelay.chain.node.chain import NodeChain
from skyrelay.core.errors import BusError, UsageError
from skyrelay.pilot.bus import Asked, Bus, uav_key, vehicle_key
from skyrelay.pilot.flown import FlownUav
from skyrelay.pilot.receivers import Receivers, Sky
from skyrelay.pilot.standby import Standby
from skyrelay.pilot.wire import ChoiceMessage, FixMessage, Reply, TickMessage, decode, topic
from skyrelay.protocol.beacon import BeaconGate, Session
from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import Beacon, Fix, Phase, Tick
from skyrelay.protocol.sequence import UavState
from skyrelay.protocol.uav import UavAgent
from skyrelay.protocol.vehicle import Choice
from skyrelay.protocol.zone_view import ZoneView, read_zone
from skyrelay.store.cid import Cid

ANSWER = 120.0
"""A host that works on a tick for longer than this is taken to be gone [s]."""
BEACONS = 2.0
"""A beacon that is not there so long after all were sent is lost [s]."""
SESSION = 86400.0
"""How long a member vouches for a key that signs its beacons [s]."""
TOGETHER = frozenset({Phase.BEACON, Phase.DECIDE})
"""Phases in which hosts are asked at once; in the others one after the other, as what they write has an order."""


def by_the_contract_only() -> UsageError:
    """What to tell whoever wants another method than the contract's from hosts of their own."""
    return UsageError("selection.method", None, "two-sided: vehicles on hosts of their own select by the contract")


class HostsElsewhere:
    """What hosts of a run's agents in other processes have in common for who looks on.

    Args:
        contract: its address, which names the run on the bus.
        names: of the hosts, in the order in which they are asked.
        client, chain: to read the contract with, as it is founded.
        heard: is called with every event of the contract.
        notice: is called with a line when a host goes or comes.
    """

    def __init__(
        self,
        bus: Bus,
        contract: str,
        names: Sequence[str],
        client: IovClient,
        chain: NodeChain,
        heard: Callable[[Event], None],
        notice: Callable[[str], None],
    ) -> None:
        self._bus, self._contract, self._client = bus, contract, client
        self._heard, self._notice = heard, notice
        self._names = list(names)
        self._replies: dict[str, Reply] = {name: Reply() for name in names}
        self._sky = Sky(bus, contract, names)
        self._gone: set[str] = set()
        self._moves: dict[str, int] = {}
        self._flown: dict[str, Fix] = {}
        self._choices: dict[str, Choice] = {}
        self._next_block = 0
        self._chain = chain
        self._founded = chain.block_number
        self.transactions = self.gas_used = 0  # by the blocks since then, whatever became of who sent them

    @property
    def chain_seconds(self) -> float:
        """That the hosts waited for the chain [s]."""
        return sum(reply.chain_seconds for reply in self._replies.values())

    def tell(self, fixes: Mapping[str, Fix]) -> None:
        """New positions, by address: what receivers say from now on."""
        self._sky.tell(fixes)

    def advise(self, advice: Mapping[str, str]) -> None:  # noqa: ARG002 (there is nobody to tell)
        """Refuse: vehicles on hosts of their own select by the contract.

        Raises:
            UsageError: always.
        """
        raise by_the_contract_only()

    def spread(self) -> None:
        """Nothing: beacons go from host to host over the bus."""

    def take_moves(self) -> dict[str, int]:
        """The actions of the UAVs that have decided since this was last called, by address."""
        moves, self._moves = self._moves, {}
        return moves

    def take_fixes(self) -> dict[str, Fix]:
        """Where UAVs with an airframe of their own say that they are, since this was last called, by address."""
        fixes, self._flown = self._flown, {}
        return fixes

    def choices(self) -> dict[str, Choice]:
        """What Algorithm 1 gave the vehicles in this period, by address."""
        return self._choices

    def view(self, zone: int) -> ZoneView | None:
        """A zone as the chain has it at the latest block."""
        return read_zone(self._client, zone)

    def cid_of(self, model: str) -> Cid:
        """Where a model's bytes are, by the contract."""
        return Cid.from_bytes(self._client.model(model).cid, f"model {model}")

    def _accept(self, name: str, reply: Reply, moves: Mapping[str, int]) -> None:
        self._replies[name] = reply
        self._moves |= moves
        self._flown |= reply.read_fixes()
        self._choices |= reply.read_choices()

    def _read(self) -> None:
        last = self._client.chain.block_number
        if last >= self._next_block:
            for event in self._client.events(self._next_block, last):
                self._heard(event)
            for block in self._chain.blocks(range(max(self._next_block, self._founded + 1), last + 1)):
                self.transactions += len(block["transactions"])
                self.gas_used += int(block["gasUsed"], 16)
            self._next_block = last + 1


class RemoteHosts(HostsElsewhere):
    """Hosts that the world asks, tick by tick (`skyrelay.simulation.run.Hosts`).

    Args:
        bus, contract, names, client, chain, heard, notice: as `HostsElsewhere`.
        wait: how long the world stands still for a host that does not answer, before it goes on without it [s].
        speed: seconds of the world's clock to one of the wall's, at most; None as fast as the hosts can.
    """

    def __init__(
        self,
        bus: Bus,
        contract: str,
        names: Sequence[str],
        client: IovClient,
        chain: NodeChain,
        heard: Callable[[Event], None],
        notice: Callable[[str], None],
        wait: float = 30.0,
        speed: float | None = None,
    ) -> None:
        super().__init__(bus, contract, names, client, chain, heard, notice)
        self._wait, self._speed, self._began = wait, speed, math.nan
        self._sent: dict[str, Mapping[str, int]] = {}

    def gather(self, patience: float) -> None:
        """Wait until every host is there.

        Args:
            patience: for all of them together [s].
        Raises:
            BusError: one is not there in time.
        """
        until = time.monotonic() + patience
        for name in self._names:
            while self._bus.ask(host_key(self._contract, name), b"", ANSWER).answer() is None:
                if time.monotonic() > until:
                    raise BusError("bus", None, f"host {name} within {patience:g} s")
                time.sleep(0.05)

    def tick(self, tick: Tick, timestamp: int) -> None:  # noqa: ARG002  (a network has its own clock)
        """The clock, to all hosts; returns when all have answered, or are given up."""
        if tick.phase is Phase.BEACON:
            self._sent.clear()
            self._pace(tick.time)
        if tick.phase is Phase.CLOSE:
            self._choices.clear()
        if tick.phase in TOGETHER:
            asked = [(name, self._ask(name, tick)) for name in self._names]
            for name, question in asked:
                self._take(name, tick, question)
        else:
            for name in self._names:
                self._take(name, tick, self._ask(name, tick))
        self._read()

    # Within

    def _ask(self, name: str, tick: Tick) -> Asked:
        sent: Counter[str] = Counter()
        for other, counts in self._sent.items():
            if other != name and tick.phase is Phase.DECIDE:
                sent.update(counts)
        message = TickMessage.of(tick, sent)
        return self._bus.ask(host_key(self._contract, name), message.encode(), ANSWER)

    def _take(self, name: str, tick: Tick, asked: Asked) -> None:
        """A host's answer; one that does not answer is waited for, and then left behind until it answers again."""
        reply = self._first(name, asked)
        until = time.monotonic() + (0.0 if name in self._gone else self._wait)
        if reply is None and name not in self._gone:
            self._notice(f"{name} does not answer at step {tick.step}, {tick.phase.name}: waiting {self._wait:g} s")
        while reply is None and time.monotonic() < until:
            time.sleep(0.1)
            reply = self._first(name, self._ask(name, tick))
        if reply is None:
            if name not in self._gone:
                self._notice(f"{name} is gone; the others go on")
            self._gone.add(name)
            return
        if name in self._gone:
            self._gone.remove(name)
            self._notice(f"{name} is back at step {tick.step}, {tick.phase.name}")
        self._accept(name, reply, reply.moves)
        if tick.phase is Phase.BEACON:
            self._sent[name] = reply.sent

    def _first(self, name: str, asked: Asked) -> Reply | None:
        """A host's answer; None where it gave none that can be read."""
        try:
            content = asked.answer()
            return None if content is None else decode(Reply, content)
        except BusError as error:
            self._notice(f"{name}: {error}")
            return None

    def _pace(self, now: float) -> None:
        """Wait until the wall's clock is as far; the first step that is asked for is on time."""
        if self._speed is not None:
            if math.isnan(self._began):
                self._began = time.monotonic() - now / self._speed
            time.sleep(max(0.0, self._began + now / self._speed - time.monotonic()))


def host_key(contract: str, name: str) -> str:
    """Where a host is asked."""
    return f"skyrelay/{contract}/host/{name}"


class Radio:
    """Signed beacons over the bus, to and from the UAVs of this host.

    Args:
        contract: address and chain id of the contract that knows the members.
        keyring: of this host's members.
        zones: of this host's UAVs, by their address; a zone that one of them is sent to is listened to as well.
        patience: beyond this age a beacon is stale [s].

    Attributes:
        gate: counts what it lets in and what it drops.
    """

    def __init__(
        self, bus: Bus, contract: tuple[str, int], keyring: Keyring, zones: Mapping[str, int], patience: float
    ) -> None:
        self._uavs: set[str] = set()
        self._vehicles: set[str] = set()
        self._topics = {*map(str, zones.values()), *zones}
        self._members, self._zones = set(zones), set(zones.values())
        self.gate = BeaconGate(contract, self._uavs, self._vehicles, self._zones, patience=patience)
        self._bus, self._contract, self._keyring = bus, contract, keyring
        self._senders: dict[str, Session] = {}
        self._own: list[Beacon] = []
        address = contract[0]
        keys = [uav_key(address, zone) for zone in sorted(set(zones.values()))]
        self._heard = [bus.subscribe(key) for key in [*keys, *(vehicle_key(address, uav) for uav in zones)]]
        self._lost = 0

    def note(self, event: Event) -> None:
        """A member that the chain knows may be heard; a UAV of this host hears those of the zone that it is in."""
        match event.name:
            case "UAVRegistered":
                self._uavs.add(event.args["uav"])
            case "VehicleRegistered":
                self._vehicles.add(event.args["vehicle"])
            case "UAVZoneUpdated" if event.args["uav"] in self._members:
                zone = event.args["to"]
                if zone and zone not in self._zones:
                    self._heard.append(self._bus.subscribe(uav_key(self._contract[0], zone)))
                    self._zones.add(zone)
                    self._topics.add(str(zone))

    def send(self, beacons: Sequence[Beacon]) -> Counter[str]:
        """Beacons to those around; how many on each topic."""
        self._own += beacons
        for beacon in beacons:
            sender = beacon.sender
            if sender not in self._senders:
                vouch = partial(self._keyring.vouch, sender)
                self._senders[sender] = Session(sender, self._contract, vouch, beacon.time, SESSION)
            address = self._contract[0]
            key = vehicle_key(address, beacon.to, sender) if beacon.to else uav_key(address, beacon.zone, sender)
            self._bus.publish(key, self._senders[sender].seal(beacon))
        return Counter(map(topic, beacons))

    def take(self, now: float, sent: Mapping[str, int]) -> list[Beacon]:
        """What has been heard, once as many of this moment are there as others sent, or no more come.

        Args:
            now: on the world's clock [s].
            sent: by others, on each topic.
        """
        wanted = sum(count for name, count in sent.items() if name in self._topics)
        until = time.monotonic() + BEACONS
        raw: list[bytes] = []
        while True:
            for subscription in self._heard:
                raw += [arrival.content for arrival in subscription.take()]
            lost = sum(subscription.lost for subscription in self._heard)
            if len(raw) + lost - self._lost >= wanted or time.monotonic() > until:
                break
            time.sleep(0.001)
        self._lost = lost
        own, self._own = self._own, []
        return own + [beacon for content in raw if (beacon := self.gate.admit(content, now)) is not None]


def serve(
    host: Host,
    bus: Bus,
    contract: str,
    name: str,
    radio: Radio,
    patience: float,
    receivers: Receivers,
    standby: Standby | None = None,
) -> None:
    """Answer the world's ticks until it stops asking.

    Args:
        receivers: of this host's members.
        standby: of a host that lets another act first.
        patience: without a tick for so long the world is taken to have stopped [s].
    Raises:
        BusError: the world has stopped.
    """
    questions = bus.answer(host_key(contract, name))
    while True:
        try:
            question = questions.get(timeout=patience)
        except queue.Empty:
            raise BusError("world", f"silent for {patience:g} s", "a world that goes on") from None
        for uav in receivers.flown.values():
            uav.beat("bus")
        if not question.content:  # whether we are here
            question.answer(b"")
            continue
        try:
            message = decode(TickMessage, question.content)
            tick = message.tick()
        except BusError as error:
            question.refuse(str(error))
            continue
        try:
            if standby is not None:
                standby.wait(tick)
            reply = work(host, radio, tick, message.sent, receivers)
        except Exception as error:
            question.refuse(str(error))
            raise
        question.answer(reply.encode())
        bus.stay_linked(receivers.peers)


def work(host: Host, radio: Radio, tick: Tick, sent_by_others: Mapping[str, int], receivers: Receivers) -> Reply:
    """Have the agents here do what a tick asks for.

    Args:
        sent_by_others: beacons of this step on each topic, which are waited for.
    """
    flown = receivers.flown
    host.tell(receivers.fixes(tick))
    if tick.phase is Phase.DECIDE:
        host.hear(radio.take(tick.time, sent_by_others))
    host.tick(tick)
    sent = radio.send(host.take_beacons())
    choices = host.choices() if tick.phase is Phase.PROPOSE else {}
    moves = host.take_moves()
    _fly(host, tick, moves, flown)
    return Reply(
        moves=moves,
        fixes={address: FixMessage.of(fix) for address, uav in flown.items() if (fix := uav.fix()).position},
        choices={
            address: ChoiceMessage(uav=choice.uav, qou=choice.qou, weighed=choice.weighed)
            for address, choice in choices.items()
        },
        sent=dict(sent),
        chain_seconds=host.chain_seconds,
    )


def _fly(host: Host, tick: Tick, moves: Mapping[str, int], flown: Mapping[str, FlownUav]) -> None:
    """Have airframes do what their agents decided; an agent that has nothing to decide misses no policy."""
    deciding = {a.address for a in host.agents if isinstance(a, UavAgent) and a.state is UavState.FLYING}
    for address, uav in flown.items():
        uav.beat("chain")  # or the tick would not be done
        if address in moves:
            uav.fly(moves[address])
        elif address not in deciding or tick.phase is not Phase.DECIDE:
            uav.beat("policy")
