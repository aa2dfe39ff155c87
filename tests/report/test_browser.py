"""The page in a real Chromium: it plays, scrubs and filters, loads nothing and complains of nothing."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.expected_conditions import url_contains
from selenium.webdriver.support.ui import Select, WebDriverWait

from skyrelay.airspace.observation import Scene, six_maps
from skyrelay.policy import Policy
from skyrelay.report import write_report

pytestmark = pytest.mark.browser

EVIL = "</script><script>document.title = 'broken'</script>"


@pytest.fixture(scope="module")
def page(sample: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    tracks = sample.street_tracks(60, 30)
    tracks[EVIL] = tracks.pop("vehicle_003")
    return write_report(sample.write_run_folder(tmp_path_factory.mktemp("page") / "run", tracks))


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
    """What the map shows once it has been drawn."""
    script = (
        "const done = arguments[0];"
        "requestAnimationFrame(() => requestAnimationFrame(() => {"
        "  done(document.getElementById('picture').toDataURL());"
        "}));"
    )
    return str(browser.execute_async_script(script))


def _changed(before: str, browser: webdriver.Chrome) -> bool:
    return picture(browser) != before


def at(browser: webdriver.Chrome) -> int:
    return int(str(browser.find_element(By.ID, "scrub").get_property("value")))


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
    still = picture(opened)
    paused = at(opened)
    assert paused >= 3
    assert still != before
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
    placed = cursor.rect["x"]
    scrub.send_keys(Keys.ARROW_RIGHT)
    wait(opened, lambda d: cursor.rect["x"] > placed)


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
    names = (
        "const { run, observe } = skyrelay; const { state } = observe().uavs;"
        "return run.uavs.filter((_, uav) => state[uav] & 1)"
    )
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
        wait(opened, partial(_changed, before))


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


def place_of(browser: webdriver.Chrome, vehicle: str) -> tuple[float, float]:
    """Where a vehicle is on the map, from its middle [pixels], by the page's own projection."""
    x, y = browser.execute_script(
        "const { run, map, observe } = skyrelay; const scene = observe();"
        "const row = scene.place[run.find('vehicle', arguments[0])];"
        "const [x, y] = map.project(scene.vehicles.x[row], scene.vehicles.y[row]), [width, height] = map.size;"
        "return [x - width / 2, y - height / 2];",
        vehicle,
    )
    return x, y


def move_to(browser: webdriver.Chrome, x: float, y: float) -> webdriver.ActionChains:
    stage = browser.find_element(By.ID, "stage-map")
    return webdriver.ActionChains(browser).move_to_element_with_offset(stage, round(x), round(y))


def boxes_overlap(browser: webdriver.Chrome, selector: str, x: float, y: float) -> bool:
    """Whether an element lies over a point of the map (from its middle)."""
    return bool(
        browser.execute_script(
            "const stage = document.getElementById('stage-map').getBoundingClientRect();"
            "const x = stage.left + stage.width / 2 + arguments[1], y = stage.top + stage.height / 2 + arguments[2];"
            "const box = document.querySelector(arguments[0]).getBoundingClientRect();"
            "return box.width > 0 && x >= box.left && x <= box.right && y >= box.top && y <= box.bottom;",
            selector, x, y,
        )
    )  # fmt: skip


def test_a_member_is_followed_by_a_click(opened: webdriver.Chrome) -> None:
    x, y = place_of(opened, "vehicle_006")
    move_to(opened, x, y).click().perform()
    wait(opened, lambda d: d.find_element(By.ID, "member").is_displayed())
    name = opened.find_element(By.ID, "member-name").text
    assert opened.find_element(By.ID, "event-member").get_property("value") == name
    facts = opened.find_element(By.ID, "member-facts").text
    assert re.search(r"asks for [1-4]\.\d\d Mbit/s: \d\.\d\d carried, \d\.\d\d delivered", facts), facts
    assert shown_events(opened) >= 1
    assert len(opened.find_elements(By.CSS_SELECTOR, "#member-history svg path")) == 2
    assert opened.find_elements(By.CSS_SELECTOR, "#member-selections li")
    assert not boxes_overlap(opened, "#member", x, y)
    press(opened, Keys.ESCAPE)
    wait(opened, lambda d: not d.find_element(By.ID, "member").is_displayed())


