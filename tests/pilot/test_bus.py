"""The bus between real Zenoh peers on loopback, in this process and in others."""

import time

import pytest
from processes import free_port, until

from skyrelay.chain.abi import Event
from skyrelay.chain.accounts import Keyring
from skyrelay.core.errors import BusError
from skyrelay.pilot.bus import LONGEST_MESSAGE, MOST_QUESTIONS, Arrival, Bus, Weather, uav_key, vehicle_key
from skyrelay.pilot.lockstep import Radio
from skyrelay.pilot.receivers import Sky, sky_key
from skyrelay.pilot.wire import WhereMessage
from skyrelay.protocol.messages import Beacon, Fix

CONTRACT, UAV, OTHER, VEHICLE = "0xc0", "0xaa", "0xbb", "0xee"
HELLO = b"hello?"


@pytest.fixture
def bus():
    """Opens peers, and closes them after the test."""
    opened = []

    def begin(name, connect=(), **options):
        opened.append(Bus(name, connect, **options))
        return opened[-1]

    yield begin
    for peer in opened:
        peer.close()


def endpoint():
    return f"tcp/127.0.0.1:{free_port()}"


def collect(subscription, count):
    """So many messages, however they come in; what `linked` sent does not count."""
    got = []
    until(lambda: got.extend(a for a in subscription.take(0.2) if a.content != HELLO) or len(got) >= count)
    return got


def linked(publisher, key, subscription):
    """Publish until the first message is through: from then on every one is."""
    until(lambda: publisher.publish(key, HELLO) or subscription.take(0.05))


def test_a_message_comes_to_those_whose_expression_matches(bus):
    meeting = endpoint()
    hub = bus("hub", listen=[meeting])
    sender = bus("sender", [meeting])
    zone_one = hub.subscribe(uav_key(CONTRACT, 1))
    own = hub.subscribe(vehicle_key(CONTRACT, UAV))
    linked(sender, uav_key(CONTRACT, 1, UAV), zone_one)
    linked(sender, vehicle_key(CONTRACT, UAV, VEHICLE), own)
    sender.publish(uav_key(CONTRACT, 2, UAV), b"another zone")
    sender.publish(vehicle_key(CONTRACT, OTHER, VEHICLE), b"another uav")
    sender.publish(vehicle_key(CONTRACT, UAV, VEHICLE), b"to you")
    sender.publish(uav_key(CONTRACT, 1, UAV), b"here")
    assert collect(zone_one, 1) == [Arrival(uav_key(CONTRACT, 1, UAV), b"here")]
    assert collect(own, 1) == [Arrival(vehicle_key(CONTRACT, UAV, VEHICLE), b"to you")]


def test_peers_that_met_at_one_endpoint_talk_on_without_it(bus):
    meeting = endpoint()
    hub = bus("hub", listen=[meeting])
    one, two = bus("one", [meeting]), bus("two", [meeting])
    until(lambda: one.peers == two.peers == 2)
    heard = two.subscribe("skyrelay/**")
    linked(one, "skyrelay/x", heard)
    hub.close()
    until(lambda: one.peers == two.peers == 1)
    one.publish("skyrelay/x", b"still here")
    assert collect(heard, 1) == [Arrival("skyrelay/x", b"still here")]


HUB = """
import sys
from skyrelay.pilot.bus import Bus
with Bus("hub", listen=[sys.argv[1]]) as bus:
    heard = bus.subscribe("skyrelay/**")
    print("ready", flush=True)
    while True:
        for arrival in heard.take(1.0):
            bus.publish("echo/" + arrival.key, arrival.content)
"""


def test_a_peer_that_is_killed_and_comes_back_is_linked_again(bus, start):
    meeting = endpoint()
    first = start("-c", HUB, meeting)
    assert first.stdout.readline() == "ready\n"
    peer = bus("peer", [meeting])
    echo = peer.subscribe("echo/**")
    linked(peer, "skyrelay/x", echo)
    first.kill()
    until(lambda: peer.peers == 0)
    peer.publish("skyrelay/x", b"nobody hears this")
    second = start("-c", HUB, meeting)
    assert second.stdout.readline() == "ready\n"
    linked(peer, "skyrelay/x", echo)
    peer.publish("skyrelay/x", b"again")
    assert collect(echo, 1)[-1].content == b"again"


def test_nobody_at_the_endpoint_is_one_clear_line():
    nowhere = endpoint()
    with pytest.raises(BusError, match=f"bus: connect {nowhere}: expected a peer that answers within 0.3 s") as caught:
        Bus("peer", [nowhere], patience=0.3)
    assert "\n" not in str(caught.value)


