from __future__ import annotations

import json

import pytest

from skyrelay.core.errors import RunFolderError
from skyrelay.runfolder.feed import (
    LONGEST_MESSAGE,
    Alert,
    Event,
    Header,
    Record,
    Uav,
    Vehicle,
    read_header,
    read_record,
)
from skyrelay.runfolder.schema import Grid

HEADER = Header(
    session="a", name="city", step_seconds=2.0, period_steps=20, range_m=300.0, reserve=3.0,
    grid=Grid(x0=0.0, y0=-5.0, side=600.0, columns=3, rows=2), streets=[[0.0, 0.0, 100.0, 0.0]],
)  # fmt: skip
RECORD = Record(
    step=7,
    vehicles=[Vehicle("007", 1.5, 2.0, "u1", True), Vehicle("</script>", 0.0, 0.0)],
    uavs=[Uav("u1", 10.0, 20.0, 4, 55.5, True, 0.4), Uav("u2", 0.0, 0.0, 0, 2.0, False)],
    events=[Event(12, "UAVAllocated", ["uav", "u1", "zone", "4"])],
    alerts=[Alert("low-battery", "u2", "u2 has 2.0 % left")],
)


def test_a_feed_says_the_same_after_its_way_as_text() -> None:
    assert read_header(HEADER.model_dump_json()) == HEADER
    assert read_record(RECORD.model_dump_json().encode()) == RECORD


def test_rows_are_lists() -> None:
    assert json.loads(RECORD.model_dump_json())["vehicles"][0] == ["007", 1.5, 2.0, "u1", True]


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"step": -1}, "record: step"),
        ({"step": True}, "record: step"),
        ({"vehicles": [["v", float("nan"), 0, "", False]]}, "vehicles.0.1"),
        ({"vehicles": [["", 0, 0, "", False]]}, "vehicles.0.0"),
        ({"vehicles": [["v" * 257, 0, 0, "", False]]}, "vehicles.0.0"),
        ({"uavs": [["u", 0, 0, 1, 50, True, -1]]}, "uavs.0.6"),
        ({"uavs": 3}, "record: uavs"),
        ({"alerts": [["fire", "", "x"]]}, "alerts.0.0"),
        ({"events": [[1, "E", ["x"] * 101]]}, "events.0.2"),
    ],
)
def test_a_record_that_does_not_fit_is_named(change: dict[str, object], place: str) -> None:
    with pytest.raises(RunFolderError, match=place):
        read_record(json.dumps(json.loads(RECORD.model_dump_json()) | change))


def test_what_is_too_long_or_deep_or_no_json_is_not_parsed() -> None:
    for message in (b" " * (LONGEST_MESSAGE + 1), "[" * 1000, "nothing", b"\xff"):
        with pytest.raises(RunFolderError, match="live feed: header"):
            read_header(message)