def test_the_card_never_covers_what_it_is_about(opened: webdriver.Chrome) -> None:
    names = opened.execute_script("return skyrelay.run.vehicles")
    shown = 0
    for name in names[:12]:
        if not opened.execute_script(
            "return skyrelay.observe().place[skyrelay.run.find('vehicle', arguments[0])] >= 0", name
        ):
            continue
        x, y = place_of(opened, name)
        move_to(opened, x, y).perform()
        wait(opened, lambda d: d.find_element(By.ID, "card").is_displayed())
        assert not boxes_overlap(opened, "#card", x, y)
        shown += 1
    assert shown > 5


def test_zooms_to_the_pointer_and_pans(opened: webdriver.Chrome) -> None:
    before = picture(opened)
    x, y = place_of(opened, "vehicle_006")
    scale = opened.execute_script("return skyrelay.map.scale")
    stage = opened.find_element(By.ID, "stage-map")
    origin = ScrollOrigin.from_element(stage, round(x), round(y))
    webdriver.ActionChains(opened).scroll_from_origin(origin, 0, -300).perform()
    wait(opened, lambda d: d.execute_script("return skyrelay.map.scale") > 1.2 * scale)
    now_x, now_y = place_of(opened, "vehicle_006")
    assert abs(now_x - x) < 4  # what was under the pointer stays there
    assert abs(now_y - y) < 4
    drag = move_to(opened, 0, 0).click_and_hold()
    for _ in range(8):
        drag.move_by_offset(10, 5)
    drag.release().perform()
    wait(opened, lambda d: place_of(d, "vehicle_006") == pytest.approx((now_x + 80, now_y + 40), abs=1))
    assert not opened.find_element(By.ID, "member").is_displayed()  # a pan is no click
    assert picture(opened) != before
    wait(opened, lambda d: "view=" in d.current_url)
    opened.find_element(By.ID, "zoom-fit").click()
    wait(opened, lambda d: d.execute_script("return skyrelay.map.scale") == pytest.approx(scale))


def test_two_fingers_and_a_double_click_zoom(opened: webdriver.Chrome) -> None:
    left, top, width, height, scale = opened.execute_script(
        "const box = document.getElementById('picture').getBoundingClientRect();"
        "return [box.left, box.top, box.width, box.height, skyrelay.map.scale];"
    )
    x, y = left + width / 2, top + height / 2
    for kind, apart in (("touchStart", 40), ("touchMove", 60), ("touchMove", 80)):
        points = [{"x": x - apart, "y": y, "id": 0}, {"x": x + apart, "y": y, "id": 1}]
        opened.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    opened.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    wait(opened, lambda d: d.execute_script("return skyrelay.map.scale") == pytest.approx(2 * scale))
    assert opened.find_element(By.ID, "zone").get_property("value") == "0"  # a pinch is no click
    opened.find_element(By.ID, "zoom-fit").click()
    wait(opened, lambda d: d.execute_script("return skyrelay.map.scale") == pytest.approx(scale))
    Select(opened.find_element(By.ID, "zone")).select_by_value("4")  # a click within a zone goes nowhere else
    scale = opened.execute_script("return skyrelay.map.scale")
    move_to(opened, 3, 3).double_click().perform()
    wait(opened, lambda d: d.execute_script("return skyrelay.map.scale") == pytest.approx(2 * scale))


def test_the_map_is_moved_and_members_are_reached_by_keys(opened: webdriver.Chrome) -> None:
    press(opened, "n")
    wait(opened, lambda d: d.find_element(By.ID, "member").is_displayed())
    first = opened.find_element(By.ID, "member-name").text
    press(opened, "n")
    wait(opened, lambda d: d.find_element(By.ID, "member-name").text != first)
    assert opened.find_element(By.ID, "say").get_attribute("textContent").endswith("picked")
    press(opened, "N")
    wait(opened, lambda d: d.find_element(By.ID, "member-name").text == first)
    target, scale = opened.execute_script("return [skyrelay.map.view.target, skyrelay.map.scale]")
    opened.execute_script("document.getElementById('stage-map').focus()")
    press(opened, "+", Keys.ARROW_RIGHT)
    moved, larger = opened.execute_script("return [skyrelay.map.view.target, skyrelay.map.scale]")
    assert larger > scale
    assert moved[0] > target[0]
    assert at(opened) == 0  # on the map, arrows pan


