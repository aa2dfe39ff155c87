"""What a beacon costs whoever sends it and whoever hears it, on one core.

python benchmarks/beacons.py [--beacons 3000] [--json]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

from skyrelay.chain.accounts import Keyring
from skyrelay.protocol.beacon import BeaconGate, Session
from skyrelay.protocol.messages import Beacon

CONTRACT = ("0x" + "c0" * 20, 31337)
VEHICLES = 200


def main() -> None:
    """Print microseconds a beacon."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--beacons", type=int, default=3000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    ring = Keyring.ephemeral()
    uav, vehicle = ring.account("uav"), ring.account("vehicle")
    session = Session(vehicle, CONTRACT, lambda message: ring.vouch(vehicle, message), 0.0, 3600.0)
    beacons = [Beacon(vehicle, 1, uav, (float(n), 2.0), float(n), 13.0) for n in range(args.beacons)]
    sealed: list[bytes] = []
    figures = {"seal_us": _each(lambda n: sealed.append(session.seal(beacons[n])), args.beacons)}
    gate = BeaconGate(CONTRACT, {uav}, {vehicle}, {1}, patience=5.0)
    figures["admit_us"] = _each(lambda n: gate.admit(sealed[n], float(n)), args.beacons)
    assert gate.admitted == args.beacons
    stranger = BeaconGate(CONTRACT, {uav}, set(), {1}, patience=5.0)
    figures["drop_unknown_us"] = _each(lambda n: stranger.admit(sealed[n], float(n)), args.beacons)
    figures["replay_us"] = _each(lambda _: gate.admit(sealed[0], 0.0), args.beacons)
    result = {name: round(1e6 * seconds, 1) for name, seconds in figures.items()}
    result |= {
        "bytes": len(sealed[0]),
        "percent_of_a_core_for_200_at_1_hz": round(1e2 * VEHICLES * figures["admit_us"], 2),
    }
    print(json.dumps(result) if args.json else "\n".join(f"{name:<34}{value:>8}" for name, value in result.items()))


def _each(do: Callable[[int], object], count: int) -> float:
    """Seconds a call."""
    begin = time.perf_counter()
    for number in range(count):
        do(number)
    return (time.perf_counter() - begin) / count


if __name__ == "__main__":
    main()
