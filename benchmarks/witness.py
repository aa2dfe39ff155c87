"""How many liars about their position are found, at what rate of false alarms, by what others hear of them.

    python benchmarks/witness.py [--draws 6] [--false-alarms 0.01] [--shadowing 4] [--penetration 0.21] [--json]

Vehicles of the Bologna trace (as many as the default scenario connects; its period of 40 s, a beacon each 2 s) and the
UAVs at their stations hear each other by a log-distance law (exponent 2.7) with shadowing that stays with a link over
20 m (Gudmundson), and report strengths. Liars claim another place (VeReMi's kinds), and lie as witnesses: what they
report of each other fits the claims, of the honest it is off by up to 20 dB. The bound of the score is set on other
draws, one of each kind with the same share of liars; found and false alarms are of draws that it was not set on.
Intervals are Wilson's, 95 %.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from skyrelay.airspace.witness import FloatArray, Hearing, implausibility, worst
from skyrelay.core.scenario import load_scenario
from skyrelay.simulation.world import World

KINDS = ("constant offset", "random offset", "random position", "eventual stop")
OFFSETS = (0.1, 0.25, 0.5, 1.0, 2.0)
SHARES = (0.05, 0.1, 0.2, 0.3)
DECORRELATION = 20.0


def main() -> None:
    """Print a table, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=6)
    parser.add_argument("--false-alarms", type=float, default=0.01)
    parser.add_argument("--shadowing", type=float, default=4.0)
    parser.add_argument("--penetration", type=float, default=0.21)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    scenario = load_scenario("bologna", [f"mobility.penetration={options.penetration}"])
    world = World.of(scenario)
    radius = scenario.fleet.range or world.law.grid.side / 2
    law = Hearing(radius, shadowing=options.shadowing)
    step, period = scenario.coordination.step_seconds, scenario.coordination.period_steps
    begin = time.monotonic()
    rows: list[dict[str, Any]] = []
    for share in SHARES:
        random = np.random.default_rng((options.seed, round(100 * share)))
        cases: list[tuple[str, float | None]] = [("constant offset", offset) for offset in OFFSETS]
        cases += [("random offset", offset) for offset in OFFSETS]
        cases += [("random position", None), ("eventual stop", None)]
        honest = []
        for draw, (kind, offset) in enumerate(cases):
            honest.append(_draw(world, draw, period, step, law, share, kind, offset, random))
        fair = np.concatenate([statistics[~liar] for statistics, liar in honest])
        scales = np.maximum(np.quantile(fair, 1 - options.false_alarms / 2, axis=0), 1e-9)
        bound = float(np.quantile(worst(fair, scales), 1 - options.false_alarms))
        for kind, offset in cases:
            found = liars = false = others = 0
            for draw in range(options.draws):
                statistics, liar = _draw(world, draw, period, step, law, share, kind, offset, random)
                flagged = worst(statistics, scales) > bound
                found, liars = found + int(flagged[liar].sum()), liars + int(liar.sum())
                false, others = false + int(flagged[~liar].sum()), others + int((~liar).sum())
            rows.append(
                {
                    "kind": kind,
                    "offset_ranges": offset,
                    "liars": share,
                    "found": _share(found, liars),
                    "false_alarms": _share(false, others),
                }
            )
    told: dict[str, Any] = {
        "range_m": radius,
        "shadowing_db": options.shadowing,
        "period_s": period * step,
        "draws": options.draws,
        "false_alarms_aimed_at": options.false_alarms,
        "rows": rows,
        "seconds": round(time.monotonic() - begin, 1),
    }
    if options.json:
        print(json.dumps(told, indent=1))
        return
    print(f"range {radius:.0f} m, shadowing {options.shadowing:g} dB, {told['seconds']} s")
    for row in rows:
        about = "" if row["offset_ranges"] is None else f"{row['offset_ranges']:g} ranges"
        right, wrong = row["found"], row["false_alarms"]
        print(
            f"{row['liars']:>4.0%} liars, {row['kind']:<15} {about:<11}"
            f" found {right['share']:6.1%} ({right['low']:.1%} to {right['high']:.1%} of {right['of']})"
            f"  false alarms {wrong['share']:.2%}"
        )


