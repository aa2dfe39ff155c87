"""How long one UAV takes to decide, on one thread: from its beacons as bytes to its move.

    python benchmarks/onboard.py [--mates 6] [--vehicles 20] [--decisions 2000] [--age 0.0] [--json]

The agent is the one that flies: it is registered, allocated and equipped by the contract's events, hears a signed
beacon of each mate and each of its vehicles in every step, and decides by onnxruntime. "decision" is what passes
between the last beacon and the move (observation, network, guard), "beacons" the signatures and the rest of the gate
before it. The figures by the thread's processor time are what a machine would give that does nothing else.
"""

from __future__ import annotations

import argparse
import gc
import json
import random
import statistics
import time
from functools import partial

from skyrelay.airspace.law import Law
from skyrelay.chain.abi import Event
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.client import Model
from skyrelay.core.scenario import Energy
from skyrelay.core.zones import ZoneGrid
from skyrelay.policy import Policy
from skyrelay.protocol.beacon import BeaconGate, Session
from skyrelay.protocol.messages import Beacon, Decide, Decided, Fix, ModelFetched, ModelRead, Phase, Tick
from skyrelay.protocol.model_card import chain_card
from skyrelay.protocol.sequence import UavState
from skyrelay.protocol.sight import decide
from skyrelay.protocol.uav import UavAgent
from skyrelay.store.cid import Cid

SIDE, CONTRACT = 2000.0, ("0x" + "c0" * 20, 31337)
LAW = Law(ZoneGrid(0.0, 0.0, SIDE, 1, 1), SIDE / 2, 20.0, 1.0, Energy(), None, patience=10.0)


def main() -> None:
    """Print percentiles in milliseconds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mates", type=int, default=6)
    parser.add_argument("--vehicles", type=int, default=20, help="that the UAV serves")
    parser.add_argument("--decisions", type=int, default=2000)
    parser.add_argument("--age", type=float, default=0.0, help="of the beacons when it decides [s]")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    ring, chance = Keyring.ephemeral(), random.Random(1)  # noqa: S311
    me = ring.account("me")
    mates = [ring.account(f"mate {n}") for n in range(args.mates)]
    vehicles = [ring.account(f"vehicle {n}") for n in range(args.vehicles)]
    agent = equipped(me, mates, vehicles)
    gate = BeaconGate(CONTRACT, {me, *mates}, set(vehicles), {1}, patience=LAW.patience)
    sessions = [Session(m, CONTRACT, partial(ring.vouch, m), 0.0, 1e9) for m in [*mates, *vehicles]]

    def place() -> tuple[float, float]:
        return chance.uniform(0.0, SIDE), chance.uniform(0.0, SIDE)

    hearing, deciding, working = [], [], []
    gc.disable()  # as a process with a deadline would have it
    for step in range(args.decisions):
        now = float(step)
        sent = now - args.age
        raw = [
            session.seal(Beacon(session.member, 1, None if session.member in mates else me, place(), sent))
            for session in sessions
        ]
        begin = time.perf_counter()
        for content in raw:
            beacon = gate.admit(content, now)
            assert beacon is not None
            agent.receive(beacon)
        heard, worked = time.perf_counter(), time.thread_time()
        agent.receive(Fix(place(), 80.0))
        (wish,) = agent.receive(Tick(Phase.DECIDE, step=step, time=now))
        assert isinstance(wish, Decide)
        assert isinstance(wish.policy, Policy)
        agent.receive(Decided(decide(wish.policy, [wish.sight])[0]))
        hearing.append(heard - begin)
        working.append(time.thread_time() - worked)
        deciding.append(time.perf_counter() - heard)
        if step % 100 == 0:
            gc.collect()
    assert isinstance(wish, Decide)
    assert len(wish.sight.team) == args.mates
    result = {f"decision_{name}_ms": value for name, value in percentiles(deciding).items()}
    result |= {f"decision_{name}_by_processor_time_ms": value for name, value in percentiles(working).items()}
    result |= {f"beacons_{name}_ms": value for name, value in percentiles(hearing).items()}
    print(json.dumps(result) if args.json else "\n".join(f"{name:<38}{value:>8}" for name, value in result.items()))


def equipped(me: str, mates: list[str], vehicles: list[str]) -> UavAgent:
    """A UAV's agent that flies the generalist in zone 1, brought there by what the chain would have told it."""
    policy = Policy.builtin("generalist")
    agent = UavAgent("me", me, 1, 100.0, 4000, LAW, lambda _: policy)
    agent.receive(Fix((1.0, 1.0), 80.0))

    def tell(name: str, **values: object) -> None:
        agent.receive(Event(name, values, 1, 0, 0))

    tell("UAVRegistered", uav=me, zone=1)
    tell("UAVZoneUpdated", **{"uav": me, "from": 0, "to": 1})
    tell("UAVAllocated", uav=me, zone=1, selected=vehicles)
    for mate in mates:
        tell("UAVAllocated", uav=mate, zone=1, selected=["0x" + "ee" * 20])
    tell("ModelAssigned", zone=1, modelId="0x01")
    cid = Cid.parse("bafkreihdwdcefgh4dqkjv67uzcmw7ojee6xedzdetojuzjevtenxquvyku", "model")
    agent.receive(ModelRead(Model("0x01", bytes(cid), chain_card(policy.card), me, retired=False)))
    agent.receive(ModelFetched(cid, policy.content))
    assert agent.state is UavState.FLYING
    return agent


def percentiles(seconds: list[float]) -> dict[str, float]:
    """p50 and p99 [ms]."""
    cuts = statistics.quantiles(seconds, n=100)
    return {"p50": round(1e3 * cuts[49], 3), "p99": round(1e3 * cuts[98], 3)}


if __name__ == "__main__":
    main()
