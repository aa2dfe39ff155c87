"""The small scenario that several tests play with processes, and what its agents decided."""

import json
import subprocess
import sys

import pyarrow.parquet as pq

SMALL = ["mobility.penetration=0.08", "fleet.uavs=18", "coordination.steps=24", "coordination.period_steps=8"]
LAUNCH = "from skyrelay.cli.main import main; main()"


def sets(*overrides):
    return [part for override in (*SMALL, *overrides) for part in ("--set", override)]


def skyrelay(*arguments, **options):
    return subprocess.Popen([sys.executable, "-c", LAUNCH, *map(str, arguments)], text=True, **options)


def _rows(folder, table, columns):
    return pq.read_table(folder / f"{table}.parquet", columns=columns).to_pylist()


def decided(folder):
    """Who proposed to whom, who serves whom, how everyone moved: all that agents decide."""
    names = {row["address"]: row["name"] for row in _rows(folder, "accounts", ["address", "name"])}
    proposals = ["period", "round", "zone", "vehicle", "uav", "qou", "qov", "score", "demand_kbps", "accepted", "order"]
    moves = ["step", "uav", "x", "y", "zone", "selected", "battery", "action"]
    events = _rows(folder, "events", ["name", "args"])
    allocated = [json.loads(row["args"]) for row in events if row["name"] == "UAVAllocated"]
    selections = [(names[args["uav"]], [names[vehicle] for vehicle in args["selected"]]) for args in allocated]
    return {
        "proposals": _rows(folder, "proposals", proposals),
        "candidates": _rows(folder, "candidates", ["period", "vehicle", "uav", "qou"]),
        "selections": selections,
        "moves": _rows(folder, "uavs", moves),
        "vehicles": _rows(folder, "vehicles", ["step", "vehicle", "uav", "covered"]),
    }
