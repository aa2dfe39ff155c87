"""`skyrelay explain`, on run folders whose tables come from real selections."""

import json
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import typer
from selection_tables import drawn, uavs_at, vehicles_at
from typer.testing import CliRunner

from skyrelay.cli import explain as command
from skyrelay.core.errors import RunFolderError, SelectionError, UsageError
from skyrelay.core.scenario import Coordination, Scenario, to_toml
from skyrelay.core.scenario import Selection as Settings
from skyrelay.runfolder.reader import read_rows, read_scenario
from skyrelay.runfolder.schema import SCHEMAS
from skyrelay.selection import qou, select
from skyrelay.selection.explain import explain as explain_tables

SCORE_UNIT = 1e-12
TABLES = ("proposals", "candidates", "fleet", "members", "vehicles")
PERIOD_STEPS = 2


def explain(folder, vehicle, period=None):
    tables = {name: read_rows(folder, name) for name in TABLES[:-1]}
    steps = read_rows(folder, "vehicles", vehicle=vehicle)
    return explain_tables(**tables, steps=steps, vehicle=vehicle, period_steps=PERIOD_STEPS, period=period)


def reason(folder, told):
    return command.reason(told, read_scenario(folder).selection)


def write_run(folder, periods, rounds=1, rule=None):
    """The tables and the scenario that a run folder has, of one selection for each period.

    At every second step nobody is in range; who is has half of what it asks for, and half of that is delivered.
    """
    rule = rule or Settings()
    tables = {name: [] for name in TABLES}
    results = []
    for period, (vehicles, uavs) in enumerate(periods):
        chosen = select(vehicles, uavs, settings=rule, rounds=rounds)
        results.append(chosen)
        last = {}
        order = 0
        rows = []
        for number, played in enumerate(chosen.rounds):
            for v, u, quality, score in zip(
                played.vehicle.tolist(), played.uav.tolist(), played.qou.tolist(), played.score.tolist(), strict=True
            ):
                last[v] = order
                rows.append(
                    {
                        "period": period,
                        "round": number,
                        "zone": int(vehicles.zone[v]),
                        "vehicle": vehicles.ids[v],
                        "uav": uavs.ids[u],
                        "qou": quality,
                        "qov": 0,
                        "score": round(score / SCORE_UNIT),
                        "demand_kbps": int(vehicles.demand[v]),
                        "accepted": (v, u),
                        "order": order,
                    }
                )
                order += 1
        for row in rows:
            v, u = row["accepted"]
            row["accepted"] = bool(chosen.assignment[v] == u and last[v] == row["order"])
        tables["proposals"] += rows
        for v, u in np.argwhere(np.isfinite(qou(vehicles, uavs, rule))).tolist():
            quality = float(qou(vehicles, uavs, rule)[v, u])
            tables["candidates"].append(
                {"period": period, "vehicle": vehicles.ids[v], "uav": uavs.ids[u], "qou": quality}
            )
        tables["fleet"] += [
            {
                "period": period,
                "uav": uavs.ids[u],
                "zone": int(uavs.zone[u]),
                "x": float(uavs.x[u]),
                "y": float(uavs.y[u]),
                "bandwidth_kbps": int(uavs.bandwidth[u]),
                "battery": float(uavs.battery[u]),
                "reputation": float(uavs.reputation[u]),
            }
            for u in range(len(uavs))
        ]
        tables["members"] += [
            {
                "period": period,
                "vehicle": vehicles.ids[v],
                "zone": int(vehicles.zone[v]),
                "x": float(vehicles.x[v]),
                "y": float(vehicles.y[v]),
                "demand_kbps": int(vehicles.demand[v]),
                "payment": float(vehicles.payment[v]),
                "reputation": float(vehicles.reputation[v]),
            }
            for v in range(len(vehicles))
        ]
        nobody = {"uav": "", "static_uav": "", "static_covered": False, "static_carried_kbps": 0.0}
        for step in range(period * PERIOD_STEPS + 1, (period + 1) * PERIOD_STEPS + 1):
            for v, demand in enumerate(vehicles.demand.tolist()):
                u = int(chosen.assignment[v])
                covered = u >= 0 and step % 2 == 0
                got = {"covered": covered, "carried_kbps": demand / 2 * covered, "delivered_kbps": demand / 4 * covered}
                row = nobody | {"step": step, "vehicle": vehicles.ids[v], "x": 0.0, "y": 0.0, "zone": 1} | got
                by = {"uav": uavs.ids[u] if u >= 0 else "", "demand_kbps": int(demand), "static_delivered_kbps": 0.0}
                tables["vehicles"].append(row | by)
    folder.mkdir(exist_ok=True)
    for name, rows in tables.items():
        pq.write_table(pa.Table.from_pylist(rows, SCHEMAS[name]), folder / f"{name}.parquet")
    flight = Coordination(period_steps=PERIOD_STEPS)
    settings = rule.model_copy(update={"rounds": rounds})
    (folder / "scenario.toml").write_text(to_toml(Scenario(selection=settings, coordination=flight)))
    return results


