"""The selection panels: tasks, files, and verdicts that follow the numbers."""

import csv
import json
from typing import Any

import numpy as np
import pytest

from skyrelay.core.errors import UsageError
from skyrelay.core.scenario import load_scenario
from skyrelay.core.statistics import interval
from skyrelay.experiments import selection, sensitivity
from skyrelay.experiments.claims import CLAIMS, Finding, write_claims_page, write_findings
from skyrelay.experiments.figures import FIGURES, check_scale, load_figure, reproduce
from skyrelay.experiments.plotting import line, panels, save
from skyrelay.experiments.runner import Experiment, run
from skyrelay.selection import evaluate, select
from skyrelay.selection.instances import draw_instance


@pytest.fixture
def small(monkeypatch):
    """The smoke scale at two numbers of UAVs and two seeds."""
    monkeypatch.setattr(selection, "_SCALES", {"smoke": ((20, 40), 2)})
    monkeypatch.setattr(sensitivity, "_SEEDS", {"smoke": 2})


def test_the_papers_scale_is_the_papers():
    tasks = selection.experiment("paper").tasks
    assert {task.settings["uavs"] for task in tasks} == set(range(20, 161, 20))
    assert len(tasks) == 2 * 8 * 100
    assert tasks[0].settings["vehicles"] == 200


def test_a_task_measures_what_select_gives():
    task = next(task for task in selection.experiment("paper").tasks if task.name == "zone-40-3")
    rows = {row["method"]: row for row in selection.compare(**task.settings)}
    assert list(rows) == list(selection.METHODS)
    scenario = load_scenario("paper", ["selection.candidates=zone"])
    tables = draw_instance(200, 40, 3, scenario)
    metrics = evaluate(*tables, select(*tables, settings=scenario.selection, rounds=1), scenario.selection)
    assert rows["two-sided"]["mean_qou"] == metrics.mean_qou
    assert rows["two-sided"]["blocking_pairs"] == metrics.blocking_pairs
    assert rows["optimal (served)"]["served"] >= max(row["served"] for row in rows.values()) * (1 - 2e-3)
    assert rows["two-sided, all rounds"]["served"] >= rows["two-sided"]["served"]


def test_reproducing_writes_every_file_and_the_page(tmp_path, small):
    rendered = reproduce("selection", "smoke", tmp_path / "selection-smoke")
    names = {path.name for path in rendered.files}
    assert names == {"summary.csv", "claims.json"} | {
        f"selection-{r}.{s}" for r in ("range", "zone") for s in ("pdf", "png")
    }
    assert all(path.stat().st_size > 500 for path in rendered.files)
    with (tmp_path / "selection-smoke" / "summary.csv").open() as file:
        summary = list(csv.DictReader(file))
    one = next(
        row
        for row in summary
        if (row["candidates"], row["uavs"], row["method"], row["metric"]) == ("zone", "40", "nnm", "mean_qou")
    )
    values: list[Any] = []
    for seed in (1, 2):
        scenario = load_scenario("paper", ["selection.candidates=zone"])
        tables = draw_instance(200, 40, seed, scenario)
        values.append(
            evaluate(*tables, select(*tables, "nnm", settings=scenario.selection), scenario.selection).mean_qou
        )
    assert float(one["mean"]) == pytest.approx(np.mean(values))
    page = write_claims_page(tmp_path).read_text()
    for claim in CLAIMS:
        assert claim.says.replace("|", "\\|") in page
    assert "candidates: zone, 2 seeds ([selection-smoke](selection-smoke/))" in page
    assert page.count("not measured here") == sum(not claim.key.startswith("selection.") for claim in CLAIMS)


