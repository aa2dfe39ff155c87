"""The bus between two processes on loopback: latency of a message, and how many come through a second.

    python benchmarks/bus.py [--messages 2000] [--json]

Latency is half of a round trip (there and back through both processes' Python), messages of a beacon's length, one
under way at a time. The rate is what one process publishes without a pause and the other one takes.
"""

from __future__ import annotations

import argparse
import json
import socket
import statistics
import subprocess
import sys
import time

from skyrelay.pilot.bus import Bus
from skyrelay.protocol.beacon import LONGEST

ECHO = """
import sys, time
from skyrelay.pilot.bus import Bus
with Bus("echo", listen=[sys.argv[1]]) as bus:
    heard, count, first, last = bus.subscribe("bench/*/there", 1 << 20), 0, 0.0, 0.0
    print("ready", flush=True)
    while True:
        for arrival in heard.take(5.0):
            if arrival.key == "bench/ping/there":
                bus.publish("bench/back", arrival.content)
            elif arrival.key == "bench/burst/there":
                count, last = count + 1, time.perf_counter()
                first = first or last
            elif arrival.content == b"count":
                bus.publish("bench/back", f"{count} {last - first}".encode())
            else:
                sys.exit()
"""


def main() -> None:
    """Print microseconds and messages a second."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=2000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    echo = subprocess.Popen([sys.executable, "-c", ECHO, endpoint], stdout=subprocess.PIPE, text=True)
    try:
        assert echo.stdout is not None
        echo.stdout.readline()
        with Bus("bench", [endpoint]) as bus:
            result = _measure(bus, args.messages)
            bus.publish("bench/tell/there", b"stop")
            echo.wait(10)
    finally:
        echo.kill()
    print(json.dumps(result) if args.json else "\n".join(f"{name:<22}{value:>10,}" for name, value in result.items()))


def _measure(bus: Bus, messages: int) -> dict[str, float]:
    content = bytes(LONGEST)
    back = bus.subscribe("bench/back")
    while not back.take(0.1):
        bus.publish("bench/ping/there", content)  # until the subscriptions have been told to each other
    while back.take(0.2):
        pass
    trips = []
    for _ in range(messages):
        begin = time.perf_counter()
        bus.publish("bench/ping/there", content)
        back.take(10.0)
        trips.append(time.perf_counter() - begin)
    for _ in range(10 * messages):
        bus.publish("bench/burst/there", content)
    answers = [b"", b"-"]
    while answers[-1] != answers[-2]:  # until no more of them come
        bus.publish("bench/tell/there", b"count")
        answers += [arrival.content for arrival in back.take(1.0)]
        time.sleep(0.2)
    taken, seconds = answers[-1].split()
    return {
        "latency_median_us": round(5e5 * statistics.median(trips)),
        "latency_p99_us": round(5e5 * statistics.quantiles(trips, n=100)[98]),
        "burst_sent": 10 * messages,
        "burst_taken": int(taken),
        "taken_per_second": round(int(taken) / float(seconds)),
    }


if __name__ == "__main__":
    main()
