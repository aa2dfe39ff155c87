"""The page's file: what it carries, that it carries it whole, and that nothing of a run can break out of it."""

from __future__ import annotations

import base64
import json
import re
import shutil
import zlib
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from skyrelay.core.errors import RunFolderError
from skyrelay.report import figures, write_figures, write_report
from skyrelay.report.payload import COLOURS, _quantised, encode
from skyrelay.runfolder import read_run
from skyrelay.runfolder.schema import SCHEMAS

_KINDS = {"Uint8Array": "u1", "Uint16Array": "<u2", "Int32Array": "<i4", "Float32Array": "<f4"}


def decode(payload: str) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """What the page's `load` does."""
    data = zlib.decompress(base64.b64decode(payload))
    length = int.from_bytes(data[:4], "little")
    header = json.loads(data[4 : 4 + length])
    arrays = {
        name: np.frombuffer(data, _KINDS[kind], size, 4 + length + offset)
        for name, (kind, offset, size) in header["arrays"].items()
    }
    return header, arrays


def test_every_row_of_the_run_is_in_the_page(recorded: Path) -> None:
    run = read_run(recorded)
    header, arrays = decode(encode(run))
    x0, _, x1, _ = header["box"]
    x = x0 + np.cumsum(arrays["vehicle_x"], dtype=np.uint16) / 65535 * (x1 - x0)
    fleet = [*header["uavs"], ""]
    carried = {
        (int(step), header["vehicles"][vehicle]): (float(at), fleet[uav], bool(covered))
        for vehicle, step, at, uav, covered in zip(
            *(arrays[name] for name in ("vehicle", "vehicle_step")),
            x,
            *(arrays[name] for name in ("vehicle_uav", "vehicle_covered")),
            strict=True,
        )
    }
    rows = pq.read_table(recorded / "vehicles.parquet").to_pylist()
    assert len(carried) == len(rows)
    for row in rows:
        at, uav, covered = carried[row["step"], row["vehicle"]]
        assert abs(at - row["x"]) < (x1 - x0) / 65535
        assert (uav, covered) == (row["uav"], row["covered"])
    zones = header["metricZones"]
    assert zones == sorted(set(run.metrics["zone"].tolist()))
    coverage = arrays["metric_coverage"].reshape(len(zones), run.summary.steps + 1)
    for zone, values in zip(zones, coverage, strict=True):
        np.testing.assert_array_equal(values, run.metric("coverage", zone).astype(np.float32))
    assert len(header["eventArgs"]) == len(arrays["event_step"]) == len(run.events["block"])
    assert (np.diff(arrays["event_step"]) >= 0).all()


@given(st.lists(st.floats(-500.0, 2500.0), min_size=1, max_size=50))
def test_positions_survive_to_a_sixteen_bit_step(values: list[float]) -> None:
    given_ = np.array(values)
    found = -500 + np.cumsum(_quantised(given_, -500.0, 2500.0), dtype=np.uint16) / 65535 * 3000
    assert np.abs(found - given_).max() <= 3000 / 65535


def test_events_call_accounts_by_their_names(recorded: Path) -> None:
    header, arrays = decode(encode(read_run(recorded)))
    name = {row["address"]: row["name"] for row in pq.read_table(recorded / "accounts.parquet").to_pylist()}
    rows = pq.read_table(recorded / "events.parquet").to_pylist()
    rows.sort(key=lambda row: (row["block"], row["tx"], row["log"]))
    for row, parts, kind in zip(rows, header["eventArgs"], arrays["event_name"], strict=True):
        shown = dict(zip(parts[::2], parts[1::2], strict=True))
        args = json.loads(row["args"])
        assert header["eventNames"][kind] == row["name"]
        if row["name"] == "UAVAllocated":
            assert shown["selected"] == ", ".join(name[address] for address in args["selected"])
        if row["name"] == "VehSelectionSubmitted":
            assert (shown["vehicle"], shown["uav"]) == (name[args["vehicle"]], name[args["uav"]])
            assert shown["qov"] == str(2**70)  # longer than a number of the page


def test_team_mates_differ_in_colour(recorded: Path) -> None:
    header, _ = decode(encode(read_run(recorded)))
    rows = [row for row in pq.read_table(recorded / "uavs.parquet").to_pylist() if row["selected"]]
    teams: dict[tuple[int, int], set[str]] = {}
    for row in rows:
        teams.setdefault((row["step"], row["zone"]), set()).add(row["uav"])
    colour = dict(zip(header["uavs"], header["colours"], strict=True))
    assert teams
    for team in teams.values():
        assert len(team) <= COLOURS
        assert len({colour[uav] for uav in team}) == len(team)