@pytest.mark.parametrize("rounds", [1, 50])
def test_every_vehicle_of_a_run_is_told_what_happened(tmp_path, rounds):
    vehicles, uavs = drawn(12, vehicles=32, uavs=5, side=3000.0, zones=2)
    (chosen,) = write_run(tmp_path / "run", [(vehicles, uavs)], rounds)
    quality = qou(vehicles, uavs, Settings())
    outcomes = set()
    for v, name in enumerate(vehicles.ids):
        told = explain(tmp_path / "run", name)
        u = int(chosen.assignment[v])
        assert told.served_by == (uavs.ids[u] if u >= 0 else None)
        assert [c.uav for c in told.candidates] == [uavs.ids[i] for i in np.argsort(-quality[v], kind="stable")][
            : int(np.isfinite(quality[v]).sum())
        ]
        asked = [(n, int(r.uav[r.vehicle == v][0])) for n, r in enumerate(chosen.rounds) if (r.vehicle == v).any()]
        assert [(ask.round, ask.uav) for ask in told.asks] == [(n, uavs.ids[i]) for n, i in asked]
        for ask in told.asks:
            outcomes.add(ask.outcome)
            fits = vehicles.demand[v] <= ask.left
            assert fits == (ask.outcome == "accepted")
            assert ask.left == ask.bandwidth - sum(rival.demand for rival in ask.taken_by)
            assert all(rival.score >= ask.score for rival in ask.taken_by)
        if told.asks:
            assert (told.asks[-1].outcome == "accepted") == (u >= 0)
            assert reason(tmp_path / "run", told).startswith("Served by" if u >= 0 else "Not served: ")
    assert outcomes == {"accepted", "refused"} | ({"displaced"} if rounds > 1 else set())


def one(tmp_path, vehicles, uavs, rounds=1, rule=None):
    write_run(tmp_path / "run", [(vehicles, uavs)], rounds, rule)
    return explain(tmp_path / "run", vehicles.ids[-1])


def test_bandwidth_that_others_took(tmp_path):
    told = one(tmp_path, vehicles_at([0, 0, 0], reputation=[90, 80, 10]), uavs_at([0, 3000], bandwidth=[5000, 5000]))
    assert [rival.vehicle for rival in told.asks[0].taken_by] == ["v0", "v1"]
    assert reason(tmp_path / "run", told) == (
        "Not served: 2 vehicles before it in u0's list left 1.000 Mbit/s of the 2.000 Mbit/s it asks; "
        "never asked: 1 candidate (selection.rounds = 1)."
    )
    text = command.to_text(told, Settings())
    assert "place 3 of 3 in its list" in text
    assert "v1   2.000 Mbit/s   before this vehicle" in text


def test_a_demand_above_the_uavs_whole_bandwidth(tmp_path):
    told = one(tmp_path, vehicles_at([0], demand=[6000]), uavs_at([0], bandwidth=[5000]))
    assert reason(tmp_path / "run", told) == "Not served: it asks 6.000 Mbit/s, more than u0 has at all (5.000 Mbit/s)."


def test_what_a_vehicle_had_and_why(tmp_path):
    told = one(tmp_path, vehicles_at([0]), uavs_at([0]))
    assert command.had(told) == (
        "It had 0.500 Mbit/s of the 2.000 Mbit/s it asks, on average, because it was in range of u0 at 1 of 2 steps, "
        "whose radio held less than it asks for at 1 of them, and 0.250 Mbit/s of it reached a gateway."
    )
    assert "which left to be charged and was away at 1" in command.had(told, 1)
    assert command.had(one(tmp_path, vehicles_at([0]), uavs_at([9000]))) == (
        "It had 0 Mbit/s, because no UAV served it."
    )


