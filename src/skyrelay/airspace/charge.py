"""What flying takes from a battery and a charging point gives back, for any array library."""

from __future__ import annotations

from typing import Any, NamedTuple


class Charger(NamedTuple):
    """A charging point.

    Attributes:
        point: [..., 2] where it is.
        radius: [...] within which a UAV that hovers is charged; in the unit of the positions.
    """

    point: Any
    radius: Any


class Cost(NamedTuple):
    """Of one step, in the unit of the charge.

    Attributes:
        hover, move: what it takes.
        gain: what it gives to who hovers at a charging point.
    """

    hover: Any
    move: Any
    gain: Any


def at_charger(uavs: Any, charger: Charger) -> Any:
    """[...] whether UAVs at [..., 2] are within the charging point's radius."""
    xp = uavs.__array_namespace__()
    apart = uavs - charger.point
    return xp.sum(apart * apart, axis=-1) <= charger.radius**2


def spend(charge: Any, moved: Any, airborne: Any, at_point: Any, cost: Cost, full: float) -> Any:
    """The charge after a step.

    Args:
        charge: [...] before it.
        moved: [...] whether the UAV's action was a move.
        airborne: [...] who is on the ground spends nothing.
        at_point: [...] whether the step ended at a charging point; who hovers there is charged.
        cost: of the step.
        full: charge of a full battery.
    Returns: [...] in [0, full].
    """
    xp = charge.__array_namespace__()
    flown = xp.where(moved, cost.move, cost.hover)
    change = xp.where(at_point & ~moved, cost.gain, xp.where(airborne, -flown, 0.0))
    return xp.clip(charge + change, 0.0, full)
