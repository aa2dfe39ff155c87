"""A policy's model card: what it was trained for, how it did, and how it was made. It travels inside the ONNX file."""

from __future__ import annotations

from itertools import product
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, field_validator

from skyrelay.airspace.maps import ENERGY_MAPS, OBSTACLE_MAPS, OUTLOOK_MAPS, PAPER_MAPS, RANGE_MAPS, map_names

Count = Annotated[int, Field(ge=1)]
CARD_KEY = "skyrelay.card"
"""Name of the ONNX metadata entry that holds the card as JSON."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Interval(_Model):
    """A mean and its 95 % interval over episodes."""

    mean: float
    low: float
    high: float


class Evaluation(_Model):
    """Greedy play of unseen episodes."""

    uavs: tuple[Count, Count]
    vehicles: tuple[Count, Count]
    episodes: Count
    steps: Count
    seed: int
    episode_return: Interval
    coverage: Interval
    connectivity: Interval
    connectivity_neighbor: Interval


class Card(_Model):
    """What one must know before flying a policy.

    Attributes:
        name: of the policy.
        n: side of the maps [cells].
        maps: names of those that it looks at, in order; the six of every game where the card does not say.
        zoom: of the full maps over n.
        uavs, vehicles: smallest and largest numbers trained for.
        ratio: smallest and largest zone side over range trained for.
        uav_step: smallest and largest move trained for [zone sides].
        steps: steps of a team in training.
        seeds: of the training.
        preset: the training preset.
        command: that made the policy.
        versions: of the libraries that did.
        evaluation: one entry for each kind of game it was tested on.
        limits: in words.
    """

    name: Annotated[str, Field(min_length=1, max_length=80)]
    n: Annotated[int, Field(ge=3, le=63)]
    maps: tuple[str, ...] = PAPER_MAPS
    zoom: Annotated[int, Field(ge=2, le=3)]
    uavs: tuple[Count, Count]
    vehicles: tuple[Count, Count]
    ratio: tuple[float, float]
    uav_step: tuple[float, float]
    steps: Count
    seeds: list[int]
    preset: str
    command: str
    versions: dict[str, str]
    evaluation: list[Evaluation]
    limits: str

    @field_validator("maps")
    @classmethod
    def _known(cls, maps: tuple[str, ...]) -> tuple[str, ...]:
        known = [
            map_names(obstacles=obstacles, energy=energy, tells_range=tells_range, outlook=outlook)
            for obstacles, energy, tells_range, outlook in product((False, True), repeat=4)
        ]
        if maps not in known:
            options = ", ".join(f"all of {more}" for more in (OBSTACLE_MAPS, ENERGY_MAPS, RANGE_MAPS, OUTLOOK_MAPS))
            raise ValueError(f"the six maps ({', '.join(PAPER_MAPS)}), then {options}")
        return maps
