"""A recorded run told as a live feed, at the pace at which it was flown."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from skyrelay.report.alerts import alerts
from skyrelay.report.payload import event_arguments
from skyrelay.runfolder import Run
from skyrelay.runfolder.feed import Event, Feed, Header, Record, Uav, Vehicle, header_of

_NOBODY = np.empty(0, np.int64)


async def replay(run: Run, speed: float = 1.0) -> Feed:
    """The run's header and its steps, each when it is due.

    Args:
        speed: times real time; inf for all at once.
    """
    yield header(run)
    loop = asyncio.get_running_loop()
    begin, seconds = loop.time(), run.summary.step_seconds / speed
    for record in records(run):
        await asyncio.sleep(begin + record.step * seconds - loop.time())
        yield record


def header(run: Run) -> Header:
    """A run's header, of a session of its own."""
    ends = np.flatnonzero(np.diff(run.streets["street"])) + 1
    corners = np.column_stack([run.streets["x"], run.streets["y"]])
    lines = np.split(corners, ends) if len(corners) else []
    return header_of(run.scenario, run.grid, run.summary.range_m, lines)


def records(run: Run) -> Iterator[Record]:
    """A run's steps."""
    names = dict(zip(run.accounts["address"], run.accounts["name"], strict=True))
    told: dict[int, list[Event]] = {}
    for row in np.lexsort((run.events["log"], run.events["tx"], run.events["block"])).tolist():
        event = Event(int(run.events["block"][row]), run.events["name"][row], event_arguments(run, row, names))
        told.setdefault(int(run.events["step"][row]), []).append(event)
    warned: dict[int, list[int]] = {}
    found = alerts(run)
    for index, (step, _) in enumerate(found):
        warned.setdefault(step, []).append(index)
    vehicles, uavs = _by_step(run.vehicles["step"]), _by_step(run.uavs["step"])
    for step in range(run.summary.steps + 1):
        here, fleet = vehicles.get(step, _NOBODY), uavs.get(step, _NOBODY)
        yield Record(
            step=step,
            vehicles=[
                Vehicle(*row)
                for row in zip(
                    *(run.vehicles[name][here].tolist() for name in ("vehicle", "x", "y", "uav", "covered")),
                    strict=True,
                )
            ],
            uavs=[
                Uav(*row)
                for row in zip(
                    *(run.uavs[name][fleet].tolist() for name in ("uav", "x", "y", "zone", "battery", "selected")),
                    strict=True,
                )
            ],
            events=told.get(step, []),
            alerts=[found[index][1] for index in warned.get(step, [])],
        )


def _by_step(steps: npt.NDArray[np.int32]) -> dict[int, npt.NDArray[np.int64]]:
    """The rows of each step."""
    order = np.argsort(steps, kind="stable")
    values, starts = np.unique(steps[order], return_index=True)
    return dict(zip(values.tolist(), np.split(order, starts[1:]), strict=True)) if len(values) else {}
