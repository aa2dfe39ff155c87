"""What the chain's events say of a run so far: who joined and left, who proposed to whom, who serves whom."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from skyrelay.chain.abi import Event
from skyrelay.core.entities import IntArray
from skyrelay.simulation.flight import NOBODY


class Ledger:
    """The books of one run, kept from the contract's events alone.

    Args:
        vehicles, uavs: the row of each member by its address.

    Attributes:
        zones: that UAVs have changed to since they were last taken away, by row; 0: left.
        proposals: of the present period, in the order of submission.
        models: ids of all that were assigned.
    """

    def __init__(self, vehicles: Mapping[str, int], uavs: Mapping[str, int]) -> None:
        self._vehicles, self._uavs = vehicles, uavs
        self.zones: dict[int, int] = {}
        self.proposals: list[dict[str, Any]] = []
        self.models: set[str] = set()
        self._submitted = 0
        self._held: dict[str, list[str]] = {}

    def hear(self, event: Event) -> None:
        """Note an event."""
        args = event.args
        match event.name:
            case "UAVZoneUpdated":
                self.zones[self._uavs[args["uav"]]] = args["to"]
            case "VehSelectionSubmitted":
                self.proposals.append(
                    {
                        "vehicle": self._vehicles[args["vehicle"]],
                        "uav": self._uavs[args["uav"]],
                        "zone": args["zone"],
                        "qov": args["qov"],
                        "score": args["score"],
                        "order": self._submitted,
                    }
                )
                self._submitted += 1
            case "UAVAllocated":
                self._held[args["uav"]] = args["selected"]
            case "ModelAssigned":
                self.models.add(args["modelId"])

    def open_period(self) -> None:
        """The period before is over: what belonged to it is void."""
        self.proposals, self._held = [], {}

    def take_zones(self) -> dict[int, int]:
        """The zones that UAVs have changed to since this was last called, by row; 0 where one has left."""
        zones, self.zones = self.zones, {}
        return zones

    def owner(self) -> IntArray:
        """[V] the row of the UAV that serves each vehicle in this period, or -1."""
        owner = np.full(len(self._vehicles), NOBODY)
        for uav, vehicles in self._held.items():
            owner[[self._vehicles[vehicle] for vehicle in vehicles]] = self._uavs[uav]
        return owner
