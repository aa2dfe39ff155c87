"""Runs beside each other: paired differences over seeds with their intervals, as a table and as one figure.

Runs that differ in their seed only are one group; groups are held against the first run's, seed by seed, since the same
seed draws the same members and the same traffic. A fleet that hovers is in every run's record: it is a group, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from skyrelay.core.errors import UsageError
from skyrelay.core.files import atomic_path
from skyrelay.core.scenario import Scenario
from skyrelay.core.statistics import Interval, interval
from skyrelay.runfolder.reader import read_scenario, read_summary
from skyrelay.runfolder.schema import Summary

MEASURES = {
    "in_range": "connected vehicles in range at a time",
    "in_range_share": "share of the connected vehicles in range",
    "coverage": "share of the served vehicles in range",
    "connectivity": "share of the time a team is linked",
    "served_mbps": "requested bandwidth in range [Mbit/s]",
    "carried_mbps": "carried [Mbit/s]",
    "delivered_mbps": "delivered [Mbit/s]",
    "fairness": "Jain's index of what vehicles got",
    "handovers": "hand-overs",
    "mean_qou": "mean QoU",
    "mean_qov": "mean QoV",
    "gas_used": "gas",
}
"""What is compared, and what it is called."""
HOVERING = frozenset(MEASURES) - {"mean_qou", "mean_qov", "gas_used"}
"""What a run's record also has of the same fleet hovering."""
MOST = 10_000
"""Runs at once."""


@dataclass(frozen=True)
class Group:
    """Runs that differ in their seed only.

    Attributes:
        label: what sets them apart from the other groups.
        values: of each measure, by seed.
    """

    label: str
    values: Mapping[str, Mapping[int, float]]

    def mean(self, measure: str) -> Interval:
        """Over the seeds."""
        return interval(self.values[measure].values())

    def minus(self, other: Group, measure: str) -> Interval:
        """The difference, seed by seed, over the seeds that both have."""
        own, others = self.values[measure], other.values[measure]
        return interval(own[seed] - others[seed] for seed in own if seed in others)


def groups_of(folders: Sequence[Path], *, hovering: bool = False) -> list[Group]:
    """The runs of some folders by what they have in common, the first run's group first.

    Args:
        hovering: of a single group, also the same fleet hovering.
    Raises:
        RunFolderError: a folder is none of a run's.
        UsageError: none is named, or two are of the same scenario and seed.
    """
    if not 0 < len(folders) <= MOST:
        raise UsageError("runs", len(folders), f"1 to {MOST:,} run folders")
    runs = [(folder, _settings(read_scenario(folder)), read_summary(folder)) for folder in folders]
    kinds: dict[tuple[tuple[str, str], ...], dict[int, Summary]] = {}
    for folder, settings, summary in runs:
        seeds = kinds.setdefault(tuple(sorted(settings.items())), {})
        if summary.seed in seeds:
            raise UsageError(str(folder), f"seed {summary.seed} once more", "runs that differ: the same one is there")
        seeds[summary.seed] = summary
    everyone = [dict(kind) for kind in kinds]
    differing = sorted(
        {key for kind in everyone for key in kind if len({repr(other.get(key)) for other in everyone}) > 1}
    )
    groups = [Group(_label(dict(kind), differing), _values(seeds, MEASURES, "")) for kind, seeds in kinds.items()]
    if hovering and len(groups) == 1:
        groups.insert(0, Group("hovering", _values(next(iter(kinds.values())), HOVERING, "static_")))
    return groups


def table(groups: Sequence[Group]) -> list[dict[str, Any]]:
    """A row for each measure and group: its mean, its difference from the first group's, both with 95 % intervals."""
    rows = []
    for measure, title in MEASURES.items():
        for group in groups:
            if measure not in group.values or not group.values[measure]:
                continue
            first = groups[0].values.get(measure)
            difference = None if group is groups[0] or not first else group.minus(groups[0], measure)
            rows.append(
                {
                    "measure": measure,
                    "title": title,
                    "runs": group.label,
                    "seeds": len(group.values[measure]),
                    **_told(group.mean(measure), ""),
                    **({} if difference is None else {"paired": difference.count, **_told(difference, "difference_")}),
                }
            )
    return rows


def draw(groups: Sequence[Group], path: Path) -> None:
    """One figure: a panel for each measure, a mark with its interval for each group."""
    from matplotlib.figure import Figure

    shown = [name for name in MEASURES if any(group.values.get(name) for group in groups)]
    columns = 4
    figure = Figure(figsize=(14, 3.2 * math.ceil(len(shown) / columns)), layout="constrained")
    axes = figure.subplots(math.ceil(len(shown) / columns), columns, squeeze=False).ravel()
    for panel, measure in zip(axes, shown, strict=False):
        for place, group in enumerate(groups):
            if not group.values.get(measure):
                continue
            mean = group.mean(measure)
            half = 0.0 if math.isnan(mean.high) else mean.high - mean.mean
            panel.errorbar(place, mean.mean, half, fmt="o", capsize=4, color=f"C{place}")
        panel.set_title(MEASURES[measure], fontsize=9)
        panel.set_xticks(range(len(groups)), [str(number + 1) for number in range(len(groups))])
        panel.set_xlim(-0.5, len(groups) - 0.5)
        panel.grid(axis="y", alpha=0.3)
    for panel in axes[len(shown) :]:
        panel.set_visible(False)
    names = "   ".join(f"{number + 1}: {group.label}" for number, group in enumerate(groups))
    figure.suptitle(f"{names}   (means and 95 % intervals over seeds)", fontsize=10)
    with atomic_path(path) as beside:
        figure.savefig(beside, format=path.suffix.removeprefix(".") or "png", dpi=120)


def _values(
    seeds: Mapping[int, Summary], measures: Mapping[str, str] | frozenset[str], prefix: str
) -> dict[str, dict[int, float]]:
    return {
        measure: {
            seed: float(value)
            for seed, summary in seeds.items()
            if (value := getattr(summary, prefix + measure)) is not None
        }
        for measure in measures
    }


def _settings(scenario: Scenario) -> dict[str, str]:
    """Every key of a scenario but its name and seed, flat, as text."""
    flat: dict[str, str] = {}
    for section, value in scenario.model_dump(mode="json", exclude={"name", "seed"}).items():
        keys = {section: value} if isinstance(value, list) else {f"{section}.{key}": value[key] for key in value}
        for key, entry in keys.items():
            text = repr(entry)
            short = f"{text[:60]}... (SHA-256 {sha256(text.encode()).hexdigest()[:8]})"
            flat[key] = text if len(text) < 80 else short
    return flat


def _label(kind: Mapping[str, str], differing: Sequence[str]) -> str:
    told = [f"{key}={kind.get(key)}".replace("'", "") for key in differing]
    return ", ".join(told[:4]) + (f", and {len(told) - 4} more keys" if len(told) > 4 else "") or "flying"


def _told(value: Interval, prefix: str) -> dict[str, float | None]:
    """For JSON, which has no NaN: the bounds of a single value are not there."""
    return {
        prefix + name: None if math.isnan(bound) else bound
        for name, bound in (("mean", value.mean), ("low", value.low), ("high", value.high))
    }