def test_every_control_is_reached_by_tab_and_has_a_name(opened: webdriver.Chrome) -> None:
    reached = set()
    for _ in range(40):
        press(opened, Keys.TAB)
        reached.add(opened.execute_script("return document.activeElement.id || document.activeElement.name"))
    wanted = {"theme", "zone", "find", "stage-map", "zoom-in", "play", "scrub", "speed", "event-name", "event-member"}
    assert wanted <= reached
    nameless = opened.execute_script(
        "return [...document.querySelectorAll('button, input, select')].filter((one) => one.checkVisibility() &&"
        "  !one.getAttribute('aria-label') && !one.textContent.trim() && !one.closest('label')).length"
    )
    assert nameless == 0


def test_a_member_is_found_by_its_name(opened: webdriver.Chrome) -> None:
    opened.find_element(By.ID, "find").send_keys("uav_03", Keys.ENTER)
    wait(opened, lambda d: d.find_element(By.ID, "member-name").text == "uav_03")
    assert len(opened.find_elements(By.CSS_SELECTOR, "#member-maps canvas")) == 6


def test_an_event_leads_to_its_step_and_member(opened: webdriver.Chrome) -> None:
    press(opened, Keys.END)
    wait(opened, lambda d: at(d) == 30)
    kinds = Select(opened.find_element(By.ID, "event-name"))
    kinds.select_by_value("UAVAllocated")
    names = "return [...document.querySelectorAll('#events b')].every((one) => one.textContent === 'UAVAllocated')"
    wait(opened, lambda d: d.execute_script(names))
    row = opened.find_element(By.CSS_SELECTOR, "#events li:last-child button")
    name = row.find_element(By.XPATH, ".//i[text()='uav ']/..").text.removeprefix("uav ")
    opened.execute_script("arguments[0].click()", row)
    wait(opened, lambda d: at(d) == 0)
    assert opened.find_element(By.ID, "member-name").text == name


def test_alerts_tell_what_happened_and_lead_there(opened: webdriver.Chrome) -> None:
    assert opened.find_element(By.ID, "alert-count").text == "0"
    press(opened, Keys.END)
    wait(opened, lambda d: d.find_element(By.ID, "alert-count").text != "0")
    row = opened.find_element(By.XPATH, "//*[@id='alerts']//button[contains(., 'uav_00 has landed')]")
    row.click()
    wait(opened, lambda d: at(d) == 15)
    assert opened.find_element(By.ID, "member-name").text == "uav_00"


def test_the_six_maps_are_those_that_the_uavs_policy_looks_at(opened: webdriver.Chrome) -> None:
    seen = opened.execute_script(
        "skyrelay.seek(7); const scene = skyrelay.observe(), { run } = skyrelay, told = [];"
        "for (const [zone, team] of scene.teams) for (const uav of team)"
        "  told.push({ uav, team, area: run.zoneArea(zone), maps:"
        "    skyrelay.sixMaps(run, scene, uav).map((map) => [...map]) });"
        "return { told, reach: run.range, uavs: [...scene.uavs.x].map((x, u) => [x, scene.uavs.y[u]]),"
        "  vehicles: Array.from({ length: scene.count }, (_, k) =>"
        "    [scene.vehicles.x[k], scene.vehicles.y[k], scene.vehicles.uav[k]]) };"
    )
    vehicles = np.array(seen["vehicles"])
    compared = 0
    for told in seen["told"]:
        x0, y0, x1, _ = told["area"]
        mates = [told["uav"], *(uav for uav in told["team"] if uav != told["uav"])]
        owner = np.where(vehicles[:, 2] == told["uav"], 0, -1)
        where = Scene.in_metres(np.array(seen["uavs"])[mates], vehicles[:, :2], owner, (x0, y0), x1 - x0, seen["reach"])
        np.testing.assert_array_equal(np.reshape(told["maps"], (6, 11, 11)), six_maps(where, 11, 3, 1)[0])
        compared += int((owner == 0).any())
    assert compared > 3
    card = Policy.named("generalist").card
    assert (card.n, card.zoom) == (11, 3)
    opened.execute_script(f"skyrelay.pick({{ kind: 'uav', index: {seen['told'][0]['uav']} }})")
    wait(opened, lambda d: len(d.find_elements(By.CSS_SELECTOR, "#member-maps canvas")) == 6)
    painted = (
        "return [...document.querySelectorAll('#member-maps canvas')].every((canvas) =>"
        " canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some((value) => value > 0))"
    )
    wait(opened, lambda d: d.execute_script(painted))