def _draw(
    world: World,
    draw: int,
    period: int,
    step: float,
    law: Hearing,
    share: float,
    kind: str,
    offset: float | None,
    random: np.random.Generator,
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Statistics [N, 5] of one period's members, and which of them lie [N]."""
    periods = (len(world.tracks.x) - 1) // period
    first = (draw % periods) * period
    x, y = world.tracks.x[first : first + period], world.tracks.y[first : first + period]
    there = np.isfinite(x).sum(axis=0) >= period // 2
    vehicles = int(there.sum())
    ground = np.stack([x[:, there], y[:, there], np.full((period, vehicles), 1.5)], axis=2)
    fleet = np.stack([world.fleet.x, world.fleet.y, np.full(len(world.fleet.x), 100.0)], axis=1)
    true = np.concatenate([ground, np.repeat(fleet[None], period, axis=0)], axis=1)
    members = true.shape[1]
    liar = np.zeros(members, dtype=bool)
    liar[random.choice(members, max(1, round(share * members)), replace=False)] = True
    claimed = _claims(true, liar, kind, offset, law, random)
    heard = _heard(true, law, random)
    # Liars vouch for each other, and speak against the honest.
    consistent = law.strength(np.linalg.norm(claimed[:, :, None] - claimed[:, None], axis=3))
    consistent = consistent + random.normal(0.0, 1.0, consistent.shape)
    among = liar[:, None] & liar[None, :]
    heard = np.where(among & (consistent > 0), consistent, heard)
    against = liar[:, None] & ~liar[None, :]
    heard = heard + np.where(against, random.uniform(-20.0, 20.0, (members, members)), 0.0)
    return implausibility(claimed, heard, step, law), liar


def _claims(
    true: FloatArray,
    liar: npt.NDArray[np.bool_],
    kind: str,
    offset: float | None,
    law: Hearing,
    random: np.random.Generator,
) -> FloatArray:
    claimed = true.copy()
    times = len(true)
    for member in np.flatnonzero(liar):
        if kind == "constant offset":
            heading = random.uniform(0, 2 * np.pi)
            claimed[:, member, :2] += (offset or 0.0) * law.radius * np.array([np.cos(heading), np.sin(heading)])
        elif kind == "random offset":  # a new one with each beacon, up to this far
            angle, length = (
                random.uniform(0, 2 * np.pi, times),
                (offset or 0.0) * law.radius * random.uniform(0, 1, times),
            )
            claimed[:, member, :2] += length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        elif kind == "random position":
            low, high = np.nanmin(true[:, :, :2], axis=(0, 1)), np.nanmax(true[:, :, :2], axis=(0, 1))
            claimed[:, member, :2] = random.uniform(low, high, (times, 2))
        else:  # drives on, and says that it stands
            seen = np.flatnonzero(np.isfinite(true[:, member, 0]))
            stop = seen[len(seen) // 4]
            claimed[stop:, member] = np.where(np.isfinite(true[stop:, member]), true[stop, member], np.nan)
    return claimed


def _heard(true: FloatArray, law: Hearing, random: np.random.Generator) -> FloatArray:
    times, members = true.shape[:2]
    heard = np.empty((times, members, members))
    shadow = random.normal(0.0, law.shadowing, (members, members))
    for now in range(times):
        if now:
            moved = np.nan_to_num(np.linalg.norm(true[now] - true[now - 1], axis=1))
            kept = np.exp(-(moved[:, None] + moved[None, :]) / DECORRELATION)
            fresh = random.normal(0.0, law.shadowing, (members, members))
            shadow = kept * shadow + np.sqrt(1 - kept**2) * fresh
        distance = np.linalg.norm(true[now, :, None] - true[now, None], axis=2)
        strength = law.strength(distance) + shadow
        heard[now] = np.where((strength > 0) & ~np.eye(members, dtype=bool), strength, np.nan)
    return heard


def _share(count: int, total: int) -> dict[str, float]:
    """A share with Wilson's interval."""
    z, n = 1.96, max(total, 1)
    p = count / n
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    low, high = (middle - half) / (1 + z * z / n), (middle + half) / (1 + z * z / n)
    return {"share": round(p, 4), "low": round(max(low, 0.0), 4), "high": round(min(high, 1.0), 4), "of": total}


if __name__ == "__main__":
    main()