def test_same_folder_same_bytes(recorded: Path, tmp_path: Path) -> None:
    one, other = (shutil.copytree(recorded, tmp_path / name) for name in ("one", "other"))
    assert write_report(one).read_bytes() == write_report(other).read_bytes()
    for left, right in zip(write_figures(one), write_figures(other), strict=True):
        assert left.name == right.name
        assert left.read_bytes() == right.read_bytes()
        assert left.read_bytes()[:4] == (b"%PDF" if left.suffix == ".pdf" else b"\x89PNG")


def test_one_file_that_may_load_nothing(recorded: Path) -> None:
    text = write_report(recorded).read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    around = text[: text.index("<style>")] + text[text.index("</style>") : text.rindex("<script>")]
    assert not re.search(r"""(src|href)\s*=\s*["'](?!data:)""", around)
    assert not re.search(r"https?://", around)
    assert not re.search(r"\{\{\w+\}\}", around)
    assert "connect-src" not in text  # the live page alone may
    assert len(text) < 1.5e6
    assert str(recorded) not in text


def test_header_says_the_summary(recorded: Path) -> None:
    summary = json.loads((recorded / "summary.json").read_text())
    text = write_report(recorded).read_text(encoding="utf-8")
    for expected in (
        f"{100 * summary['coverage']:.1f}\u00a0%",
        f"{100 * summary['static_connectivity']:.1f}\u00a0%",
        f"Of {summary['vehicles_per_period']:.0f} connected vehicles at a time",
        f"keep {summary['in_range']:.0f} of them in range ({summary['static_in_range']:.0f} if the fleet hovered",
        summary["chain_head"],
        summary["contract"],
        *summary["model_cids"],
        summary["attribution"],
        "seed 1",
    ):
        assert expected in text


