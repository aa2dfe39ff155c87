"""Hosts by their own clocks: the timetable, a clock that is off, and a run in which nobody asks anybody."""

import itertools

import pytest
from town_of_processes import Up, audited, decided, once

from skyrelay.core.scenario import load_scenario
from skyrelay.pilot.free import TOLERATED, Wall
from skyrelay.pilot.timetable import Timetable
from skyrelay.protocol.messages import RESELECTION, Phase

pytestmark = pytest.mark.survival

SHORT = ["selection.rounds=2", "coordination.steps=16"]
FREE = ["--free-running", "--slot", 1.5, "--speed", 4]


class Machine:
    """A machine's clock that goes on when it is waited for."""

    def __init__(self, now):
        self.time, self.slept = now, []

    def now(self):
        return self.time

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.time += seconds


def test_the_timetable_has_every_phase_in_order_and_no_gap():
    scenario = load_scenario("bologna", ["coordination.steps=25", "selection.rounds=3"], 1)
    dues = list(Timetable.of(scenario, begin=1000.0, slot=2.0, step=1.0))
    assert dues[0].begin == 1000.0
    assert all(a.end == pytest.approx(b.begin) for a, b in itertools.pairwise(dues))
    assert dues[-1].end == pytest.approx(1000.0 + 2 * 2.0 + 2 * (5 + 2 * 3) * 2.0 + 25 * 1.0)
    periods = [due.tick.period for due in dues if due.tick.phase is Phase.CLOSE]
    assert periods == [0, 1]
    asked = [due.tick.phase for due in dues if due.tick.period == 1 and due.tick.phase is not Phase.LAND]
    assert asked[:3] == [Phase.CLOSE, Phase.REPORT, Phase.RATE]
    assert asked[3:9] == [Phase.PROPOSE, Phase.ALLOCATE] * 3
    assert asked[9:12] == [Phase.DETERMINE, Phase.BEACON, Phase.DECIDE]
    steps = [(due.tick.step, due.tick.time) for due in dues if due.tick.phase is Phase.BEACON]
    assert steps == [(step, step * scenario.coordination.step_seconds) for step in range(25)]


def test_a_reselection_has_its_phases_before_its_step():
    scenario = load_scenario("bologna", ["coordination.steps=25", "coordination.reselect_steps=8"], 1)
    ticks = [due.tick for due in Timetable.of(scenario, 0.0, 1.0, 1.0)]
    again = [number for number, tick in enumerate(ticks) if tick.phase is Phase.LEAVE]
    assert [ticks[number].step for number in again] == [8, 16]
    assert [tick.phase for tick in ticks[again[0] : again[0] + 6]] == [*RESELECTION, Phase.BEACON]


def test_where_uavs_are_dispatched_the_timetable_has_a_time_for_it():
    scenario = load_scenario("bologna", ["coordination.dispatch=true"], 1)
    phases = [due.tick.phase for due in Timetable.of(scenario, 0.0, 1.0, 1.0) if due.tick.period == 1]
    assert phases[:5] == [Phase.CLOSE, Phase.LAND, Phase.REPORT, Phase.DISPATCH, Phase.RATE]


@pytest.mark.parametrize(("off", "word"), [(-5.0, "5.0 s behind"), (5.0, "5.0 s ahead")])
def test_a_clock_that_is_off_is_told_once_and_set_right(off, word):
    machine, said = Machine(2000.0 + off), []
    wall = Wall(machine.now, said.append, machine.sleep)
    for _ in range(3):
        wall.set_by(wall.now() if said else 2000.0)
    (line,) = said
    assert word in line
    assert wall.now() == pytest.approx(2000.0)
    wall.wait_until(2003.0)
    assert machine.slept == [pytest.approx(3.0)]
    wall.wait_until(2001.0)  # is over
    assert wall.now() == pytest.approx(2003.0)


@pytest.mark.parametrize("told", [None, 2000.0 + 0.9 * TOLERATED])
def test_a_clock_is_left_alone_where_it_is_right_or_nobody_says_otherwise(told):
    machine, said = Machine(2000.0), []
    wall = Wall(machine.now, said.append, machine.sleep)
    wall.set_by(told)
    assert wall.now() == 2000.0
    assert not said


@pytest.mark.parametrize("told", [1e9, -1e9, 1e300])
def test_a_receiver_that_cannot_be_right_is_not_believed(told):
    machine, said = Machine(2e9), []
    wall = Wall(machine.now, said.append, machine.sleep)
    for _ in range(3):
        wall.set_by(told)
        wall.set_by(2e9)
    (line,) = said
    assert "is not believed" in line
    assert wall.now() == 2e9


def test_hosts_by_their_own_clocks_one_of_them_5_s_off(tmp_path):
    """Nothing is lost or doubled, the UAVs fly, and the host says in one line how its clock is."""
    up = Up(tmp_path / "up", *SHORT, options=[*FREE, "--elsewhere", "uav"])
    try:
        up.start("uavs", lambda text: text.replace("[clock]", "[clock]\noff = -5.0"))
        up.end()
    finally:
        up.stop()
    assert up.log("uavs").count("clock: is") == 1
    assert "clock: is 5.0 s behind what receivers say" in up.log("uavs")
    many = decided(up.folder)
    once(many)
    assert any(row["action"] for row in many["moves"])
    audited(up.folder)
