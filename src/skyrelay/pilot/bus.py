"""The bus between agents: Eclipse Zenoh peers without a broker; the only place that knows Zenoh.

Endpoints are named, nothing is searched for by multicast. A peer that joins by one endpoint learns of the others there
(gossip) and links to each directly, so that no peer stands in the way of two others. Zenoh makes a link to a named
endpoint again whenever it breaks; one that it made by gossip it does not, so that a peer that lacks others joins anew
(`Bus.stay_linked`).
"""

from __future__ import annotations

import hashlib
import heapq
import itertools
import json
import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import zenoh

from skyrelay.core.errors import BusError

LONGEST_MESSAGE = 64 * 1024
"""Bytes; longer ones are neither sent nor taken."""
LONGEST_QUESTION = 256 * LONGEST_MESSAGE
"""Bytes of a question or an answer."""
MOST_QUESTIONS = 1024
"""That wait for their answer at one key; one more gets none."""
CLAIM = 5.0
"""So long the others have to say that they hold a key [s]; without any, the answer comes at once."""
ANY_PORT = "tcp/127.0.0.1:0"
LACKING = 5.0
"""So long another peer may be there without a link to it [s]; and, where joining anew has not helped, four times."""


def uav_key(contract: str, zone: int | str = "*", uav: str = "*") -> str:
    """Where a UAV's beacons go; the default is all UAVs' of the contract."""
    return f"skyrelay/{contract}/{zone}/uav/{uav}"


def vehicle_key(contract: str, uav: str = "*", vehicle: str = "*") -> str:
    """Where a vehicle's beacons to its UAV go; the default is all vehicles' to all UAVs."""
    return f"skyrelay/{contract}/to/{uav}/vehicle/{vehicle}"


@dataclass(frozen=True, slots=True)
class Arrival:
    """A message as it came; who sent it is what its content can prove, not its key."""

    key: str
    content: bytes


@dataclass(frozen=True, slots=True)
class Certificates:
    """What a peer shows others, and by what it knows them: files in PEM.

    Attributes:
        authority: that has signed the certificate of every peer.
        certificate, key: this host's; it is issued for the address at which others reach it.
    """

    authority: Path
    certificate: Path
    key: Path


@dataclass(frozen=True, slots=True)
class Weather:
    """Loss and delay put on what a peer takes, for experiments.

    Attributes:
        loss: share of the messages that do not arrive [0-1].
        delay: until the others do [s].
        seed: the same messages are lost to the same receiver each time, in whatever order they come.
    """

    loss: float = 0.0
    delay: float = 0.0
    seed: int = 0

    def loses(self, receiver: str, arrival: Arrival) -> bool:
        """Whether a message does not reach a receiver: by a hash of both, evenly spread."""
        if not self.loss:
            return False
        text = f"{self.seed} {receiver} {arrival.key} ".encode() + arrival.content
        return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "big") < self.loss * 2**64


class Subscription:
    """Messages that wait to be taken: a bounded queue from which the oldest fall out.

    Attributes:
        expression: of the keys under which they are published.
        overflowed: how many fell out before they were taken.
        oversized: how many were too long to be let in.
        lost: how many the weather took.
    """

    def __init__(self, name: str, expression: str, capacity: int, weather: Weather) -> None:
        self.expression = expression
        self.overflowed = self.oversized = self.lost = 0
        self._name, self._capacity, self._weather = name, capacity, weather
        self._ready: deque[Arrival] = deque()
        self._late: list[tuple[float, int, Arrival]] = []
        self._order = itertools.count()
        self._news = threading.Condition()
        self._closed = False

    def take(self, timeout: float = 0.0) -> list[Arrival]:
        """All that has arrived, in order; waits for the first so long [s], and returns nothing after that."""
        deadline = time.monotonic() + timeout
        with self._news:
            while not self._due() and not self._closed:
                now = time.monotonic()
                if now >= deadline:
                    break
                self._news.wait(min(deadline, self._late[0][0] if self._late else deadline) - now)
            arrivals = list(self._ready)
            self._ready.clear()
        return arrivals

    def wake(self) -> None:
        """Have whoever waits in `take` return, now and from now on."""
        with self._news:
            self._closed = True
            self._news.notify_all()

    def _due(self) -> bool:
        """Let in what is late no longer; whether anything is there."""
        now = time.monotonic()
        while self._late and self._late[0][0] <= now:
            self._append(heapq.heappop(self._late)[2])
        return bool(self._ready)

    def _append(self, arrival: Arrival) -> None:
        if len(self._ready) >= self._capacity:
            self._ready.popleft()
            self.overflowed += 1
        self._ready.append(arrival)

    def _arrive(self, sample: zenoh.Sample) -> None:
        """Called from Zenoh's threads."""
        if len(sample.payload) > LONGEST_MESSAGE:
            with self._news:
                self.oversized += 1
            return
        arrival = Arrival(str(sample.key_expr), sample.payload.to_bytes())
        with self._news:
            if self._weather.loses(self._name, arrival):
                self.lost += 1
                return
            if self._weather.delay:
                if len(self._late) >= self._capacity:
                    heapq.heappop(self._late)
                    self.overflowed += 1
                heapq.heappush(self._late, (time.monotonic() + self._weather.delay, next(self._order), arrival))
            else:
                self._append(arrival)
            self._news.notify_all()


