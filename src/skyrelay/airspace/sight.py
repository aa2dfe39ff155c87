"""What one UAV knows when it decides: what a policy's maps are drawn from, and what a rule looks at."""

from __future__ import annotations

from dataclasses import dataclass

from skyrelay.airspace.law import Law

Position = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Sight:
    """What a UAV knows at the moment of its decision.

    Attributes:
        law: of the area.
        zone: that it flies in.
        own: its position [m].
        team: where its team mates were last [m].
        margins: how much nearer than the range each link has to be held, for what is not known of the mate [m].
        vehicles: where its own vehicles were last [m].
        battery: its own [0-100].
        uav: its name.
        decisions: that it has made since it was last selected.
        selected: whether it has been selected by a vehicle; one that has not need not stay linked.
        demands: of each of its vehicles [kbit/s].
        seekers: where vehicles of the zone that have no UAV were last [m].
        sought: what each of these asks for [kbit/s].
    """

    law: Law
    zone: int
    own: Position
    team: tuple[Position, ...]
    margins: tuple[float, ...]
    vehicles: tuple[Position, ...]
    battery: float
    uav: str = ""
    decisions: int = 0
    selected: bool = True
    demands: tuple[float, ...] = ()
    seekers: tuple[Position, ...] = ()
    sought: tuple[float, ...] = ()
