"""A rule for each UAV alone: hold the traffic that it has taken on, and be within reach of more when next selected.

What a UAV carries is lost when a vehicle leaves its range, so what its own vehicles ask for counts in full. Vehicles
that no UAV serves count less, and the less the more mates are near them: at the next selection some UAV has to be in
their range. The team stays linked without a word (`skyrelay.airspace.guard`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skyrelay.airspace.flight import ACTIONS, HEADINGS, move
from skyrelay.airspace.guard import too_far
from skyrelay.airspace.sight import Position, Sight
from skyrelay.core.entities import FloatArray

RADII = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5)
"""Where a UAV considers to go, about where it is [ranges]."""
EDGE = 1.0 / 3.0
"""Steps over which a vehicle at the edge of the range counts less and less: it may be gone on arrival."""
SOUGHT = 0.3
"""Weight of what vehicles without a UAV ask for, beside what the own ones do."""
GAP_COST = 100.0
"""Mean demands that a place must hold more for each step that it is too far for a link: a link outweighs them all."""


def serve(sight: Sight) -> int:
    """The action, 0 to 8, towards the place, of 57 about the UAV, that holds most of what is asked for.

    Args:
        sight: with the demands of its own vehicles; without them each counts alike.
    """
    law, own = sight.law, np.array(sight.own)
    team = np.array([sight.own, *sight.team])
    held = np.full((len(team), len(team)), law.reach)
    held[0, 1:] = held[1:, 0] = np.maximum(law.reach - np.array(sight.margins), 0.0)

    def gap(places: FloatArray) -> FloatArray:
        """[P] steps to where every link holds; who has not been selected holds none."""
        if not sight.selected:
            return np.zeros(len(places))
        teams = np.repeat(team[None], len(places), axis=0)
        teams[:, 0] = places
        away: FloatArray = too_far(teams, team, np.ones(len(team), dtype=bool), held)[:, 0] / law.stride
        return away

    vehicles, seekers = _points(sight.vehicles), _points(sight.seekers)
    demands = np.array(sight.demands) if sight.demands else np.ones(len(vehicles))
    mates = _inside(law.reach, law.stride, team[1:], seekers).sum(axis=0)
    sought = np.array(sight.sought) / (1.0 + mates)
    places = np.clip(own + law.reach * _ABOUT, *law.fence(sight.zone, own))
    carries = (_inside(law.reach, law.stride, places, vehicles) * demands).sum(axis=1)
    finds = (_inside(law.reach, law.stride, places, seekers) * sought).sum(axis=1)
    asked = [*demands.tolist(), *sight.sought]
    mean = float(np.mean(asked)) if asked else 1.0
    best = places[np.argmax(carries + SOUGHT * finds - GAP_COST * mean * gap(places))]

    ends = move(np.tile(own, (ACTIONS, 1)), np.arange(ACTIONS), np.array(law.stride), *law.fence(sight.zone, own))
    return int(np.argmin(np.hypot(*(ends - best).T) / law.stride + GAP_COST * gap(ends)))


def _inside(reach: float, stride: float, places: FloatArray, points: FloatArray) -> FloatArray:
    """[P, V] how surely each point is in range of each place, from 0 to 1."""
    apart = np.hypot(*(places[:, None] - points[None]).transpose(2, 0, 1))
    inside: FloatArray = 1.0 / (1.0 + np.exp(np.clip((apart - reach) / (EDGE * stride), -50.0, 50.0)))
    return inside


def _points(places: Sequence[Position]) -> FloatArray:
    return np.array(places, dtype=np.float64).reshape(-1, 2)


def _about() -> FloatArray:
    """[57, 2] the places that a UAV considers, seen from where it is [ranges]; the first is where it is."""
    angles = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.concatenate([np.zeros((1, 2)), *(radius * circle for radius in RADII)])


_ABOUT = _about()