def test_equal_figures_are_equal_files(tmp_path):
    for folder in ("a", "b"):
        figure, (axis,) = panels(1, 1, "title")
        line(axis, [1, 2, 3], [interval([1.0, 2.0]), interval([2.0, 3.0]), interval([])], "label", 0)
        (tmp_path / folder).mkdir()
        save(figure, tmp_path / folder, "plot")
    for name in ("plot.pdf", "plot.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_panels_on_ray_are_the_same_to_the_last_digit(tmp_path, small, cluster):
    whole = selection.experiment("smoke")
    few = Experiment(whole.name, whole.function, whole.tasks[::5])
    here = run(few, tmp_path / "here")
    there = run(few, tmp_path / "there", ray=cluster)
    assert there.equals(here)
    assert (tmp_path / "here" / "results.parquet").read_bytes() == (tmp_path / "there" / "results.parquet").read_bytes()


def test_a_sweep_runs_and_draws(tmp_path, small):
    rendered = reproduce("selection-distance", "smoke", tmp_path / "distance")
    assert {path.suffix for path in rendered.files} == {".csv", ".pdf", ".png"}
    with (tmp_path / "distance" / "summary.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(row["candidates"], row["x"]) for row in rows} == {(r, x) for r in ("range", "zone") for x in ("1", "15")}
    assert all(np.isfinite(float(row["mean"])) for row in rows)


@pytest.mark.parametrize("name", [name for name in FIGURES if name.startswith("selection-")])
def test_every_point_of_a_sweep_is_a_valid_scenario_of_its_own(name):
    settings = {
        (task.settings["labels"]["series"], task.settings["labels"]["x"]): tuple(task.settings["overrides"])
        for task in load_figure(name).experiment("paper").tasks
        if task.settings["labels"]["candidates"] == "zone"
    }
    scenarios = [load_scenario("paper", overrides) for overrides in settings.values()]
    assert len({scenario.model_dump_json() for scenario in scenarios}) >= len(settings) - 3  # weights meet at 0.25


def results_of(ours, theirs, counts=(20, 80, 160)):
    """Results in which two-sided and NNM have given values, with a little noise over ten seeds."""
    rows = []
    for uavs, our, their in zip(counts, ours, theirs, strict=True):
        for seed in range(1, 11):
            noise = 1.0 + 1e-4 * (seed - 5.5)
            for method in selection.METHODS:
                values = our if method.startswith("two-sided") else their
                row = {"candidates": "zone", "uavs": uavs, "method": method, "seed": seed}
                names = ("mean_qou", "mean_qov", "vehicles_per_uav", "uavs_selected_percent", "blocking_pairs")
                rows.append(row | {name: value * noise for name, value in zip(names, values, strict=True)})
    return selection.Results(rows)


def verdicts(results):
    found = selection.findings(results, "zone")
    assert {finding.claim for finding in found} == {c.key for c in CLAIMS if c.key.startswith("selection.")}
    return {finding.claim.removeprefix("selection."): finding.verdict for finding in found}


def test_numbers_as_the_paper_has_them_make_its_claims_hold():
    theirs = [(50, 50, 4, 80, 5), (50.5, 50, 3, 70, 5), (50.2, 50, 2, 60, 5)]
    ours = [(57, 55.5, 4.1, 70, 0), (60, 56, 4, 40, 0), (65, 57, 4, 30, 0)]
    assert set(verdicts(results_of(ours, theirs)).values()) == {"holds"}


def test_numbers_against_the_paper_make_its_claims_fall():
    theirs = [(50, 50, 4, 30, 5), (40, 50, 4, 30, 5), (30, 50, 4, 30, 5)]
    ours = [(50, 50, 8, 80, 3), (42, 50, 3, 80, 3), (33, 50, 3, 80, 3)]
    assert set(verdicts(results_of(ours, theirs)).values()) == {"does not hold"}


def test_a_claim_that_holds_at_some_numbers_of_uavs_holds_in_part():
    theirs = [(50, 50, 4, 80, 5), (50, 50, 3, 70, 5), (50, 50, 2, 60, 5)]
    ours = [(55, 51, 4, 70, 0), (60, 56, 2, 40, 4), (65, 57, 4, 80, 4)]
    found = verdicts(results_of(ours, theirs))
    for claim in ("qou", "qov", "vehicles-per-uav", "fewer-uavs", "stable"):
        assert found[claim] == "holds in part"


def test_a_finding_about_no_claim_is_refused(tmp_path):
    with pytest.raises(KeyError):
        write_findings(tmp_path, [Finding("selection.magic", "", "", "holds")])
    assert not (tmp_path / "claims.json").exists()


def test_the_page_names_a_damaged_file(tmp_path):
    from skyrelay.core.errors import RunFolderError

    (tmp_path / "figure").mkdir()
    (tmp_path / "figure" / "claims.json").write_text(json.dumps([{"claim": "selection.qou"}]))
    with pytest.raises(RunFolderError, match=r"claims\.json"):
        write_claims_page(tmp_path)


@pytest.mark.parametrize(("name", "hint"), [("selektion", "selection"), ("selection-weight", "selection-weights")])
def test_an_unknown_figure_is_refused_with_a_suggestion(name, hint):
    with pytest.raises(UsageError, match=f"did you mean '{hint}'"):
        load_figure(name)


def test_an_unknown_scale_is_refused():
    with pytest.raises(UsageError, match="--scale: is 'huge'; expected one of smoke, fast, paper"):
        check_scale("huge")


def test_intervals_against_a_table_of_students_t():
    found = interval([1.0, 2.0, 3.0, 4.0, 5.0])
    # mean 3, s = sqrt(2.5), t(0.975, 4) = 2.776
    assert found.mean == 3.0
    assert found.high - found.mean == pytest.approx(2.776 * np.sqrt(2.5 / 5), rel=1e-3)
    assert interval([None, 2.0, float("nan")]).count == 1
    assert np.isnan(interval([2.0]).low)
    assert np.isnan(interval([]).mean)
