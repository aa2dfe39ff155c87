"""A long run: memory and time of a step at its start and at its end, which must not grow with what has been.

    python benchmarks/long_run.py [--steps 2000] [--vehicles 100] [--uavs 40] [--json]

`skyrelay run` on synthetic vehicles (random way-points), so that as many drive at the end as at the start. What grows
by design is the record: its rows are counted, and given beside the memory. Compared are two stretches of so many whole
periods, after the first period (registrations, the policy's first load) and at the very end.
"""

from __future__ import annotations

import argparse
import gc
import json
import resource
import tempfile
import time
from pathlib import Path

from skyrelay.core.scenario import load_scenario
from skyrelay.simulation import play

MIB = 1 << 20


class Meter:
    """A run's progress, as times and memory after each step."""

    def __init__(self) -> None:
        self._flying = False
        self.seconds: list[float] = []
        self.bytes: list[int] = []

    def stage(self, name: str, total: int) -> None:
        """The flight is what is measured."""
        del total
        self._flying = name == "Selection and flight"
        if self._flying:
            self._note()

    def advance(self, steps: int = 1) -> None:
        """A step is done."""
        del steps
        if self._flying:
            self._note()

    def _note(self) -> None:
        self.seconds.append(time.process_time())
        self.bytes.append(_resident())


def _resident() -> int:
    """Memory that the process holds now [bytes]."""
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * resource.getpagesize()


def measure(steps: int, vehicles: int, uavs: int) -> dict[str, float]:
    """One run's figures; see the module."""
    overrides = [
        "mobility.source=random-waypoint",
        f"mobility.vehicles={vehicles}",
        f"fleet.uavs={uavs}",
        f"coordination.steps={steps}",
        "energy.hover_per_minute=0.5",  # all stay in the air to the end
        "energy.move_per_minute=0.5",
    ]
    scenario = load_scenario("bologna", overrides, 1)
    period = scenario.coordination.period_steps
    stretch = max(1, steps // period // 8) * period
    meter = Meter()
    gc.collect()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        folder.mkdir()
        summary = play(scenario, folder, meter)
        written = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    begin, end = (period, period + stretch), (steps - stretch, steps)

    def each(stretch: tuple[int, int]) -> float:
        return 1e3 * (meter.seconds[stretch[1]] - meter.seconds[stretch[0]]) / (stretch[1] - stretch[0])

    return {
        "steps": steps,
        "vehicles": summary["vehicles"],
        "uavs_left_at_the_end": uavs - summary["uavs_retired"],
        "transactions": summary["transactions"],
        "stretch_steps": stretch,
        "ms_per_step_at_the_start": round(each(begin), 2),
        "ms_per_step_at_the_end": round(each(end), 2),
        "memory_mib_at_the_start": round(meter.bytes[period] / MIB, 1),
        "memory_mib_at_the_end": round(meter.bytes[-1] / MIB, 1),
        "kib_per_step": round((meter.bytes[end[1]] - meter.bytes[begin[1]]) / (end[1] - begin[1]) / 1024, 1),
        "written_mib": round(written / MIB, 1),
    }


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--uavs", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    figures = measure(options.steps, options.vehicles, options.uavs)
    if options.json:
        print(json.dumps(figures, indent=2))
        return
    for name, value in figures.items():
        print(f"{name.replace('_', ' '):<28} {value:,}")


if __name__ == "__main__":
    main()
