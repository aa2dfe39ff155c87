"""Where a round's time on a network goes: client, node and contract apart.

    python benchmarks/rates.py [--validators 4] [--url URL ...] [--vehicles 2000] [--uavs 200] [--zones 40] [--json]

Starts QBFT validators on this machine (`make nodes` builds them), or takes a network that runs already with --url.
Every transaction is signed beforehand and handed straight to the nodes, so that neither signing nor waiting for
receipts is in the node's figures:

- client: transactions signed in a second of processor time;
- contract: proposals executed in a second, in the embedded machine and by one node (`eth_call`, nothing mined);
- node: transactions that do nothing (21,000 gas), from the first that is handed over to the block of the last one;
- stages: the registration, the proposals and the allocation of all zones at once, each handed over whole: how many
  blocks it took, over how many seconds, and the fullest block's gas against the limit.

Blocks have the time of their proposers, in whole seconds.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Call, Chain
from skyrelay.chain.client import IovClient, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.node.devnet import Devnet
from skyrelay.chain.node.rpc import Endpoints

SIDE = 1_000.0
"""Of a zone's square [m]."""


class Network:
    """A chain that is handed transactions signed beforehand.

    Args:
        urls: nodes, which take turns.
    """

    def __init__(self, urls: Sequence[str]) -> None:
        self.keyring = Keyring.ephemeral()
        self.chain = NodeChain(list(urls), self.keyring, poll=0.1)
        self._nodes = [Endpoints([url], None, None) for url in urls]
        self._nonces: dict[str, int] = {}
        self.signing = 0.0
        self.signed = 0

    def sign(self, calls: Sequence[Call]) -> list[tuple[str, str]]:
        """Hashes and transactions; nonces follow on, for all is mined that is signed."""
        missing = [sender for sender in dict.fromkeys(call.sender for call in calls) if sender not in self._nonces]
        for start in range(0, len(missing), 100):
            part = missing[start : start + 100]
            replies = self._nodes[0].ask([("eth_getTransactionCount", [one, "pending"]) for one in part], 60.0)
            self._nonces |= {one: int(reply["result"], 16) for one, reply in zip(part, replies, strict=True)}
        begin = time.process_time()
        signed = []
        for call in calls:
            nonce = self._nonces[call.sender]
            self._nonces[call.sender] = nonce + 1
            digest, raw = self.keyring.sign(call.sender, call.to, call.data, call.gas, nonce, self.chain.chain_id)
            signed.append((digest, "0x" + raw.hex()))
        self.signing += time.process_time() - begin
        self.signed += len(calls)
        return signed

    def stage(self, calls: Sequence[Call]) -> dict[str, Any]:
        """Hand all of them over at once, to all nodes in turn, and wait until they are mined."""
        signed = self.sign(calls)
        wanted = {digest for digest, _ in signed}
        first = self.chain.block_number + 1
        begin = time.perf_counter()
        with ThreadPoolExecutor(len(self._nodes)) as pool:
            # One sender's transactions go to one node, or they might come to a proposer out of order.
            parts: list[list[str]] = [[] for _ in self._nodes]
            for call, (_, raw) in zip(calls, signed, strict=True):
                parts[int(call.sender, 16) % len(parts)].append(raw)
            list(pool.map(_hand_over, self._nodes, parts))
        handed = time.perf_counter() - begin
        blocks: list[dict[str, Any]] = []
        number = first
        while wanted:
            if self.chain.block_number < number:
                time.sleep(0.1)
                continue
            (block,) = self.chain.blocks([number])
            found = wanted.intersection(block["transactions"])
            wanted -= found
            if found:
                blocks.append(block)
            number += 1
        seconds = time.perf_counter() - begin
        self._require_success([digest for digest, _ in signed])
        times = [int(block["timestamp"], 16) for block in blocks]
        return {
            "transactions": len(calls),
            "seconds": seconds,
            "handing_over_seconds": handed,
            "blocks": len(blocks),
            "between_first_and_last_block_seconds": times[-1] - times[0],
            "transactions_per_second": len(calls) / seconds,
            "gas_each": sum(int(block["gasUsed"], 16) for block in blocks) / len(calls),
            "fullest_block": max(int(block["gasUsed"], 16) / int(block["gasLimit"], 16) for block in blocks),
            "most_in_a_block": max(len(block["transactions"]) for block in blocks),
        }

    def _require_success(self, digests: Sequence[str]) -> None:
        failed = [receipt for receipt in self.chain.receipts(digests) if int(receipt["status"], 16) == 0]
        if failed:
            raise SystemExit(f"{len(failed)} of {len(digests)} transactions failed, as {failed[0]['transactionHash']}")


