"""Runs at the ends of what a scenario may say: they are played, or refused in one line; no traceback."""

import pytest

pytestmark = pytest.mark.xdist_group("e2e")

TINY = [
    "mobility.source=random-waypoint",
    "mobility.vehicles=6",
    "mobility.area=1500",
    "zones.columns=1",
    "zones.rows=2",
    "fleet.uavs=4",
    "coordination.steps=4",
    "coordination.period_steps=2",
]
ENDS = [
    # everything as small as it may be
    ["mobility.area=1", "fleet.range=0.1", "fleet.speed=1e-300", "coordination.step_seconds=0.01"],
    # everything as large
    [
        "mobility.area=1e6",
        "fleet.range=1e6",
        "fleet.speed=1000",
        "fleet.altitude=65535",
        "mobility.speed=[1000, 1000]",
        "coordination.step_seconds=3600",
        "selection.max_distance=1e6",
        "energy.charging_radius=1e6",
    ],
    ["selection.max_demand=2147483.647", "demand.bandwidth=[0.002, 2147483.647]", "fleet.bandwidth=[20, 20]"],
    ["selection.max_uav_bandwidth=2147483.647", "fleet.bandwidth=[2147483.647, 2147483.647]"],
    ["selection.max_payment=4294967295", "demand.payment=[4294967295, 4294967295]"],
    [
        "selection.max_demand=0.002",
        "demand.bandwidth=[0.002, 0.002]",
        "selection.max_payment=1",
        "demand.payment=[0, 1]",
    ],
    ["energy.hover_per_minute=6000", "energy.move_per_minute=6000", "energy.reserve=100", "fleet.battery=[0, 0]"],
    ["energy.charge_per_minute=6000", "energy.charging_point=[0, 1]", "energy.charging_radius=0.1"],
    ["mobility.vehicles=1", "fleet.uavs=1", "fleet.bandwidth=[0, 0]", "coordination.steps=1"],
    ["fleet.range=0.1", "selection.rounds=1000", "coordination.patience=0.01", "coordination.period_steps=100000"],
    ["selection.qou_weights=[1, 0, 0, 0]", "selection.qov_weights=[1e-300, 0, 0, 1]", "seed=4294967295"],
]


@pytest.mark.parametrize("ends", ENDS, ids=lambda ends: ends[0])
def test_a_run_at_the_ends_is_played_or_refused_in_one_line(tmp_path, run, capsys, ends):
    sets = [part for override in (*TINY, *ends) for part in ("--set", override)]
    status = run("run", "--out", tmp_path / "run", *sets)
    err = capsys.readouterr().err
    assert status in (0, 2)
    assert "Traceback" not in err
    if status == 0:
        assert run("audit", tmp_path / "run") == 0
    else:
        assert len([line for line in err.splitlines() if line.startswith("skyrelay: ")]) == 1
        assert not (tmp_path / "run").exists()
