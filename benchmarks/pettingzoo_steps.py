"""Steps a second of one game through PettingZoo's interface, beside PettingZoo's own simple_spread of three agents.

The two take turns in one run; the peer is in the environment ``.venv/peers`` (`make peers`).
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PLAYER = ROOT / "benchmarks" / "peers" / "step_pettingzoo.py"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--peer-python", type=Path, default=ROOT / ".venv" / "peers" / "bin" / "python")
    options = parser.parse_args()
    players = {"skyrelay": sys.executable}
    if options.peer_python.exists():
        players["mpe2"] = str(options.peer_python)
    else:
        print(f"mpe2: not measured, there is no {options.peer_python} (make peers makes it)")
    found: dict[str, list[float]] = {name: [] for name in players}
    for _ in range(options.turns):
        for name, python in players.items():
            line = [python, str(PLAYER), name, str(options.steps)]
            found[name].append(float(subprocess.run(line, stdout=subprocess.PIPE, text=True, check=True).stdout))
    for name, speeds in found.items():
        print(f"{name}: {statistics.median(speeds):,.0f} steps/s (median of {len(speeds)})")
    if "mpe2" in found:
        ratios = [own / other for own, other in zip(found["skyrelay"], found["mpe2"], strict=True)]
        print(f"skyrelay over mpe2, turn by turn: {min(ratios):.1f} to {max(ratios):.1f}")
    print(json.dumps(found))


if __name__ == "__main__":
    main()
