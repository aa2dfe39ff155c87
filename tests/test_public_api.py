"""The public interface: what there is, what it costs to import, and that each of it does what it says."""

import subprocess
import sys
from importlib.resources import files
from typing import Any

import numpy as np
import pandas as pd
import pytest

import skyrelay as sr
from skyrelay.airspace.flight import ACTIONS

FEW = {
    "mobility.penetration": 0.04,
    "fleet.uavs": 6,
    "coordination.steps": 4,
    "coordination.period_steps": 2,
    "zones.columns": 1,
    "zones.rows": 1,
}
NAMES = {
    "Policy",
    "RunFolder",
    "Scenario",
    "Selection",
    "Sight",
    "SkyRelayError",
    "UavTable",
    "VehicleTable",
    "__version__",
    "compare",
    "evaluate",
    "load_run",
    "load_scenario",
    "make",
    "make_vec",
    "policies",
    "run",
    "select",
}


def test_these_names_and_no_others():
    assert set(sr.__all__) == NAMES == set(dir(sr))
    for name in NAMES:
        assert getattr(sr, name) is not None
        assert name.startswith("_") or getattr(sr, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'tarin'"):
        sr.tarin  # noqa: B018


def test_the_package_is_typed():
    assert (files("skyrelay") / "py.typed").is_file()


def test_importing_it_imports_nothing_else():
    """Half of what a user waits for would be JAX: it is imported when a game is made."""
    told = "import sys, skyrelay; print(*sorted(name.partition('.')[0] for name in sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True).stdout.split()
    assert not {"jax", "numpy", "pyarrow", "pydantic", "onnxruntime", "matplotlib", "typer"} & set(loaded)
    told = "import sys, skyrelay as sr; sr.load_run, sr.run, sr.select, sr.Policy; print('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True).stdout == "False\n"


def hover_or_east(sight: sr.Sight) -> int:
    return 1 if sight.battery > 20 else 0


def nobody(vehicles, uavs, settings):
    return np.full(len(vehicles), -1)


@pytest.fixture(scope="module")
def cover(tmp_path_factory):
    return sr.run(
        "bologna", out=tmp_path_factory.mktemp("runs") / "cover-1", policy="cover", settings=FEW, report=False
    )


def test_a_run_and_its_tables(cover):
    assert cover.summary.decided_by == ["rule cover"]
    frame = cover.vehicles.to_pandas()
    assert len(frame) == cover.vehicles.num_rows > 0
    assert {"step", "vehicle", "x", "y", "uav"} <= set(frame.columns)
    # Whatever takes Arrow's protocols takes the table: pandas by one, Polars and DuckDB by the other.
    assert pd.api.interchange.from_dataframe(cover.uavs).shape == cover.uavs.to_pandas().shape
    assert hasattr(cover.metrics, "__arrow_c_stream__")
    assert cover.scenario.coordination.policy == "cover"
    assert sr.load_run(cover.path).proposals.equals(cover.proposals)
    with pytest.raises(sr.SkyRelayError):
        sr.load_run(cover.path.parent)
    with pytest.raises(sr.SkyRelayError):
        cover.table("passwords")


def test_functions_of_ones_own(tmp_path):
    run = sr.run("bologna", out=tmp_path / "own", policy=hover_or_east, method=nobody, settings=FEW, report=False)
    assert run.summary.served == 0
    run = sr.run("bologna", out=tmp_path / "east", policy=lambda sight: 1, settings=FEW, report=False)
    assert 1 in set(run.uavs["action"].to_pylist()) <= {0, 1}


def test_comparing(cover, tmp_path):
    other = sr.run("bologna", out=tmp_path / "hovering", policy="hovering", settings=FEW, report=False)
    rows = sr.compare([cover.path, other.path], tmp_path / "figure.png").to_pandas()
    (row,) = rows[(rows.measure == "in_range") & (rows.runs == "coordination.policy=hovering")].to_dict("records")
    assert row["difference_mean"] == pytest.approx(other.summary.in_range - cover.summary.in_range)
    assert (tmp_path / "figure.png").exists()


def test_a_scenario_and_overrides_are_one_or_the_other(tmp_path):
    with pytest.raises(sr.SkyRelayError, match="beside seed"):
        sr.run(sr.load_scenario("bologna"), out=tmp_path / "x", seed=3)


def test_selecting():
    from skyrelay.selection.instances import draw_instance

    vehicles, uavs = draw_instance(30, 8, 1, sr.load_scenario("paper"))
    assert isinstance(sr.select(vehicles, uavs, "nnm"), sr.Selection)


def test_a_game():
    game = sr.make("paper", uavs=2, vehicles=4, steps=5, n=5, render_mode="rgb_array")
    game.reset(seed=1)
    picture = game.render()
    assert picture is not None
    assert picture.shape == (480, 480, 3)
    assert picture.dtype == np.uint8
    game.step(dict.fromkeys(game.agents, 1))
    assert (game.render() != picture).any()
    with pytest.raises(sr.SkyRelayError, match="one of paper, varied"):
        sr.make("chess")  # type: ignore[arg-type]
    with pytest.raises(sr.SkyRelayError, match="rgb_array"):
        sr.make("paper", render_mode="human")


def test_evaluating():
    from skyrelay.baselines.player import Player, Static

    class Still(Static):
        """A player of one's own."""

    options: dict[str, Any] = {"uavs": 2, "vehicles": 4, "episodes": 4}
    static = sr.evaluate("static", **options)
    assert sr.evaluate(Still(), **options) == static
    assert issubclass(Still, Player)
    assert sr.evaluate("generalist", **options)["return"]["mean"] > static["return"]["mean"]
    with pytest.raises(sr.SkyRelayError, match="did you mean 'generalist'"):
        sr.evaluate("genralist", **options)
    for episodes in (0, -1):
        with pytest.raises(sr.SkyRelayError, match="1 to 100,000"):
            sr.evaluate("static", episodes=episodes)
    assert "generalist" in sr.policies()
    assert ACTIONS == 9


untyped: Any = sr
"""As who does not check types calls it."""


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: untyped.make(uavs=2.5), "make: uavs: is 2.5; expected a whole number"),
        (lambda: untyped.make(vehicles="20"), "make: vehicles"),
        (lambda: untyped.make(steps=True), "make: steps"),
        (lambda: untyped.make_vec(games=1.0), "make_vec: games"),
        (lambda: untyped.evaluate(3), "evaluate: player: is 3"),
        (lambda: untyped.evaluate("cover", uavs=None), "evaluate: uavs"),
        (lambda: untyped.evaluate("cover", vehicles=(1, 2, 3)), "evaluate: vehicles"),
        (lambda: untyped.evaluate("cover", episodes="ten"), "evaluate: episodes"),
        (lambda: untyped.evaluate("cover", trace=7), "evaluate: trace"),
        (lambda: untyped.evaluate("cover", games="energy", trace="bologna"), "paper or varied beside a trace"),
        (lambda: untyped.run(7), "run: scenario: is 7"),
        (lambda: untyped.run("bologna", seed=1.5), "run: seed"),
        (lambda: untyped.run("bologna", settings=["fleet.uavs=2"]), "run: settings"),
        (lambda: untyped.load_run(None), "load_run"),
        (lambda: untyped.compare("runs/one"), "compare: runs"),
        (lambda: untyped.compare([1, 2]), "compare: runs: is 1"),
    ],
)
def test_an_argument_of_another_kind_is_one_clear_line(call, told):
    with pytest.raises(sr.SkyRelayError, match=told):
        call()


def test_evaluating_on_a_trace():
    options: dict[str, Any] = {"uavs": 2, "vehicles": 4, "episodes": 4}
    replayed = sr.evaluate("static", trace="bologna", **options)
    assert replayed == sr.evaluate("static", trace="bologna", **options)
    assert replayed != sr.evaluate("static", **options)
