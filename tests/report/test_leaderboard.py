"""The leaderboard page: what it says, that nothing in the standings breaks out of it, and Chromium's view of it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By

from skyrelay.core.errors import RunFolderError
from skyrelay.report.leaderboard import render, write_leaderboard

EVIL = "</script><script>document.title='broken'</script>{{style}}"


def value(mean: float) -> dict[str, float]:
    return {"mean": mean, "low": mean - 0.01, "high": mean + 0.01}


def method(name: str, scores: dict[str, float], *, complete: bool = True, **more: Any) -> dict[str, Any]:
    tasks = {
        task: {"score": value(score), "return": value(-score), "carried": value(score), "within": name != "mine"}
        for task, score in scores.items()
    }
    told = {"name": name, "kind": "policy", "trainings": 3, "runs": 3, "complete": complete, "tasks": tasks, **more}
    if complete:
        mean = float(np.mean(list(scores.values())))
        line = [float(mean > at) for at in (0.0, 0.5, 1.0)]
        told |= {"iqm": value(mean), "mean": value(mean), "optimality_gap": value(1 - mean)}
        told |= {"profile": {"share": line, "low": line, "high": line}}
    return told


@pytest.fixture
def told() -> dict[str, Any]:
    task: dict[str, Any] = {"games": "paper", "trace": None, "radio": None, "gateway": False, "uavs": 2, "vehicles": 5}
    task |= {"measure": "return", "hovering": -61.5, "best": -1.25, "best_by": "cover"}
    tasks = [task | {"name": "first"}, task | {"name": "second", "measure": "carried", "radio": "air-to-ground"}]
    return {
        "suite": "some-v1",
        "title": EVIL,
        "runs": 3,
        "episodes": 20,
        "reference": "cover",
        "thresholds": [0.0, 0.5, 1.0],
        "tasks": tasks,
        "methods": [
            method("mine", {"first": 1.01, "second": 0.7}, improvement=value(0.75), ahead=value(0.02)),
            method("cover", {"first": 0.9, "second": 0.75}),
            method(EVIL, {"first": 0.5}, complete=False),
        ],
    }


def test_the_page_says_what_the_standings_say(told: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "standings.json").write_text(json.dumps(told))
    page = write_leaderboard(tmp_path).read_text()
    assert page == render(told)
    for text in (
        "0.855",
        "0.845 to 0.865",
        "0.75",
        "+0.020",
        "−61.50",
        "1 of 3 did not play every task",
        "3 trainings",
    ):
        assert text in page
    assert page.count("<script>") == 1
    assert page.count("{{style}}") == 2  # the title's and the method's: nothing was filled in there
    bold = re.findall(r'<td class="best( outside)?" data-value="([\d.]+)"', page)
    assert [float(number) for _, number in bold] == [1.01, 0.75]
    assert bold[0][0] == " outside"
    assert "://" not in page


def test_nothing_is_drawn_of_a_suite_that_nobody_played_whole(told: dict[str, Any]) -> None:
    page = render(told | {"methods": told["methods"][2:], "reference": None})
    assert "1 of 1 did not play every task" in page


@pytest.mark.parametrize("text", [None, "{", "[]", '{"suite": "x"}', '{"methods": 3}'])
def test_other_files_are_refused(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / "standings.json").write_text(text)
    with pytest.raises(RunFolderError, match=r"standings\.json"):
        write_leaderboard(tmp_path)


def test_a_figure_that_is_none_is_refused(told: dict[str, Any], tmp_path: Path) -> None:
    told["methods"][0]["iqm"]["mean"] = float("inf")
    (tmp_path / "standings.json").write_text(json.dumps(told))
    with pytest.raises(RunFolderError, match="inf"):
        write_leaderboard(tmp_path)


@pytest.mark.browser
def test_a_column_sorts_and_nothing_is_wider_than_a_phone(
    browser: webdriver.Chrome, told: dict[str, Any], tmp_path: Path
) -> None:
    (tmp_path / "standings.json").write_text(json.dumps(told))
    browser.get("about:blank")
    browser.get_log("browser")
    browser.get(write_leaderboard(tmp_path).as_uri())
    assert browser.title == "SkyRelay · some-v1 · leaderboard"
    table = browser.find_elements(By.CSS_SELECTOR, "table.sorted")[1]

    def names() -> list[str]:
        return [one.text.split(" ")[0] for one in table.find_elements(By.CSS_SELECTOR, "tbody th")]

    assert names()[:2] == ["mine", "cover"]
    table.find_elements(By.CSS_SELECTOR, "thead button")[1].click()
    assert names()[:2] == ["cover", "mine"]
    theme = browser.execute_script("return document.documentElement.dataset.theme")
    browser.find_element(By.ID, "theme").click()
    assert browser.execute_script("return document.documentElement.dataset.theme") != theme
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 390, "height": 800, "deviceScaleFactor": 2, "mobile": True}
    )
    assert browser.execute_script("return document.documentElement.scrollWidth") == 390
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert browser.get_log("browser") == []