def test_figures_are_in_a_readers_units(opened: webdriver.Chrome) -> None:
    units = (
        "return [['x', '32306'], ['uavX', '-19797'], ['battery', '2545'], ['demand', '2260'],"
        " ['qov', '53491864190053480'], ['score', '112520982006525992'], ['zone', '3'], ['x', 'north']]"
        ".map((pair) => skyrelay.inUnits(...pair))"
    )
    assert opened.execute_script(units) == [
        "3,230.6 m",
        "-1,979.7 m",
        "25.45 %",
        "2.26 Mbit/s",
        "53.5",
        "1.125",
        "3",
        "north",
    ]


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (1024, 768), (390, 844)])
def test_nothing_lies_on_anything_else(opened: webdriver.Chrome, width: int, height: int) -> None:
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        wait(opened, lambda d: d.execute_script("return innerWidth") == width)
        opened.execute_script("skyrelay.pick({ kind: 'uav', index: 3 })")
        wait(opened, lambda d: d.find_element(By.ID, "member").is_displayed())
        opened.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
        # Titles, values and axes of the charts; panels; the controls above the map.
        overlaps = opened.execute_script(
            "const found = [];"
            "const check = (elements) => {"
            "  const boxes = elements.map((one) => [one, one.getBoundingClientRect()]).filter(([, box]) => box.width);"
            "  boxes.forEach(([a, p], i) => boxes.slice(i + 1).forEach(([b, q]) => {"
            "    if (a.contains(b) || b.contains(a)) return;"
            "    if (p.left < q.right - 1 && q.left < p.right - 1 && p.top < q.bottom - 1 && q.top < p.bottom - 1)"
            "      found.push([a.textContent.slice(0, 40), b.textContent.slice(0, 40)]);"
            "  }));"
            "};"
            "check([...document.querySelectorAll('#charts h2, #charts .values, #charts text')]);"
            "check([...document.querySelectorAll('header.top, .stage, .charts, .panel, footer')]);"
            "check([...document.querySelectorAll('.stage > .bar > *, .map, .transport > *, .status, .legend')]);"
            "return found;"
        )
        assert overlaps == []
        assert opened.execute_script("return document.documentElement.scrollWidth <= innerWidth")
    finally:
        opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


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
    assert opened.find_element(By.CSS_SELECTOR, "#charts h2").text == "In range, of all connected, zone 4"
    assert opened.execute_script("return document.documentElement.dataset.theme") == "dark"


def test_the_address_keeps_what_was_chosen(opened: webdriver.Chrome, page: Path) -> None:
    press(opened, *[Keys.ARROW_RIGHT] * 5, "m")
    opened.execute_script("document.getElementById('show-labels').click()")
    opened.find_element(By.ID, "find").send_keys("uav_03", Keys.ENTER)
    Select(opened.find_element(By.ID, "event-name")).select_by_value("UAVAllocated")
    for part in ("step=5", "mode=static", "layers=labels", "pick=uav%3Auav_03", "kind=UAVAllocated"):
        wait(opened, url_contains(part))
    link = opened.current_url
    opened.get("about:blank")
    opened.get(link)
    wait(opened, lambda d: d.execute_script("return document.body.dataset.ready === 'true'"))
    assert at(opened) == 5
    assert opened.find_element(By.CSS_SELECTOR, "input[value=static]").is_selected()
    assert opened.find_element(By.ID, "show-labels").is_selected()
    assert opened.find_element(By.ID, "member-name").text == "uav_03"
    assert opened.find_element(By.ID, "event-name").get_property("value") == "UAVAllocated"


def test_narrow_screen_has_no_sideways_scroll(opened: webdriver.Chrome) -> None:
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        wait(opened, lambda d: d.execute_script("return innerWidth === 390 && skyrelay.map.size[0] < 390"))
        assert opened.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        press(opened, Keys.ARROW_RIGHT)
        wait(opened, lambda d: at(d) == 1)
    finally:
        opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