@pytest.mark.parametrize(
    "evil", ["</script><script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "{{payload}}"]
)
def test_text_of_a_run_is_never_markup(sample: ModuleType, tmp_path: Path, evil: str) -> None:
    tracks = sample.street_tracks(20, 10)
    tracks[evil] = tracks.pop("vehicle_000")
    run = sample.write_run_folder(tmp_path / "run", tracks, uavs=6)
    path = run / "summary.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"name": evil, "attribution": evil, "chain_head": evil}))
    text = write_report(run).read_text(encoding="utf-8")
    assert text.count("<script") == text.count("</script>") == 2
    assert "<img src=x" not in text
    assert evil in decode(encode(read_run(run)))[0]["vehicles"]


def test_text_that_utf8_cannot_hold(recorded: Path, tmp_path: Path) -> None:
    run = shutil.copytree(recorded, tmp_path / "run")
    table = pq.read_table(run / "events.parquet")
    args = ['{"id": "\\ud800"}', *table["args"].to_pylist()[1:]]
    pq.write_table(table.set_column(table.column_names.index("args"), "args", [args]), run / "events.parquet")
    assert ["id", "\ud800"] in decode(encode(read_run(run)))[0]["eventArgs"]


def test_a_run_without_a_single_vehicle_or_event(recorded: Path, tmp_path: Path) -> None:
    run = shutil.copytree(recorded, tmp_path / "run")
    for name in ("vehicles", "proposals", "events"):
        path = run / f"{name}.parquet"
        pq.write_table(pq.read_table(path).slice(0, 0), path)
    summary = json.loads((run / "summary.json").read_text())
    none = dict.fromkeys(("mean_qou", "mean_qov", "coverage", "static_coverage"))
    (run / "summary.json").write_text(json.dumps(summary | none))
    assert "–" in write_report(run).read_text(encoding="utf-8")
    assert len(write_figures(run)) == 10


def test_the_charts_tell_the_figures_of_the_summary(recorded: Path) -> None:
    run = read_run(recorded)
    figure = Figure()
    for draw, names in (
        (figures._coverage, ["coverage", "static_coverage"]),
        (figures._connectivity, ["connectivity", "connectivity_neighbor", "static_connectivity"]),
        (figures._bandwidth, ["carried_mbps", "delivered_mbps", "static_carried_mbps"]),
    ):
        axes = figure.subplots()
        draw(run, axes)
        told = [text.get_text() for text in axes.get_legend().get_texts()]
        wanted = [getattr(run.summary, name) for name in names]
        percent = draw is not figures._bandwidth
        assert [float(re.findall(r"\(([\d.]+) ", text)[0]) for text in told] == [
            round(value * (100 if percent else 1), 1) for value in wanted
        ]
        figure.clear()
    axes = figure.subplots()
    figures._selection(run, axes)
    assert axes.get_ylabel()


def test_the_page_has_what_each_vehicle_asks_for_and_gets(recorded: Path) -> None:
    run = read_run(recorded)
    header, arrays = decode(encode(run))
    rows = {(row["step"], row["vehicle"]): row for row in pq.read_table(recorded / "vehicles.parquet").to_pylist()}
    told = zip(arrays["vehicle_step"].tolist(), arrays["vehicle"].tolist(), strict=True)
    names = ("demand", "carried", "delivered", "static_carried", "static_delivered")
    for index, (step, vehicle) in enumerate(told):
        row = rows[step, header["vehicles"][vehicle]]
        for name in names:
            assert arrays[f"vehicle_{name}"][index] == round(row[f"{name}_kbps"])
    assert all(arrays[f"vehicle_{name}"].any() for name in names)
    assert arrays["metric_carried_mbps"].max() > 0


def test_a_share_of_all_connected_vehicles_is_in_range(recorded: Path) -> None:
    run = read_run(recorded)
    header, arrays = decode(encode(run))
    rows = pq.read_table(recorded / "vehicles.parquet").to_pylist()
    shape = (len(header["metricZones"]), run.summary.steps + 1)
    for name, covered in (("in_range_share", "covered"), ("static_in_range_share", "static_covered")):
        whole = arrays[f"metric_{name}"].reshape(shape)[0]
        for step in (0, 9, 30):
            here = [row[covered] for row in rows if row["step"] == step]
            assert whole[step] == pytest.approx(sum(here) / len(here))


def test_streets_are_carried_from_the_boxs_corner(recorded: Path, tmp_path: Path) -> None:
    run = shutil.copytree(recorded, tmp_path / "run")
    assert not decode(encode(read_run(run)))[1]["street_length"].size  # none were named
    streets: dict[str, Any] = {
        "street": [0, 0, 1, 1, 1],
        "x": [0.0, 50.0, 7.0, 8.0, 9.0],
        "y": [1.0, 2.0, 3.0, 4.0, 5.0],
    }
    table = pa.table(streets).cast(SCHEMAS["streets"])
    pq.write_table(table, run / "streets.parquet")
    header, arrays = decode(encode(read_run(run)))
    assert arrays["street_length"].tolist() == [2, 3]
    np.testing.assert_allclose(arrays["street_x"] + header["box"][0], streets["x"], atol=1e-3)
    np.testing.assert_allclose(arrays["street_y"] + header["box"][1], streets["y"], atol=1e-3)
    pq.write_table(table.slice(1), run / "streets.parquet")
    read_run(run)
    pq.write_table(table.slice(2), run / "streets.parquet")
    with pytest.raises(RunFolderError, match=r"streets\.parquet"):
        read_run(run)


def _luminance(colour: str) -> float:
    """Of WCAG 2, from #rrggbb."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))


@pytest.mark.parametrize("theme", [":root {", ':root[data-theme="dark"] {'])
def test_colours_are_told_from_what_they_lie_on(theme: str) -> None:
    """3:1 for what is drawn on the map, 4.5:1 for text (WCAG 2, 1.4.11 and 1.4.3)."""
    style = (files("skyrelay.report") / "assets" / "colours.css").read_text("utf-8")
    colours = dict(re.findall(r"--(\w+): (#\w{6})", style.partition(theme)[2].partition("}")[0]))
    drawn = [f"c{index}" for index in range(COLOURS)] + ["grey", "zone", "street", "disc", "warn"]
    pairs = [(name, "map", 3.0) for name in drawn]
    pairs += [(name, ground, 4.5) for name in ("ink", "muted") for ground in ("map", "panel", "page")]
    pairs += [(name, "panel", 4.5) for name in ("learned", "static")]
    for name, ground, least in pairs:
        light, dark = sorted((_luminance(colours[name]), _luminance(colours[ground])), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= least, f"{name} on {ground}"
