"""An onlooker of `skyrelay up`: what it is told over bus and chain is what the run's record says afterwards."""

import asyncio
import subprocess

import pytest
import tomli_w
from town_of_processes import sets, skyrelay
from websockets.asyncio.client import connect

from skyrelay.core.errors import ChainError, UsageError
from skyrelay.pilot.watch import Watch, load_watch
from skyrelay.report.live import PROTOCOL
from skyrelay.runfolder import read_run
from skyrelay.runfolder.feed import read_header, read_record

STEPS, PERIOD = 12, 6
FLIGHT = sets(f"coordination.steps={STEPS}", f"coordination.period_steps={PERIOD}", "fleet.battery=[4.0, 100.0]")


pytestmark = pytest.mark.xdist_group("watch")  # one fleet for all


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A run by processes, the records that an onlooker had of it, and the onlooker, who is still there."""
    folder = tmp_path_factory.mktemp("flown")
    config = folder / "run-hosts" / "live.toml"
    up = skyrelay(
        "up", "--no-live", "--out", folder / "run", *FLIGHT, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL
    )
    for line in up.stderr:
        if line.startswith("coordinator"):  # the last to be started
            break
    while not config.exists():
        assert up.poll() is None
    said = []
    watch = Watch(load_watch(config), said.append)
    records = []
    try:
        while up.poll() is None:
            records += watch.look()
        assert up.returncode == 0, up.stderr.read()
        while not any(alert.kind == "no-quorum" for record in records for alert in record.alerts):
            records += watch.look()  # the chain has ended with the run
        yield read_run(folder / "run"), records, watch, said
    finally:
        watch.close()
        up.kill()
        up.wait()
        up.stderr.close()


def test_every_step_is_told_as_it_was_flown(flown):
    run, records, watch, _ = flown
    last = {record.step: record for record in records}
    assert set(range(STEPS)) <= set(last)
    compared = 0
    # A period's last step may be told when its selection is over already; and at its first step the record has the
    # fleet before the new selection, of which the beacons of that step are.
    for step in sorted(set(range(STEPS)) - {PERIOD - 1, PERIOD, STEPS - 1}):
        rows = run.uavs["step"] == step
        columns = (run.uavs[name][rows].tolist() for name in ("uav", "x", "y", "zone", "battery", "selected"))
        flown_at = {name: rest for name, *rest in zip(*columns, strict=True)}
        for uav in last[step].uavs:
            x, y, zone, battery, selected = flown_at[uav.id]
            assert (uav.zone, uav.selected) == (zone, selected), (step, uav)
            if selected:
                assert (uav.x, uav.y) == (x, y)
                assert uav.battery == pytest.approx(battery, abs=1e-4)
                assert uav.age == 0.0
        rows = run.vehicles["step"] == step
        columns = (run.vehicles[name][rows].tolist() for name in ("vehicle", "x", "y", "uav", "covered"))
        there = {name: tuple(rest) for name, *rest in zip(*columns, strict=True)}
        for vehicle in last[step].vehicles:
            if vehicle.uav:
                assert vehicle[1:] == there[vehicle.id], (step, vehicle)
                compared += 1
        served = {name for name, (_, _, uav, _) in there.items() if uav}
        assert served == {vehicle.id for vehicle in last[step].vehicles if vehicle.uav}
    assert compared > 50
    assert watch.gate.dropped.total() == 0


def test_every_event_of_the_chain_is_told_once_and_under_its_step(flown):
    run, records, *_ = flown
    told = [(event.block, event.name) for record in records for event in record.events]
    order = zip(run.events["block"].tolist(), run.events["name"], strict=True)
    assert sorted(told) == sorted(order)
    steps = dict(
        zip(zip(run.events["block"].tolist(), run.events["name"], strict=True), run.events["step"], strict=True)
    )
    allocated = [(r.step, e) for r in records for e in r.events if e.name == "UAVAllocated"]
    assert allocated
    for step, event in allocated:
        assert step == steps[event.block, event.name]
    names = {value for record in records for event in record.events for value in event.arguments[1::2]}
    assert set(run.vehicles["vehicle"]) & names  # members by their names, not their addresses


def test_low_batteries_and_a_chain_that_is_gone_are_alerts(flown):
    run, records, _, said = flown
    alerts = [alert for record in records for alert in record.alerts]
    assert {alert.kind for alert in alerts} == {"low-battery", "no-quorum"}
    assert {alert.about for alert in alerts if alert.kind == "low-battery"} <= set(run.uavs["uav"])
    assert "does not answer" in said[-1]


@pytest.mark.survival
def test_a_page_is_served_by_up_itself_and_ends_with_it(tmp_path):
    up = skyrelay("up", "--out", tmp_path / "run", *FLIGHT, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    try:
        for line in up.stderr:
            if line.startswith("live") and "http" in line:
                break
        port = int(line.rsplit(":", 1)[1].strip("/\n"))

        async def hear():
            while True:
                try:
                    async with connect(f"ws://127.0.0.1:{port}/feed", subprotocols=[PROTOCOL], max_size=None) as page:
                        header = read_header(await page.recv())
                        while True:
                            record = read_record(await page.recv())
                            if record.step >= 2:
                                return header, record
                except OSError:
                    await asyncio.sleep(0.05)  # it is not up yet

        header, record = asyncio.run(asyncio.wait_for(hear(), 120))
        assert (header.name, header.period_steps) == ("bologna", PERIOD)
        assert any(uav.selected for uav in record.uavs)
        assert up.wait(120) == 0, up.stderr.read()

        async def refused():
            async with connect(f"ws://127.0.0.1:{port}/feed", subprotocols=[PROTOCOL]):
                pass

        with pytest.raises(OSError):
            asyncio.run(refused())
    finally:
        up.kill()
        up.wait()
        up.stderr.close()


GOOD = {
    "scenario": "scenario.toml",
    "area": {"x0": 0.0, "y0": 0.0, "side": 1000.0, "columns": 1, "rows": 1},
    "chain": {"urls": ["http://127.0.0.1:9"], "chain_id": 1, "contract": "0x" + 40 * "a"},
}


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"chains": {}}, "chains: expected a known key"),
        ({"chain": {}}, r"chain\.urls: expected a value"),
        ({"members": {"0x1": "a"}}, "members"),
        ({"plane": 1}, "plane"),
        ({"bus": {"connect": ["somewhere"]}}, "bus"),
    ],
)
def test_a_file_that_does_not_fit_is_one_line(tmp_path, change, place):
    path = tmp_path / "live.toml"
    path.write_text(tomli_w.dumps(GOOD | change))
    with pytest.raises(UsageError, match=place) as fault:
        load_watch(path)
    assert len(str(fault.value).splitlines()) == 1


def test_a_chain_that_is_not_there_is_said_at_once(tmp_path):
    (tmp_path / "scenario.toml").write_text('name = "city"\n')
    path = tmp_path / "live.toml"
    path.write_text(tomli_w.dumps(GOOD))
    with pytest.raises(ChainError, match=r"127\.0\.0\.1:9"):
        Watch(load_watch(path), print)
