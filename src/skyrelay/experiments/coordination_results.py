"""The rows of the coordination experiment, as its figures and claims ask for them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from skyrelay.core.statistics import Interval, interval
from skyrelay.experiments.coordination_tasks import CENTRALIZED, OURS
from skyrelay.experiments.runner import Row

PAPER_EXPERIMENTS = 20
DRAW = 20250
"""Seed of the team sizes of the experiments."""


class Results:
    """Curves, episodes and networks.

    Attributes:
        uavs, vehicles: of the trainings by the decentralised method, ascending.
        trainings: (method, uavs, vehicles) of every curve.
        seeds: trainings of each kind.
        experiment_numbers: the paper's 20 experiments a point, and all that there are.
        networks: the counts.
    """

    def __init__(self, rows: Sequence[Row]) -> None:
        self._curves: dict[tuple[str, int, int], dict[int, dict[int, float]]] = defaultdict(lambda: defaultdict(dict))
        self._episodes: dict[tuple[str, int, int, int], dict[int, list[Row]]] = defaultdict(lambda: defaultdict(list))
        self.networks = [row for row in rows if row["kind"] == "network"]
        for row in rows:
            if row["kind"] == "curve":
                self._curves[row["method"], row["uavs"], row["vehicles"]][row["seed"]][row["steps"]] = row["return"]
            elif row["kind"] == "episode":
                trained = row["trained_vehicles"] or row["vehicles"]
                key = (row["method"], row["uavs"], row["vehicles"], trained)
                self._episodes[key][row["seed"] or 0].append(row)
        self.trainings = list(self._curves)
        self.uavs = sorted({uavs for method, uavs, _ in self.trainings if method == OURS})
        self.vehicles = sorted({vehicles for method, _, vehicles in self.trainings if method == OURS})
        self.seeds = len(self._curves[self.trainings[0]])
        episodes = min(len(rows) for seeds in self._episodes.values() for rows in seeds.values())
        self.experiment_numbers = sorted({min(PAPER_EXPERIMENTS, episodes), episodes})

    def curve(self, method: str, uavs: int, vehicles: int) -> tuple[list[int], list[Interval]]:
        """Steps, and the greedy test's return over seeds at each."""
        seeds = self._curves[method, uavs, vehicles]
        steps = sorted(seeds[0])
        return steps, [interval([curve[step] for curve in seeds.values()]) for step in steps]

    def final(self, method: str, uavs: int, vehicles: int) -> list[float]:
        """Of each seed, the mean return of the last three tests."""
        return [_last(curve) for _, curve in sorted(self._curves[method, uavs, vehicles].items())]

    def converged(self, uavs: int, vehicles: int) -> list[int]:
        """Of each seed, the steps at the first test within 1 of the return that it ends with."""
        found = []
        for _, curve in sorted(self._curves[OURS, uavs, vehicles].items()):
            level = _last(curve) - 1.0
            found.append(min(step for step, value in curve.items() if value >= level))
        return found

    def experiment_values(
        self,
        method: str,
        vehicles: int,
        measure: str,
        number: int,
        teams: Sequence[int] | None = None,
        trained: int | None = None,
    ) -> list[float]:
        """One measure of each experiment: an unseen episode of a team of random size, the same for all methods.

        Args:
            number: of experiments.
            teams: sizes drawn from; None for all.
            trained: number of vehicles that a network was trained with; None for that of the experiment.
        """
        sizes = np.random.default_rng(DRAW).choice(teams or self.uavs, number)
        values = []
        for index, uavs in enumerate(sizes.tolist()):
            seeds = self._of(method, uavs, vehicles, trained if method in (OURS, CENTRALIZED) else None)
            # The experiments go round the trainings: each seed's network flies its share of them.
            values.append(float(seeds[sorted(seeds)[index % len(seeds)]][index][measure]))
        return values

    def experiments(
        self,
        method: str,
        vehicles: int,
        measure: str,
        number: int,
        teams: Sequence[int] | None = None,
        trained: int | None = None,
    ) -> Interval:
        """Mean of `experiment_values`."""
        return interval(self.experiment_values(method, vehicles, measure, number, teams, trained))

    def over_seeds(self, method: str, uavs: int, vehicles: int, measure: str) -> Interval:
        """Mean over all episodes that have the measure; over seeds where there are several, else over episodes."""
        seeds = self._of(method, uavs, vehicles, None)
        if len(seeds) == 1:
            return interval([row[measure] for rows in seeds.values() for row in rows])
        return interval([interval([row[measure] for row in rows]).mean for rows in seeds.values()])

    def over_episodes(self, method: str, uavs: int, vehicles: int) -> Interval:
        """Return on the unseen episodes: each episode's mean over seeds, mean over episodes."""
        return interval(self.returns(method, uavs, vehicles))

    def returns(self, method: str, uavs: int, vehicles: int) -> list[float]:
        """Return on each of the unseen episodes, mean over seeds."""
        seeds = self._of(method, uavs, vehicles, None).values()
        means: list[float] = np.mean([[row["return"] for row in rows] for rows in seeds], axis=0).tolist()
        return means

    def share_reached(self, method: str, uavs: int, vehicles: int, measure: str) -> float:
        """Share of the episodes that have the measure."""
        rows = [row for rows in self._of(method, uavs, vehicles, None).values() for row in rows]
        return sum(row[measure] is not None for row in rows) / len(rows)

    def _of(self, method: str, uavs: int, vehicles: int, trained: int | None) -> dict[int, list[Row]]:
        return self._episodes[method, uavs, vehicles, trained or vehicles]


def _last(curve: dict[int, float]) -> float:
    return float(np.mean([curve[step] for step in sorted(curve)[-3:]]))
