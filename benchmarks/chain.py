"""Transactions a second and time to finality for a round of 200 vehicles: embedded, and on a network of validators.

    python benchmarks/chain.py [--devnet [--validators 4]] [--url URL ...] [--confirmations N] [--vehicles 200]
                               [--uavs 40] [--json]

--devnet starts QBFT validators on this machine for the measurement (`make nodes` builds them); --url takes a network
that runs already.

A round: every vehicle registers, updates its record and proposes; the zones are allocated in pieces of 60 proposals
and reset. "Finality" is the time from handing one transaction over until it cannot be undone: embedded, on the disk;
on a node, mined with the confirmations asked for. The paper quotes 3,000 TPS for Quorum from elsewhere; it is printed
beside, not reproduced. A network makes a block a second: each stage waits for the next one or two however few its
transactions are, so --vehicles 2000 tells more of what it can take. The rate by processor time is what a quiet machine
would give; on a network it counts this client alone.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Call, Chain
from skyrelay.chain.client import IovClient, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.node.devnet import Devnet
from skyrelay.chain.proof.audit import audit_node
from skyrelay.chain.proof.replay import replay

PAPER_TPS = 3000
ZONES = range(1, 5)


class Round:
    """One round, timed stage by stage."""

    def __init__(self, chain: Chain, vehicles: int, uavs: int) -> None:
        self.chain = chain
        self.admin = chain.account("benchmark administrator")
        self.vehicles = [chain.account(f"benchmark vehicle {i}") for i in range(vehicles)]
        self.uavs = [chain.account(f"benchmark uav {i}") for i in range(uavs)]
        self.client = IovClient.deploy(chain, Settings(), self.admin)
        self.client.execute([self.client.grant_role(self.admin, Role.COORDINATOR, self.admin)])
        self.stages: dict[str, dict[str, float]] = {}

    def play(self) -> dict[str, Any]:
        """Figures of the round."""
        processor = time.process_time()
        client, zone_of = self.client, [ZONES[i % len(ZONES)] for i in range(len(self.vehicles))]
        self._stage(
            "register UAVs",
            lambda: [
                client.register_uav(
                    u,
                    UavRecord(
                        1800.0 * i / len(self.uavs), 1000.0 * i / len(self.uavs), 100, 80, 20_000, ZONES[i % len(ZONES)]
                    ),
                )
                for i, u in enumerate(self.uavs)
            ],
        )
        records = [
            VehicleRecord(1800.0 * i / len(self.vehicles), 1000.0 * i / len(self.vehicles), 300, zone)
            for i, zone in enumerate(zone_of)
        ]
        self._stage(
            "register",
            lambda: [client.register_vehicle(v, record) for v, record in zip(self.vehicles, records, strict=True)],
        )
        self._stage(
            "update",
            lambda: [
                client.update_vehicle_info(v, replace(record, x=record.x + 1.0))
                for v, record in zip(self.vehicles, records, strict=True)
            ],
        )
        uavs = {zone: client.zone_uavs(zone) for zone in ZONES}
        rounds = {zone: info.round for zone in ZONES if (info := client.zone_info(zone)) is not None}
        self._stage(
            "submit",
            lambda: [
                client.submit_veh_selection(v, uavs[zone][i % len(uavs[zone])], 1000 + i % 3000, rounds[zone])
                for i, (v, zone) in enumerate(zip(self.vehicles, zone_of, strict=True))
            ],
        )
        open_zones = list(ZONES)
        while open_zones:
            receipts = self._stage("allocate", partial(_allocations, client, self.admin, open_zones))
            done = {event.args["zone"] for event in client.events_of(receipts) if event.name == "ZoneAllocated"}
            open_zones = [zone for zone in open_zones if zone not in done]
        self._stage("reset", lambda: [client.reset_lists_for_zone(self.admin, zone) for zone in ZONES])
        processor = time.process_time() - processor
        finality = []
        for i in range(10):
            start = time.perf_counter()
            client.execute([client.update_vehicle_info(self.vehicles[i], records[i])])
            finality.append(time.perf_counter() - start)
        transactions = sum(stage["transactions"] for stage in self.stages.values())
        seconds = sum(stage["seconds"] for stage in self.stages.values())
        return {
            "transactions": int(transactions),
            "seconds": seconds,
            "transactions_per_second": transactions / seconds,
            "transactions_per_processor_second": transactions / processor,
            "finality_seconds": statistics.median(finality),
            "stages": self.stages,
        }

    def _stage(self, name: str, build: Callable[[], Sequence[Call]]) -> list[Any]:
        start = time.perf_counter()
        receipts = self.client.execute(build())
        seconds = time.perf_counter() - start
        stage = self.stages.setdefault(name, {"transactions": 0, "seconds": 0.0, "gas": 0})
        stage["transactions"] += len(receipts)
        stage["seconds"] += seconds
        stage["gas"] += sum(receipt.gas_used for receipt in receipts)
        return receipts


def _allocations(client: IovClient, admin: str, zones: list[int]) -> list[Call]:
    return [client.allocate_zone(admin, zone, 60) for zone in zones]


def embedded(vehicles: int, uavs: int) -> dict[str, Any]:
    """On the embedded chain, its record on the disk: a round that translates the contract's code, then another."""
    with tempfile.TemporaryDirectory() as folder:
        with EmbeddedChain(Path(folder)) as chain:
            first = Round(chain, vehicles, uavs).play()
            result = Round(chain, vehicles, uavs).play()
        start = time.perf_counter()
        replayed = replay(Path(folder))
        seconds = time.perf_counter() - start
    if replayed.differences:
        raise SystemExit(f"the record does not replay: {replayed.differences[0]}")
    result["first_round_transactions_per_second"] = first["transactions_per_second"]
    result["replayed_transactions_per_second"] = replayed.transactions / seconds
    return result