class Asked:
    """A question that is under way to whoever answers at a key."""

    def __init__(self, replies: zenoh.Handler[zenoh.Reply]) -> None:
        self._replies = replies

    def answer(self) -> bytes | None:
        """The first answer; None where nobody gave one.

        Raises:
            BusError: what was asked was refused, with the reason.
        """
        for reply in self._replies:
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
            if reply.err is not None:
                raise BusError("bus", reply.err.payload.to_bytes().decode("utf-8", "replace"), "an answer")
        return None


class Question:
    """A question that waits for its answer."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.content = query.payload.to_bytes() if query.payload is not None else b""

    def answer(self, content: bytes) -> None:
        """Answer it; one that came before this peer joined anew gets no answer, and is asked again."""
        with suppress(zenoh.ZError), self._query as query:
            query.reply(query.key_expr, content)

    def refuse(self, reason: str) -> None:
        """Say why not."""
        with suppress(zenoh.ZError), self._query as query:
            query.reply_err(reason.encode(errors="replace"))


def _encrypted(files: Certificates) -> dict[str, object]:
    """Zenoh's settings for links that both ends show a certificate on.

    Raises:
        BusError: a file is not there.
    """
    for path in (files.authority, files.certificate, files.key):
        if not path.is_file():
            raise BusError(f"bus: {path}", None, "a file in PEM")
    tls = "transport/link/tls"
    return {
        "transport/link/protocols": ["tls"],
        f"{tls}/root_ca_certificate": str(files.authority),
        f"{tls}/enable_mtls": True,
        f"{tls}/verify_name_on_connect": True,
        f"{tls}/close_link_on_expiration": True,
        **{f"{tls}/{end}_certificate": str(files.certificate) for end in ("listen", "connect")},
        **{f"{tls}/{end}_private_key": str(files.key) for end in ("listen", "connect")},
    }


class Bus:
    """A peer.

    Args:
        name: tells this peer's share of the `Weather` from others'.
        connect: endpoints of peers to join by, e.g. ``tcp/192.0.2.1:7447``; tried again whenever a link breaks.
        listen: endpoints that others join by; on several hosts it must be an address that the others reach.
        weather: put on all that it takes.
        lossless: hold up who publishes rather than drop what a hearer cannot take yet, as lock-step needs.
        patience: until the first link to one of ``connect`` stands [s].
        certificates: links are encrypted, and only with peers whom the same authority knows; endpoints are ``tls/...``.

    Attributes:
        failed: how many questions could not be answered at all.
    Raises:
        BusError: an endpoint is none, is taken, or nobody is there within ``patience``.
    """

    def __init__(
        self,
        name: str,
        connect: Sequence[str] = (),
        listen: Sequence[str] = (ANY_PORT,),
        *,
        weather: Weather | None = None,
        lossless: bool = False,
        patience: float = 10.0,
        certificates: Certificates | None = None,
    ) -> None:
        self._name = name
        self.failed = 0
        # Otherwise a slow hearer shall not hold up the radio.
        self._congestion = zenoh.CongestionControl.BLOCK if lossless else zenoh.CongestionControl.DROP
        self._weather = weather or Weather()
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._subscriptions: list[Subscription] = []
        self._claims: list[zenoh.LivelinessToken] = []
        self._queryables: list[tuple[str, Callable[[zenoh.Query], None]]] = []
        self._held: list[str] = []
        self._connect, self._listen, self._patience = list(connect), list(listen), patience
        self._certificates = certificates
        self._lacking: dict[str, float] = {}  # since when
        self._joined = -math.inf
        self._session = self._open()

    def _open(self) -> zenoh.Session:
        connect, listen, patience = self._connect, self._listen, self._patience
        config = zenoh.Config()
        settings = {
            "mode": "peer",
            "scouting/multicast/enabled": False,
            "listen/endpoints": listen,
            "connect/endpoints": connect,
            "connect/timeout_ms": round(1000 * patience),
            "connect/exit_on_failure": True,
            "transport/link/rx/max_message_size": LONGEST_QUESTION,
            **({} if self._certificates is None else _encrypted(self._certificates)),
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            place = f"bus: connect {', '.join(connect)}" if connect else f"bus: listen {', '.join(listen)}"
            reason = str(error).split(" at /")[0].rstrip(". ")
            wanted = f"a peer that answers within {patience:g} s" if connect else "an endpoint that is free"
            raise BusError(place, None, f"{wanted} ({reason})") from None

    @property
    def name_on_bus(self) -> str:
        """By which other peers know this one until it joins anew."""
        return str(self._session.zid())

    @property
    def linked(self) -> list[str]:
        """The names of those that this one is linked to."""
        return [str(peer) for peer in self._session.info.peers_zid()]

    def stay_linked(self, there: Collection[str]) -> None:
        """Join anew where a link to one who is there has been lacking for some time, as after a network was cut in two.

        It is not heard for a moment, and has another name then. Not for a thread beside one that asks or publishes.

        Args:
            there: names of those to whom whoever it joined by is linked.
        Raises:
            BusError: whoever it joined by has gone meanwhile.
        """
        now = time.monotonic()
        lacks = set(there) - set(self.linked) - {self.name_on_bus}
        self._lacking = {peer: self._lacking.get(peer, now) for peer in lacks}
        if not any(now - since > LACKING for since in self._lacking.values()) or now - self._joined < 4 * LACKING:
            return
        self._session.close()  # type: ignore[no-untyped-call]
        self._publishers.clear()
        self._claims.clear()
        self._session = self._open()
        self._joined = time.monotonic()
        self._lacking.clear()
        for subscription in self._subscriptions:
            self._hear(subscription)
        for key, take in self._queryables:
            self._session.declare_queryable(key, take)
        for key in self._held:
            self._claims.append(self._session.liveliness().declare_token(key))

    @property
    def peers(self) -> int:
        """How many others this one is linked to."""
        return len(self.linked)

    def publish(self, key: str, content: bytes) -> None:
        """Send to all who subscribe to a matching expression; who is out of reach misses it.

        Raises:
            BusError: the message is too long, or the key is none.
        """
        if len(content) > LONGEST_MESSAGE:
            raise BusError(f"bus: message to {key}", f"{len(content)} bytes", f"at most {LONGEST_MESSAGE}")
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._declared(key)
        publisher.put(content)

    def subscribe(self, expression: str, capacity: int = 4096) -> Subscription:
        """Hear what is published by others under a key expression, e.g. ``skyrelay/*/7/uav/*``.

        Args:
            capacity: messages that may wait; the oldest make room.
        Raises:
            BusError: the expression is none.
        """
        subscription = Subscription(self._name, expression, capacity, self._weather)
        self._hear(subscription)
        self._subscriptions.append(subscription)
        return subscription

    def _hear(self, subscription: Subscription) -> None:
        expression, arrive = subscription.expression, subscription._arrive
        try:
            self._session.declare_subscriber(expression, arrive, allowed_origin=zenoh.Locality.REMOTE)
        except zenoh.ZError as error:
            raise BusError(
                "bus: key expression", expression, f"one of Zenoh's ({str(error).split(' at /')[0]})"
            ) from None

    def ask(self, key: str, content: bytes, timeout: float) -> Asked:
        """Ask whoever answers at a key; one that is gone, or silent for so long [s], gives no answer."""
        return Asked(self._session.get(key, payload=content, timeout=timeout))

    def answer(self, key: str) -> queue.Queue[Question]:
        """Take the questions at a key, in their order."""
        questions: queue.Queue[Question] = queue.Queue(MOST_QUESTIONS)

        def take(query: zenoh.Query) -> None:
            try:
                questions.put_nowait(Question(query))
            except queue.Full:  # Zenoh's own thread must not wait: it brings the beacons too
                self.failed += 1

        self._session.declare_queryable(key, take)
        self._queryables.append((key, take))
        return questions

    def attend(self, key: str, answer: Callable[[bytes], bytes]) -> None:
        """Answer the questions at a key in a thread, one after the other, whatever they are.

        Args:
            answer: to a question's content; raises BusError where there is none, and who asked is told why.
        """
        questions = self.answer(key)

        def attend() -> None:
            while True:
                question = questions.get()
                try:
                    try:
                        question.answer(answer(question.content))
                    except BusError as error:
                        question.refuse(str(error))
                except Exception:  # a question that nobody foresaw, or an asker who is gone, ends no member
                    self.failed += 1
                    with suppress(Exception):
                        question.refuse("not to be understood")

        threading.Thread(target=attend, daemon=True).start()

    def claim(self, key: str) -> None:
        """Hold a key that only one peer may hold, until this peer leaves or dies.

        Raises:
            BusError: another peer that is linked to this one holds it.
        """
        liveliness = self._session.liveliness()
        if any(reply.ok is not None for reply in liveliness.get(key, timeout=CLAIM)):
            raise BusError("bus", key, "a name that no other peer has now")
        self._claims.append(liveliness.declare_token(key))
        self._held.append(key)

    def close(self) -> None:
        """Leave; the others see it."""
        for subscription in self._subscriptions:
            subscription.wake()
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Bus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _declared(self, key: str) -> zenoh.Publisher:
        try:
            return self._session.declare_publisher(
                key,
                congestion_control=self._congestion,
                express=True,  # news is worth more than packing
            )
        except zenoh.ZError as error:
            raise BusError("bus: key", key, f"one of Zenoh's ({str(error).split(' at /')[0]})") from None
