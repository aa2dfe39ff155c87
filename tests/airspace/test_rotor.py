"""The power of flight against the paper's figures, and what a run makes of it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from skyrelay.airspace.law import Law
from skyrelay.airspace.rotor import Rotor, per_minute
from skyrelay.core.errors import ScenarioError
from skyrelay.core.resolved import resolve
from skyrelay.core.scenario import load_scenario
from skyrelay.core.zones import ZoneGrid

GRID = ZoneGrid(0.0, 0.0, 1000.0, 1, 1)


def law(*overrides):
    return Law.of(resolve(load_scenario("bologna", overrides), GRID), GRID)


@pytest.mark.parametrize(
    ("speed", "power"),
    # profile 79.856 W (1 + V^2 / 4800), lift 88.628 W x sqrt(sqrt(1 + x^2) - x) at x = V^2 / 32.482, fuselage
    # 0.0092426 V^3
    [(0.0, 168.48), (10.0, 126.03), (30.0, 356.28)],
)
def test_power_is_the_paper_s(speed, power):
    assert Rotor().power(np.asarray(speed)) == pytest.approx(power, abs=0.05)
    assert float(Rotor().power(jnp.float32(speed))) == pytest.approx(power, abs=0.05)


def test_flying_slowly_is_cheaper_than_hovering_and_cheapest_at_the_paper_s_speed():
    speeds = np.arange(0.0, 40.0, 0.1)
    assert speeds[np.argmin(Rotor().power(speeds))] == pytest.approx(10.2, abs=0.2)


def test_a_battery_lasts_for_its_energy():
    assert per_minute(np.asarray(60.0), 100.0) == pytest.approx(1.0)


def test_a_run_flies_by_the_scenario_s_model():
    assert law().energy == load_scenario().energy
    assert law("energy.battery=1", "energy.move_per_minute=9").energy.move_per_minute == 9
    rotary = law("energy.model=rotary-wing", "energy.battery=100", "fleet.speed=10", "energy.move_per_minute=9")
    assert rotary.energy.hover_per_minute == pytest.approx(168.48 / 60, abs=1e-3)
    assert rotary.energy.move_per_minute == pytest.approx(126.03 / 60, abs=1e-3)
    # 97 % above the reserve, of 100 Wh at 126 W, at 10 m/s
    assert rotary.flight(100.0) == pytest.approx(97 / 126.03 * 3600 * 10, rel=1e-3)
    assert load_scenario("bologna", ("energy.model=rotary-wing",)).energy.hover_per_minute == 4.0


def test_what_is_on_board_takes_its_power_whether_a_uav_moves_or_not():
    rotary = law("energy.model=rotary-wing", "energy.battery=100", "fleet.speed=10", "energy.payload=30").energy
    assert rotary.hover_per_minute == pytest.approx(198.48 / 60, abs=1e-3)
    assert rotary.move_per_minute == pytest.approx(156.03 / 60, abs=1e-3)


@pytest.mark.parametrize("wrong", ["energy.model=fixed-wing", "energy.battery=0", "energy.battery=nan"])
def test_a_wrong_battery_or_model_is_one_line(wrong):
    with pytest.raises(ScenarioError, match=wrong.partition("=")[0]):
        load_scenario("bologna", (wrong,))