def on_node(urls: list[str], confirmations: int, vehicles: int, uavs: int) -> dict[str, Any]:
    """On a node, with fresh keys; then the audit of what it did."""
    chain = NodeChain(urls, Keyring.ephemeral(), confirmations=confirmations, poll=0.1)
    played = Round(chain, vehicles, uavs)
    result = played.play()
    start = time.perf_counter()
    report = audit_node(chain, played.client.address)
    if not report.agrees:
        raise SystemExit(f"the audit differs: {report.differences[0]}")
    return result | {"audit_seconds": time.perf_counter() - start}


def on_devnet(validators: int, vehicles: int, uavs: int) -> dict[str, Any]:
    """On validators of this machine, all of which the client may turn to."""
    with (
        tempfile.TemporaryDirectory() as folder,
        Devnet.create(Path(folder) / "net", validators=validators) as network,
    ):
        return on_node(network.endpoints, 0, vehicles, uavs) | {"validators": validators, "period": network.period}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devnet", action="store_true", help="start validators here for the measurement")
    parser.add_argument("--validators", type=int, default=4, help="of --devnet")
    parser.add_argument("--url", action="append", default=[], help="a node's endpoint; more for its fellows")
    parser.add_argument("--confirmations", type=int, default=0, help="blocks on top before a receipt counts")
    parser.add_argument("--vehicles", type=int, default=200)
    parser.add_argument("--uavs", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    results: dict[str, Any] = {"embedded": embedded(options.vehicles, options.uavs)}
    if options.devnet:
        results["devnet"] = on_devnet(options.validators, options.vehicles, options.uavs)
    if options.url:
        results["node"] = on_node(options.url, options.confirmations, options.vehicles, options.uavs)
    results["paper_quotes_transactions_per_second"] = PAPER_TPS
    if options.json:
        print(json.dumps(results, indent=2))
        return
    for place in ("embedded", "devnet", "node"):
        if place not in results:
            continue
        result = results[place]
        if place == "devnet":
            place = f"devnet of {result['validators']} validators, a block every {result['period']} s"
        print(f"{place}: {result['transactions']} transactions in {result['seconds']:.2f} s")
        for name, stage in result["stages"].items():
            rate, gas = stage["transactions"] / stage["seconds"], stage["gas"] / stage["transactions"]
            print(f"  {name:<14} {int(stage['transactions']):5}  {rate:8,.0f} tx/s  {gas:9,.0f} gas each")
        rate = result["transactions_per_second"]
        print(
            f"  {'all':<14} {result['transactions']:5}  {rate:8,.0f} tx/s, {rate / PAPER_TPS:.2f} of the paper's quote"
        )
        print(f"  finality {result['finality_seconds']:.3f} s")
        for key in (
            "transactions_per_processor_second",
            "first_round_transactions_per_second",
            "replayed_transactions_per_second",
            "audit_seconds",
        ):
            if key in result:
                print(f"  {key.replace('_', ' ')}: {result[key]:,.1f}")


if __name__ == "__main__":
    main()