def test_an_endpoint_that_is_taken_or_none(bus):
    meeting = endpoint()
    bus("hub", listen=[meeting])
    with pytest.raises(BusError, match=r"an endpoint that is free .*Address already in use"):
        Bus("second", listen=[meeting])
    with pytest.raises(BusError, match="invalid socket address"):
        Bus("typo", listen=["tcp/nonsense"])


def test_what_nobody_takes_makes_room_oldest_first(bus):
    meeting = endpoint()
    hub, sender = bus("hub", listen=[meeting]), bus("sender", [meeting])
    few, all_ = hub.subscribe("skyrelay/**", capacity=5), hub.subscribe("skyrelay/**")
    linked(sender, "skyrelay/x", all_)
    for number in range(20):
        sender.publish("skyrelay/x", bytes([number]))
    collect(all_, 20)
    until(lambda: few.overflowed >= 15)
    assert [arrival.content[0] for arrival in few.take()] == [15, 16, 17, 18, 19]


def test_a_message_has_a_longest_length(bus):
    meeting = endpoint()
    hub, sender = bus("hub", listen=[meeting]), bus("sender", [meeting])
    heard = hub.subscribe("skyrelay/**")
    linked(sender, "skyrelay/x", heard)
    sender.publish("skyrelay/x", bytes(LONGEST_MESSAGE))
    assert len(collect(heard, 1)[0].content) == LONGEST_MESSAGE
    with pytest.raises(BusError, match=f"at most {LONGEST_MESSAGE}"):
        sender.publish("skyrelay/x", bytes(LONGEST_MESSAGE + 1))
    sender._declared("skyrelay/x").put(bytes(LONGEST_MESSAGE + 1))  # as one that does not keep to it
    until(lambda: heard.oversized == 1)
    assert {arrival.content for arrival in heard.take()} <= {HELLO}


def test_keys_that_are_none(bus):
    peer = bus("peer", listen=[endpoint()])
    with pytest.raises(BusError, match="bus: key"):
        peer.publish("skyrelay//x", b"")
    with pytest.raises(BusError, match="bus: key expression"):
        peer.subscribe("skyrelay/**x")


def test_the_weather_takes_its_share_and_the_same_each_time():
    weather = Weather(loss=0.1, seed=3)
    arrivals = [Arrival("skyrelay/x", number.to_bytes(4, "big")) for number in range(5000)]
    lost = [arrival for arrival in arrivals if weather.loses("one", arrival)]
    assert 0.08 < len(lost) / len(arrivals) < 0.12
    assert lost == [arrival for arrival in arrivals if weather.loses("one", arrival)]
    assert lost != [arrival for arrival in arrivals if weather.loses("two", arrival)]
    assert lost != [arrival for arrival in arrivals if Weather(loss=0.1, seed=4).loses("one", arrival)]


def test_weather_on_a_link(bus):
    meeting = endpoint()
    hub = bus("hub", listen=[meeting], lossless=True)  # the only loss is the weather's
    stormy = bus("stormy", [meeting], weather=Weather(loss=0.3, delay=0.2, seed=1))
    clear = bus("clear", [meeting])
    heard, all_ = stormy.subscribe("skyrelay/**"), clear.subscribe("skyrelay/**")
    linked(hub, "skyrelay/x", all_)
    linked(hub, "skyrelay/x", heard)
    contents = [bytes([7, number]) for number in range(100)]
    begin = time.monotonic()
    for content in contents:
        hub.publish("skyrelay/x", content)
    expected = [c for c in contents if not Weather(loss=0.3, seed=1).loses("stormy", Arrival("skyrelay/x", c))]
    assert [arrival.content for arrival in collect(heard, len(expected))] == expected
    assert time.monotonic() - begin >= 0.2
    assert heard.lost >= 100 - len(expected) > 0
    assert {arrival.content for arrival in collect(all_, 100)} >= set(contents)


def test_a_uav_that_is_sent_to_another_zone_hears_those_who_fly_there(bus):
    meeting, ring, contract = endpoint(), Keyring.ephemeral(), ("0x" + "c0" * 20, 1)
    own, other = ring.account("uav-1"), ring.account("uav-2")
    radio = Radio(bus("here", listen=[meeting]), contract, ring, {own: 1}, patience=5.0)
    mate = Radio(bus("there", [meeting]), contract, ring, {other: 2}, patience=5.0)
    radio.note(Event("UAVRegistered", {"uav": other}, 1, 0, 0))
    radio.note(Event("UAVZoneUpdated", {"uav": own, "from": 1, "to": 2}, 2, 0, 0))

    def heard():
        now = time.monotonic()
        mate.send([Beacon(other, 2, None, (1.0, 2.0), now)])
        return radio.take(now, {})

    assert until(heard)[0].sender == other


