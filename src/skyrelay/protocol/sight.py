"""How UAVs of one process that see the same team have their policy's answers worked out at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from skyrelay.airspace.observation import Scene
from skyrelay.airspace.sight import Position, Sight
from skyrelay.policy import Policy


def decide(policy: Policy, sights: Sequence[Sight]) -> list[int]:
    """The policy's action for each sight, from that sight alone.

    UAVs of one team whose news are all fresh look at one picture, each from its own place: their maps are drawn
    together, and are those that each would draw alone.
    """
    pictures: dict[object, list[int]] = {}
    for row, sight in enumerate(sights):
        everyone = tuple(sorted((sight.own, *sight.team)))
        pictures.setdefault(row if any(sight.margins) else (sight.zone, everyone), []).append(row)
    maps = [_look(policy, [sights[row] for row in rows]) for rows in pictures.values()]
    order = [row for rows in pictures.values() for row in rows]
    actions = policy.decide(np.concatenate(maps))
    chosen = dict(zip(order, actions.tolist(), strict=True))
    return [chosen[row] for row in range(len(sights))]


def _look(policy: Policy, sights: Sequence[Sight]) -> npt.NDArray[np.float32]:
    """[sights, maps, n, n] of UAVs that look at one picture."""
    first = sights[0]
    law, zone = first.law, first.zone
    seers = [sight.own for sight in sights]
    others, held = first.team, None
    if len(sights) > 1:
        others = tuple((Counter((first.own, *first.team)) - Counter(seers)).elements())
    elif any(first.margins):
        held = np.full((1 + len(others), 1 + len(others)), law.reach)
        held[0, 1:] = held[1:, 0] = np.maximum(law.reach - np.array(first.margins), 0.0)
    scene = Scene.in_metres(
        _points([*seers, *others]),
        _points([place for sight in sights for place in sight.vehicles]),
        np.repeat(np.arange(len(sights)), [len(sight.vehicles) for sight in sights]),
        law.grid.corner(zone),
        law.grid.side,
        law.reach,
        step=law.stride,
        walls=law.walls_near(zone),
        charger=law.charger(zone),
        flight=np.array([law.flight(sight.battery) for sight in sights]),
        held=held,
    )
    return policy.observer.look(scene, len(sights))


def _points(places: Sequence[Position]) -> npt.NDArray[np.float64]:
    return np.array(places, dtype=np.float64).reshape(-1, 2)
