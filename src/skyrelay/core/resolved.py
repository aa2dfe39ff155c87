"""A scenario in its area: what depends on the area is a number here, so that nobody has to ask whether it is."""

from __future__ import annotations

import math

from pydantic import Field

from skyrelay.core.scenario import ChargingPoint, Fleet, Length, Scenario
from skyrelay.core.zones import ZoneGrid


class ResolvedFleet(Fleet):
    """A fleet whose range is known."""

    range: Length = Field(description="of the UAV-vehicle and the UAV-UAV link [m]")


class ResolvedScenario(Scenario):
    """A scenario whose range is a number, and whose distance gate is no further than it."""

    fleet: ResolvedFleet


def resolve(scenario: Scenario, grid: ZoneGrid) -> ResolvedScenario:
    """The scenario over a grid: the range where it has none, and the distance gate no further than it."""
    reach = scenario.fleet.range if scenario.fleet.range is not None else grid.side / 2
    gate = _down_to_tenths(min(scenario.selection.max_distance, reach))
    sections = {name: getattr(scenario, name) for name in Scenario.model_fields}
    return ResolvedScenario(
        **sections
        | {
            "fleet": ResolvedFleet(**dict(scenario.fleet) | {"range": reach}),
            "selection": scenario.selection.model_copy(update={"max_distance": gate}),
        }
    )


def charging_points(scenario: Scenario, grid: ZoneGrid) -> tuple[ChargingPoint, ...]:
    """Where UAVs land to be charged: the scenario's list, or one in each zone; none where there are no places."""
    energy = scenario.energy
    if scenario.charging or not energy.places:
        return scenario.charging
    (east, north), side = energy.charging_point, grid.side
    corners = ((zone, *grid.corner(zone)) for zone in grid.ids)
    return tuple(
        ChargingPoint(
            name=f"zone {zone}",
            x=x + east * side,
            y=y + north * side,
            places=energy.places,
            power=energy.charging_power,
        )
        for zone, x, y in corners
    )


def _down_to_tenths(distance: float) -> float:
    """Down to the contract's 0.1 m, so that what a vehicle takes for a candidate the contract does too.

    What is there already stays, though ten times it may be a hair below a whole number: resolved twice is resolved.
    """
    nearest = round(distance, 1)
    return nearest if math.isclose(nearest, distance, abs_tol=1e-9) else math.floor(distance * 10) / 10