def test_a_question_that_nobody_foresaw_ends_no_member(bus):
    """Whoever answers goes on, and counts; who asks for what there is not is told why."""
    place = endpoint()
    server = bus("server", listen=[place])

    def answer(content):
        if content == b"none":
            raise BusError("bus", None, "something that there is")
        return bytes([1000 // len(content)])

    server.attend("skyrelay/attended", answer)
    asker = bus("asker", [place])
    assert until(lambda: asker.ask("skyrelay/attended", b"1234", 5.0).answer()) == bytes([250])
    for unforeseen in (b"", b"123"):  # nothing is divided by 0, and 333 is no byte
        with pytest.raises(BusError, match="not to be understood"):
            asker.ask("skyrelay/attended", unforeseen, 5.0).answer()
    with pytest.raises(BusError, match="something that there is"):
        asker.ask("skyrelay/attended", b"none", 5.0).answer()
    assert asker.ask("skyrelay/attended", b"1234", 5.0).answer() == bytes([250])
    assert server.failed == 2


def test_more_questions_than_may_wait_hold_up_no_beacon(bus):
    place = endpoint()
    server = bus("server", listen=[place])
    waiting = server.answer("skyrelay/busy")  # nobody takes them
    heard = server.subscribe("skyrelay/beacon")
    asker = bus("asker", [place])
    linked(asker, "skyrelay/beacon", heard)
    asked = [asker.ask("skyrelay/busy", b"?", 60.0) for _ in range(MOST_QUESTIONS + 50)]
    until(lambda: server.failed == 50)
    assert waiting.full()
    asker.publish("skyrelay/beacon", b"here")
    assert collect(heard, 1)[0].content == b"here"
    assert len(asked) == MOST_QUESTIONS + 50


def test_a_world_is_asked_by_strangers_and_keeps_none_of_their_names(bus):
    place = endpoint()
    world = bus("world", listen=[place])
    sky = Sky(world, CONTRACT, ["uavs"])
    sky.tell({"0x" + "aa" * 20: Fix((1.0, 2.0))})
    asker = bus("asker", [place])

    def ask(name, members=()):
        asked = WhereMessage(name=name, members=list(members)).encode()
        return asker.ask(sky_key(CONTRACT), asked, 5.0).answer()

    until(lambda: ask("stranger"))
    for number in range(50):
        assert ask(f"stranger {number}")
    assert sky.asked == set()
    for content in (b"", b"{}", b"\xff", b"[" * 5000, WhereMessage(name="uavs", members=[]).encode()[:-1]):
        with pytest.raises(BusError):
            asker.ask(sky_key(CONTRACT), content, 5.0).answer()
    assert b"1.0" in ask("uavs", ["0x" + "aa" * 20])
    assert sky.asked == {"uavs"}
    assert world.failed == 0


def test_a_peer_that_lacks_another_for_long_joins_anew_and_is_what_it_was(bus, monkeypatch):
    """What it hears, answers and holds goes on; while nobody is lacking, or not for long, it stays as it is."""
    place = endpoint()
    world = bus("world", listen=[place])
    one = bus("one", [place])
    two = bus("two", [place])
    everybody = until(lambda: names if len(names := {*world.linked, world.name_on_bus}) == 3 else None)
    until(lambda: len(one.linked) == 2)
    heard = one.subscribe("skyrelay/heard")
    one.attend("skyrelay/attended", lambda content: content)
    one.claim("skyrelay/claimed")
    linked(two, "skyrelay/heard", heard)
    before = one.name_on_bus
    one.stay_linked(everybody)
    one.stay_linked({*everybody, "somebody"})
    assert one.name_on_bus == before
    monkeypatch.setattr("skyrelay.pilot.bus.LACKING", 0.0)
    one.stay_linked({*everybody, "somebody"})
    assert one.name_on_bus != before
    until(lambda: len(one.linked) == 2)
    linked(two, "skyrelay/heard", heard)
    assert until(lambda: two.ask("skyrelay/attended", b"still?", 5.0).answer()) == b"still?"
    with pytest.raises(BusError, match="a name that no other peer has"):
        two.claim("skyrelay/claimed")