def test_nobody_in_reach(tmp_path):
    told = one(tmp_path, vehicles_at([0]), uavs_at([5000]))
    why = "the nearest of 1 UAV of its zone, u0, is 5,000 m away, beyond selection.max_distance (3,000 m)"
    assert why in reason(tmp_path / "run", told)


def test_nobody_in_the_zone(tmp_path):
    told = one(tmp_path, vehicles_at([0]), uavs_at([0], zone=[2]))
    assert "no UAV is in its zone (1)" in reason(tmp_path / "run", told)


def test_only_uavs_without_quality(tmp_path):
    uavs = uavs_at([3000], bandwidth=[0], battery=[0], reputation=[0])
    assert "a QoU of 0" in reason(tmp_path / "run", one(tmp_path, vehicles_at([0]), uavs))


def test_the_last_unserved_period_is_told_unless_one_is_named(tmp_path):
    served = (vehicles_at([0]), uavs_at([0]))
    unserved = (vehicles_at([0]), uavs_at([9000]))
    write_run(tmp_path / "run", [served, unserved, served])
    assert explain(tmp_path / "run", "v0").period == 1
    assert explain(tmp_path / "run", "v0", 2).served_by == "u0"
    with pytest.raises(UsageError, match="--period: is 3; expected a period in which v0 was there: 0, 1, 2"):
        explain(tmp_path / "run", "v0", 3)


def test_a_vehicle_that_never_was_is_refused_with_a_suggestion(tmp_path):
    write_run(tmp_path / "run", [drawn(1, vehicles=12, uavs=3)])
    with pytest.raises(UsageError, match=r"--vehicle: is 'v111'; .*did you mean v1"):
        explain(tmp_path / "run", "v111")


def test_tables_that_contradict_each_other_are_refused(tmp_path):
    write_run(tmp_path / "run", [drawn(1, vehicles=12, uavs=3)])
    tables: dict[str, Any] = {name: read_rows(tmp_path / "run", name) for name in TABLES[:-1]}
    asked = tables["proposals"][0]
    tables["fleet"] = [row for row in tables["fleet"] if row["uav"] != asked["uav"]]
    with pytest.raises(SelectionError, match=f"proposals: uav: is '{asked['uav']}'; expected a UAV of the fleet"):
        explain_tables(**tables, steps=[], vehicle=asked["vehicle"], period_steps=PERIOD_STEPS)


@pytest.mark.parametrize("name", ["scenario.toml", "proposals.parquet", "candidates.parquet", "fleet.parquet"])
def test_a_missing_or_damaged_file_is_named(tmp_path, name):
    write_run(tmp_path / "run", [drawn(1, vehicles=12, uavs=3)])
    path = tmp_path / "run" / name
    path.write_bytes(b"\x00 no table")
    with pytest.raises(RunFolderError, match=name.replace(".", r"\.")):
        command.command(tmp_path / "run", "v0")
    path.unlink()
    with pytest.raises(RunFolderError, match="it is not there"):
        command.command(tmp_path / "run", "v0")


def test_no_folder_is_named(tmp_path):
    with pytest.raises(RunFolderError, match="run folder"):
        command.command(tmp_path / "nowhere", "v0")


def test_the_command_prints_the_same_as_the_call(tmp_path):
    write_run(tmp_path / "run", [drawn(6, vehicles=30, uavs=4, side=3000.0)])
    app = typer.Typer()
    app.command()(command.command)
    told = explain(tmp_path / "run", "v3")
    printed = CliRunner().invoke(app, [str(tmp_path / "run"), "--vehicle", "v3"])
    assert printed.stdout.strip() == command.to_text(told, Settings())
    parsed = json.loads(CliRunner().invoke(app, [str(tmp_path / "run"), "--vehicle", "v3", "--json"]).stdout)
    assert parsed["reason"] == reason(tmp_path / "run", told)
    assert parsed["had"] == command.had(told)
    assert len(parsed["candidates"]) == len(told.candidates)