class Crowd:
    """Members of a contract, their zones side by side.

    Args:
        chain: where the contract is deployed to.
    """

    def __init__(self, chain: Chain, vehicles: int, uavs: int, zones: int) -> None:
        self.chain = chain
        self.admin = chain.account("rates administrator")
        self.client = IovClient.deploy(chain, Settings(max_distance=SIDE), self.admin)
        self.client.execute([self.client.grant_role(self.admin, Role.COORDINATOR, self.admin)])
        self.zones = list(range(1, zones + 1))
        self.vehicles = [chain.account(f"rates vehicle {i}") for i in range(vehicles)]
        self.uavs = [chain.account(f"rates uav {i}") for i in range(uavs)]

    def registration(self) -> list[Call]:
        """Of every UAV and vehicle."""
        fleet = [
            self.client.register_uav(uav, UavRecord(*self._place(i, 0.5), 100, 80, 20_000, self._zone(i)))
            for i, uav in enumerate(self.uavs)
        ]
        return fleet + [
            self.client.register_vehicle(one, VehicleRecord(*self._place(i, 0.3), 300, self._zone(i)))
            for i, one in enumerate(self.vehicles)
        ]

    def proposals(self) -> list[Call]:
        """Of every vehicle, to the UAVs of its zone in turn."""
        uavs = {zone: self.client.zone_uavs(zone) for zone in self.zones}
        rounds = {zone: info.round for zone in self.zones if (info := self.client.zone_info(zone)) is not None}
        return [
            self.client.submit_veh_selection(
                one, uavs[zone][i // len(self.zones) % len(uavs[zone])], 1500, rounds[zone]
            )
            for i, one in enumerate(self.vehicles)
            for zone in [self._zone(i)]
        ]

    def allocations(self) -> list[Call]:
        """Of every zone, whole."""
        return [self.client.allocate_zone(self.admin, zone, 100_000) for zone in self.zones]

    def _zone(self, member: int) -> int:
        return self.zones[member % len(self.zones)]

    def _place(self, member: int, part: float) -> tuple[float, float]:
        return SIDE * (member % len(self.zones) + part), SIDE * part


def _hand_over(node: Endpoints, transactions: Sequence[str]) -> None:
    for reply in node.ask([("eth_sendRawTransaction", [raw]) for raw in transactions], 120.0):
        if "error" in reply:
            raise SystemExit(f"a node refuses a transaction: {reply['error']['message']}")


def execution(crowd: Crowd) -> dict[str, float]:
    """How many proposals are executed in a second, without mining."""
    proposals = crowd.proposals()[:200]
    crowd.chain.query(proposals[:20])  # the embedded machine translates code when it first meets it
    begin = time.perf_counter()
    answers = crowd.chain.query(proposals)
    seconds = time.perf_counter() - begin
    if not all(answer.status for answer in answers):
        raise SystemExit("a proposal that should be taken is refused")
    return {"proposals_per_second": len(proposals) / seconds}


def embedded(vehicles: int, uavs: int, zones: int) -> dict[str, Any]:
    """The same stages in the embedded machine."""
    result: dict[str, Any] = {}
    with EmbeddedChain() as chain:
        crowd = Crowd(chain, vehicles, uavs, zones)
        for name in ("registration", "proposals", "allocations"):
            calls = getattr(crowd, name)()
            if name == "proposals":
                result["contract"] = execution(crowd)
            begin = time.perf_counter()
            receipts = crowd.client.execute(calls)
            seconds = time.perf_counter() - begin
            gas = sum(receipt.gas_used for receipt in receipts)
            result[name] = {
                "transactions": len(calls),
                "seconds": seconds,
                "transactions_per_second": len(calls) / seconds,
                "gas_each": gas / len(calls),
                "gas_per_second": gas / seconds,
            }
        result["contract"]["gas_per_second"] = (
            result["contract"]["proposals_per_second"] * result["proposals"]["gas_each"]
        )
    return result


def on_network(urls: Sequence[str], vehicles: int, uavs: int, zones: int) -> dict[str, Any]:
    """All stages on a network."""
    network = Network(urls)
    crowd = Crowd(network.chain, vehicles, uavs, zones)
    idle = [Call(sender, sender, b"", 21_000, "nothing") for sender in crowd.vehicles]
    result: dict[str, Any] = {"nothing": network.stage(idle), "registration": network.stage(crowd.registration())}
    calls = crowd.proposals()
    result["contract"] = execution(crowd)
    result["proposals"] = network.stage(calls)
    result["allocations"] = network.stage(crowd.allocations())
    result["contract"]["gas_per_second"] = result["contract"]["proposals_per_second"] * result["proposals"]["gas_each"]
    result["client"] = {"signatures_per_processor_second": network.signed / network.signing}
    return result


def main() -> None:
    """Print a table, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--validators", type=int, default=4, help="that are started here")
    parser.add_argument("--period", type=int, default=1, help="of their blocks [s]")
    parser.add_argument("--url", action="append", default=[], help="a network's node; repeated: its fellows")
    parser.add_argument("--vehicles", type=int, default=2_000)
    parser.add_argument("--uavs", type=int, default=200)
    parser.add_argument("--zones", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if not 0 < options.zones <= options.uavs <= options.vehicles:
        parser.error("at least as many vehicles as UAVs, and UAVs as zones")
    size = (options.vehicles, options.uavs, options.zones)
    results: dict[str, Any] = {"vehicles": size[0], "uavs": size[1], "zones": size[2]}
    results["embedded"] = embedded(*size)
    with ExitStack() as stack:
        urls = options.url
        if not urls:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            devnet = Devnet.create(folder / "net", validators=options.validators, period=options.period)
            network = stack.enter_context(devnet)
            urls = network.endpoints
        results["network"] = on_network(urls, *size)
    print(json.dumps(results, indent=1) if options.json else _table(results))


def _table(results: dict[str, Any]) -> str:
    network, machine = results["network"], results["embedded"]
    lines = [
        f"{results['vehicles']:,} vehicles, {results['uavs']:,} UAVs, {results['zones']} zones",
        f"client: {network['client']['signatures_per_processor_second']:,.0f} signatures a processor second",
    ]
    for name, place in (("embedded machine", machine), ("one node", network)):
        found = place["contract"]
        lines.append(
            f"contract, {name}: {found['proposals_per_second']:,.0f} proposals/s,"
            f" {found['gas_per_second'] / 1e6:,.0f}M gas/s"
        )
    for name in ("nothing", "registration", "proposals", "allocations"):
        stage = network[name]
        own = f", embedded {machine[name]['seconds']:.1f} s" if name in machine else ""
        lines.append(
            f"{name:<13} {stage['transactions']:6,}"
            f"  {stage['seconds']:6.1f} s ({stage['handing_over_seconds']:.1f} handing over)"
            f"  {stage['blocks']:3} blocks over {stage['between_first_and_last_block_seconds'] + 1} s"
            f"  fullest {stage['fullest_block']:4.0%} with {stage['most_in_a_block']:,}"
            f"  {stage['gas_each']:8,.0f} gas each{own}"
        )
    needed = math.ceil(network["proposals"]["gas_each"] * results["vehicles"] / 150e6)
    lines.append(f"proposals by their gas alone: {needed} blocks of 150M")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
