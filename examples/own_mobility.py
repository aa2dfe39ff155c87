"""Vehicles of your own: whatever moves them, a table of time, id, x and y in metres is a trace, and a trace is a city.

Here cars go round a town on ring roads. The town is written as Parquet and played with the fleet of the default run.

python examples/own_mobility.py --out out/town
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import skyrelay as sr


def ring_roads(cars: int, seconds: int, seed: int) -> pa.Table:
    """Each car keeps to its ring, at its own speed, one way or the other."""
    rng = np.random.default_rng(seed)
    radius = rng.choice([600.0, 1100.0, 1700.0], cars)  # [m]
    turn = rng.choice([-1.0, 1.0], cars) * rng.uniform(7.0, 16.0, cars) / radius  # [rad/s]
    start = rng.uniform(0.0, 2 * np.pi, cars)
    time = np.arange(0.0, seconds + 1.0)
    angle = start[:, None] + turn[:, None] * time
    return pa.table(
        {
            "time": np.tile(time, cars),
            "id": [f"car-{car}" for car in range(cars) for _ in time],
            "x": (2000.0 + radius[:, None] * np.cos(angle)).ravel(),
            "y": (2000.0 + radius[:, None] * np.sin(angle)).ravel(),
        }
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/town"))
    parser.add_argument("--steps", type=int, default=100)
    arguments = parser.parse_args()
    trace = arguments.out.with_suffix(".parquet")
    trace.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(ring_roads(cars=120, seconds=2 * arguments.steps + 10, seed=1), trace)
    settings = {"mobility.trace": str(trace), "mobility.penetration": 1.0, "coordination.steps": arguments.steps}
    summary = sr.run("bologna", out=arguments.out, settings=settings, force=True).summary
    print(f"{summary.vehicles} vehicles, {summary.in_range:.0f} in range at a time: {arguments.out / 'report.html'}")


if __name__ == "__main__":
    main()
