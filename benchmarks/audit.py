"""How long the audit of a run takes: 10,000 proposals and the selections among them, checked from the record alone.

    python benchmarks/audit.py [--proposals 10000] [--uavs 40] [--json]

500 vehicles propose to the UAVs of their zone in every period, until there are so many proposals; the record is on the
disk, with its summary and its table of events, as `skyrelay run` leaves them. The audit executes every block again and
follows every event with the Python reference. The level to reach: under a minute.
"""

from __future__ import annotations

import argparse
import json
import random
import tempfile
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from skyrelay.chain.client import IovClient, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.proof.audit import audit_run

VEHICLES = 500
ZONES = (1, 2, 3, 4)


def play(folder: Path, proposals: int, uavs: int) -> None:
    """Leave a run folder with so many proposals."""
    rng = random.Random(1)  # noqa: S311
    with EmbeddedChain(folder / "chain") as chain:
        admin = chain.account("administrator")
        client = IovClient.deploy(chain, Settings(), admin)
        client.execute([client.grant_role(admin, Role.COORDINATOR, admin)])
        zone_of = {chain.account(f"vehicle {i}"): ZONES[i % len(ZONES)] for i in range(VEHICLES)}
        client.execute(
            [
                client.register_uav(
                    chain.account(f"uav {i}"),
                    UavRecord(rng.uniform(0, 2000), rng.uniform(0, 2000), 100, 90, 20_000, ZONES[i % len(ZONES)]),
                )
                for i in range(uavs)
            ]
        )

        def record(zone: int) -> VehicleRecord:
            return VehicleRecord(rng.uniform(0, 2000), rng.uniform(0, 2000), rng.uniform(0, 700), zone)

        client.execute([client.register_vehicle(vehicle, record(zone)) for vehicle, zone in zone_of.items()])
        uavs_of = {zone: client.zone_uavs(zone) for zone in ZONES}
        left, round_ = proposals, 1
        while left > 0:
            asking = list(zone_of.items())[:left]
            left -= len(asking)
            client.execute([client.update_vehicle_info(vehicle, record(zone)) for vehicle, zone in asking])
            client.execute(
                [
                    client.submit_veh_selection(vehicle, rng.choice(uavs_of[zone]), rng.uniform(500, 4000), round_)
                    for vehicle, zone in asking
                ]
            )
            client.execute([client.allocate_zone(admin, zone, 10_000) for zone in ZONES])
            client.execute([client.reset_lists_for_zone(admin, zone) for zone in ZONES])
            round_ += 2
        events = client.events()
        columns = {
            "block": [event.block for event in events],
            "tx": [event.transaction for event in events],
            "log": [event.index for event in events],
            "name": [event.name for event in events],
            "args": [json.dumps(event.args) for event in events],
        }
        pq.write_table(pa.table(columns), folder / "events.parquet", write_page_checksum=True)
        summary = {"chain_head": chain.head, "blocks": chain.block_number, "contract": client.address}
        (folder / "summary.json").write_text(json.dumps(summary))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--proposals", type=int, default=10_000)
    parser.add_argument("--uavs", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        play(Path(name), options.proposals, options.uavs)
        start, processor = time.perf_counter(), time.process_time()
        report = audit_run(Path(name))
        seconds, processor = time.perf_counter() - start, time.process_time() - processor
    if not report.agrees:
        raise SystemExit(f"the audit differs: {report.differences[0]}")
    checked = report.checked
    result = {"seconds": seconds, "processor_seconds": processor, "checked": dict(checked)}
    if options.json:
        print(json.dumps(result, indent=2))
        return
    counts = ", ".join(f"{checked[name]:,} {name}" for name in ("transactions", "proposals", "vehicles selected"))
    print(f"{counts}: audited in {seconds:.1f} s ({processor:.1f} s of processor time)")


if __name__ == "__main__":
    main()
