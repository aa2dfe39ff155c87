"""Agents by the clock on the wall: nobody asks them, each host does what is due, and says what it did."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

from skyrelay.chain.abi import Event
from skyrelay.chain.client import IovClient
from skyrelay.chain.node.chain import NodeChain
from skyrelay.core.errors import BusError
from skyrelay.pilot.bus import Bus
from skyrelay.pilot.config import ClockConfig, HostConfig
from skyrelay.pilot.lockstep import HostsElsewhere, Radio, work
from skyrelay.pilot.receivers import Receivers
from skyrelay.pilot.standby import Standby
from skyrelay.pilot.timetable import Due, Timetable
from skyrelay.pilot.wire import Report, decode
from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import Fix, Phase, Tick

TOLERATED = 0.25
"""A clock further off than this is told, and set right by what receivers say [s]."""
FARTHEST = 86400.0
"""A machine's clock is right to a day [s]: what says otherwise is no receiver."""
LEAD = 1.0
"""Between all hosts being there and the first tick [s]."""
ANSWER = 5.0
"""So long a world may take to note what a host did [s]."""


class Wall:
    """The clock that a host goes by: its machine's, set right by what its receivers say.

    Args:
        clock: of the machine [s since 1970].
        say: is called with a line when the clock is off.
        sleep: waits for so many seconds.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        say: Callable[[str], None],
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._clock, self._say, self._sleep = clock, say, sleep
        self._right = 0.0
        self._doubted = False

    def now(self) -> float:
        """[s since 1970]."""
        return self._clock() + self._right

    def set_by(self, told: float | None) -> None:
        """Compare with a receiver's time, just heard; None where there is none, and the machine's clock has to do."""
        if told is None or abs(told - self.now()) <= TOLERATED:
            return
        off = told - self._clock()
        if abs(off) > FARTHEST:
            if not self._doubted:
                self._doubted = True
                self._say(f"clock: a receiver that is {abs(off):.3g} s off is not believed")
            return
        self._right = off
        how = "behind" if off > 0 else "ahead of"
        self._say(f"clock: is {abs(off):.1f} s {how} what receivers say, and goes by theirs")

    def wait_until(self, when: float) -> None:
        """Return at this time, or at once where it is over."""
        while (left := when - self.now()) > 0:
            self._sleep(left)


def run_free(
    host: Host,
    bus: Bus,
    config: HostConfig,
    clock: ClockConfig,
    radio: Radio,
    receivers: Receivers,
    standby: Standby | None,
    wall: Wall,
) -> None:
    """Do what is due, until the timetable ends.

    A tick whose time has been over for longer than a slot is left out: this host was not there, and the period goes on
    from where the contract is.

    Raises:
        BusError: nobody says when the run begins.
    """
    begin = clock.begin if clock.begin is not None else _begin(receivers, config.patience)
    contract = config.chain.contract
    wall.set_by(receivers.time())
    for due in Timetable.of(config.resolved(), begin, clock.slot, clock.step):
        if wall.now() > due.end + clock.slot:
            continue
        wall.set_by(receivers.time())
        wall.wait_until(due.begin)
        for uav in receivers.flown.values():
            if bus.peers:
                uav.beat("bus")
        if standby is not None:
            standby.wait(due.tick)
        reply = work(host, radio, due.tick, {}, receivers)
        report = Report(name=config.name, step=due.tick.step, reply=reply)
        bus.ask(report_key(contract), report.encode(), ANSWER).answer()
        bus.stay_linked(receivers.peers)


def _begin(receivers: Receivers, patience: float) -> float:
    """When the run begins, as the world says once all hosts are there."""
    until = time.monotonic() + patience
    while (begin := receivers.begin()) is None:
        if receivers.time() is not None:  # it is there, and waits for others
            until = time.monotonic() + patience
        elif time.monotonic() > until:
            raise BusError("world", f"silent for {patience:g} s", "the time at which the run begins")
        time.sleep(0.1)
    return begin


def report_key(contract: str) -> str:
    """Where a world hears what hosts have done."""
    return f"skyrelay/{contract}/world/did"


class FreeHosts(HostsElsewhere):
    """Hosts that go by their own clocks (`skyrelay.simulation.run.Hosts`): the world looks on, and asks for nothing.

    Args:
        contract: its address, which names the run on the bus.
        names: of the hosts.
        client, chain: to read the contract with, as it is founded.
        heard: is called with every event of the contract.
        notice: is called with a line when a host falls silent or is back.
        clock: of this machine [s since 1970].
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
        clock: Callable[[], float] = time.time,
    ) -> None:
        super().__init__(bus, contract, names, client, chain, heard, notice)
        self._wall = Wall(clock, notice)
        self._lock = threading.Lock()
        self._timetable: Iterator[Due] = iter(())
        self._reported: set[str] = set()
        self._step = 0
        bus.attend(report_key(contract), self._note)

    def begin(self, timetable: Callable[[float], Timetable], patience: float) -> None:
        """Wait until every host has asked where its members are, and say when the run begins.

        Args:
            patience: for all of them together [s].
        Raises:
            BusError: one has not in time.
        """
        until = time.monotonic() + patience
        while missing := [name for name in self._names if name not in self._sky.asked]:
            if time.monotonic() > until:
                raise BusError("bus", None, f"host {missing[0]} within {patience:g} s")
            time.sleep(0.05)
        begin = self._wall.now() + LEAD
        self._timetable = iter(timetable(begin))
        self._sky.begin = begin

    def tick(self, tick: Tick, timestamp: int) -> None:  # noqa: ARG002  (a network has its own clock)
        """Wait until the time of a tick is over; what hosts have done by then is what they did."""
        if tick.phase is Phase.CLOSE:
            with self._lock:
                self._choices.clear()  # of the period before
        due: Due = next(due for due in self._timetable if due.tick == tick)
        if tick.step != self._step:
            self._watch(tick)
        self._wall.wait_until(due.end)
        self._read()

    def take_moves(self) -> dict[str, int]:
        """See `skyrelay.simulation.run.Hosts`."""
        with self._lock:
            return super().take_moves()

    def take_fixes(self) -> dict[str, Fix]:
        """See `skyrelay.simulation.run.Hosts`."""
        with self._lock:
            return super().take_fixes()

    def _watch(self, tick: Tick) -> None:
        """Tell of hosts that have said nothing in a step, once, and of those that are back."""
        with self._lock:
            heard, self._reported, self._step = self._reported, set(), tick.step
        for name in self._names:
            if name not in heard and name not in self._gone:
                self._gone.add(name)
                self._notice(f"{name} is silent since step {tick.step - 1}; the others go on")
            elif name in heard and name in self._gone:
                self._gone.remove(name)
                self._notice(f"{name} is back at step {tick.step}")

    def _note(self, question: bytes) -> bytes:
        """What a host says that it has done."""
        report = decode(Report, question)
        if report.name not in self._replies:
            raise BusError("bus: report: name", report.name, "one of this run's hosts")
        with self._lock:
            self._reported.add(report.name)
            moves: Mapping[str, int] = report.reply.moves if report.step == self._step else {}  # others come too late
            self._accept(report.name, report.reply, moves)
        return b""
