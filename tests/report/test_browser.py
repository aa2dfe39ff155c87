"""The page in a real Chromium: it plays, scrubs and filters, loads nothing and complains of nothing."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select, WebDriverWait

from skyrelay.report import write_report

pytestmark = pytest.mark.browser

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
EVIL = "</script><script>document.title = 'broken'</script>"


@pytest.fixture(scope="module")
def page(sample: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    tracks = sample.street_tracks(60, 30)
    tracks[EVIL] = tracks.pop("vehicle_003")
    return write_report(sample.write_run_folder(tmp_path_factory.mktemp("page") / "run", tracks))


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    if CHROMIUM is None or DRIVER is None:
        pytest.skip("needs chromium and chromedriver (Debian: chromium, chromium-driver)")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in (
        "headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", "disable-quic", "no-first-run",
        "disable-background-networking", "disable-component-update", "disable-sync", "window-size=1440,900",
        f"user-data-dir={tmp_path_factory.mktemp('profile')}",
    ):  # fmt: skip
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=DRIVER))
    yield driver
    driver.quit()


@pytest.fixture
def opened(browser: webdriver.Chrome, page: Path) -> Iterator[webdriver.Chrome]:
    """The page, freshly opened; afterwards, nothing was logged and nothing but the page was asked for."""
    browser.get("about:blank")
    browser.get_log("performance")
    browser.get_log("browser")
    browser.get(page.as_uri())
    WebDriverWait(browser, 30).until(lambda d: d.execute_script("return document.body.dataset.ready === 'true'"))
    yield browser
    assert browser.get_log("browser") == []
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = {m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"}
    assert {url.partition("#")[0] for url in asked if not url.startswith(("data:", "about:"))} == {page.as_uri()}


def picture(browser: webdriver.Chrome) -> str:
    return str(browser.execute_script("return document.getElementById('map').toDataURL()"))


def at(browser: webdriver.Chrome) -> int:
    return int(browser.find_element(By.ID, "scrub").get_property("value"))


def wait(browser: webdriver.Chrome, condition: Callable[[webdriver.Chrome], object]) -> None:
    WebDriverWait(browser, 30, poll_frequency=0.05).until(condition)


def press(browser: webdriver.Chrome, *keys: str) -> None:
    webdriver.ActionChains(browser).send_keys(*keys).perform()


def shown_events(browser: webdriver.Chrome) -> int:
    text = browser.find_element(By.ID, "event-count").text
    return int(text.split(", newest")[0].replace(",", ""))


def test_plays_and_pauses(opened: webdriver.Chrome) -> None:
    before = picture(opened)
    button = opened.find_element(By.ID, "play")
    button.click()
    assert button.get_attribute("aria-label") == "Pause"
    wait(opened, lambda d: at(d) >= 3)
    press(opened, " ")  # the button has the focus: the key must not count twice
    assert button.get_attribute("aria-label") == "Play"
    paused = at(opened)
    assert paused >= 3
    assert picture(opened) != before
    still = picture(opened)
    opened.execute_async_script("setTimeout(arguments[0], 300)")
    assert (at(opened), picture(opened)) == (paused, still)


def test_plays_to_its_end_and_starts_again(opened: webdriver.Chrome) -> None:
    Select(opened.find_element(By.ID, "speed")).select_by_index(4)
    opened.find_element(By.TAG_NAME, "h1").click()
    press(opened, Keys.END, Keys.ARROW_LEFT, " ")
    wait(opened, lambda d: at(d) == 30 and d.find_element(By.ID, "play").get_attribute("aria-label") == "Play")
    press(opened, " ")
    wait(opened, lambda d: 0 < at(d) < 30)


def test_scrubs(opened: webdriver.Chrome) -> None:
    before, events = picture(opened), shown_events(opened)
    scrub = opened.find_element(By.ID, "scrub")
    scrub.click()  # in its middle
    wait(opened, lambda d: 13 <= at(d) <= 17)
    wait(opened, lambda d: picture(d) != before)
    assert shown_events(opened) > events
    seconds = 2 * at(opened)
    wait(opened, lambda d: d.find_element(By.ID, "clock").text.startswith(f"0:{seconds:02d} "))
    cursor = opened.find_element(By.CSS_SELECTOR, "#charts .cursor")
    placed = float(cursor.get_attribute("x1") or 0)
    scrub.send_keys(Keys.ARROW_RIGHT)
    wait(opened, lambda d: float(cursor.get_attribute("x1") or 0) > placed)


def test_keys(opened: webdriver.Chrome) -> None:
    press(opened, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    wait(opened, lambda d: at(d) == 2)
    webdriver.ActionChains(opened).key_down(Keys.SHIFT).send_keys(Keys.ARROW_RIGHT).key_up(Keys.SHIFT).perform()
    wait(opened, lambda d: at(d) == 12)
    press(opened, Keys.HOME)
    wait(opened, lambda d: at(d) == 0)
    press(opened, "m")
    assert opened.find_element(By.CSS_SELECTOR, "input[value=static]").is_selected()


def test_status_agrees_with_the_recorded_metrics(opened: webdriver.Chrome, page: Path) -> None:
    import pyarrow.parquet as pq

    rows = {(row["step"], row["zone"]): row for row in pq.read_table(page.with_name("metrics.parquet")).to_pylist()}
    for _ in range(8):
        press(opened, Keys.ARROW_RIGHT)
    wait(opened, lambda d: at(d) == 8)
    whole = rows[8, 0]
    status = opened.find_element(By.ID, "status").text
    assert f"{whole['vehicles']} served, {whole['covered']} in range" in status
    press(opened, "m")
    vehicles = pq.read_table(page.with_name("vehicles.parquet")).to_pylist()
    hovering = [row for row in vehicles if row["step"] == 8 and row["static_uav"]]
    inside = round(whole["static_coverage"] * len(hovering))
    wait(opened, lambda d: f"{len(hovering)} served, {inside} in range" in d.find_element(By.ID, "status").text)


def test_a_uav_that_has_landed_is_gone_from_the_map(opened: webdriver.Chrome) -> None:
    names = "return observe().uavs.filter(Boolean).map((uav) => run.uavs[uav.index])"
    press(opened, *[Keys.ARROW_RIGHT] * 14)
    wait(opened, lambda d: at(d) == 14)
    assert "uav_00" in opened.execute_script(names)
    press(opened, Keys.ARROW_RIGHT)
    wait(opened, lambda d: at(d) == 15)
    assert "uav_00" not in opened.execute_script(names)
    press(opened, "m")  # the comparator's has not
    assert "uav_00" in opened.execute_script(names)


def test_modes_zones_layers_and_themes_change_the_map(opened: webdriver.Chrome) -> None:
    press(opened, *[Keys.ARROW_RIGHT] * 9)
    wait(opened, lambda d: at(d) == 9)
    for change in (
        lambda: press(opened, "m"),
        lambda: Select(opened.find_element(By.ID, "zone")).select_by_value("4"),
        lambda: opened.execute_script("document.getElementById('show-discs').click()"),
        lambda: opened.execute_script("document.getElementById('show-labels').click()"),
        lambda: opened.find_element(By.ID, "theme").click(),
        lambda: press(opened, Keys.ESCAPE),
    ):
        before = picture(opened)
        change()
        wait(opened, lambda d, before=before: picture(d) != before)


def test_events_are_filtered_by_kind_and_member(opened: webdriver.Chrome) -> None:
    kinds = Select(opened.find_element(By.ID, "event-name"))
    kind = next(option.text for option in kinds.options if option.text.startswith("VehSelectionSubmitted"))
    kinds.select_by_visible_text(kind)
    opened.find_element(By.ID, "event-member").send_keys("vehicle_006")
    wait(opened, lambda d: shown_events(d) == 1)
    row = opened.find_element(By.CSS_SELECTOR, "#events li").text
    assert "VehSelectionSubmitted" in row
    assert "vehicle_006" in row
    opened.find_element(By.ID, "scrub").send_keys(Keys.END)
    wait(opened, lambda d: shown_events(d) == 3)


def test_a_member_is_followed_by_a_click(opened: webdriver.Chrome) -> None:
    # Where a vehicle is on the canvas, by the page's own projection.
    x, y = opened.execute_script(
        "const v = observe().vehicles.find((v) => run.vehicles[v.index] === 'vehicle_006');"
        "const b = map.canvas.getBoundingClientRect();"
        "return [sx(v.x) - b.width / 2, sy(v.y) - b.height / 2];"
    )
    canvas = opened.find_element(By.ID, "map")
    webdriver.ActionChains(opened).move_to_element_with_offset(canvas, round(x), round(y)).click().perform()
    wait(opened, lambda d: d.find_element(By.ID, "card").is_displayed())
    name = opened.find_element(By.CSS_SELECTOR, "#card b").text
    assert opened.find_element(By.ID, "event-member").get_property("value") == name
    assert shown_events(opened) >= 1


def test_an_id_with_markup_is_text(opened: webdriver.Chrome) -> None:
    opened.find_element(By.ID, "event-member").send_keys("</script>")
    wait(opened, lambda d: shown_events(d) >= 1)
    assert EVIL in opened.find_element(By.ID, "events").text
    assert opened.title == "SkyRelay · bologna · seed 1"


def test_a_link_opens_at_its_step_zone_and_mode(opened: webdriver.Chrome, page: Path) -> None:
    opened.get("about:blank")
    opened.get(page.as_uri() + "#step=8&zone=4&mode=static&theme=dark")
    wait(opened, lambda d: d.execute_script("return document.body.dataset.ready === 'true'"))
    assert at(opened) == 8
    assert opened.find_element(By.ID, "zone").get_property("value") == "4"
    assert opened.find_element(By.CSS_SELECTOR, "input[value=static]").is_selected()
    assert opened.find_element(By.CSS_SELECTOR, "#charts h2").text == "Coverage, zone 4"
    assert opened.execute_script("return document.documentElement.dataset.theme") == "dark"


def test_narrow_screen_has_no_sideways_scroll(opened: webdriver.Chrome) -> None:
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        wait(opened, lambda d: d.execute_script("return innerWidth === 390 && map.canvas.clientWidth < 390"))
        assert opened.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        press(opened, Keys.ARROW_RIGHT)
        wait(opened, lambda d: at(d) == 1)
    finally:
        opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
