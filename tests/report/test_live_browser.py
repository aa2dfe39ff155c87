"""The live page in a real Chromium, over a real WebSocket: it follows, and comes back when its server does."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from skyrelay.report.live import ControlRoom
from skyrelay.report.replay import header, records
from skyrelay.runfolder import Run, read_run
from skyrelay.runfolder.feed import Feed

pytestmark = pytest.mark.browser

TOKEN = "a-token-of-this-test"  # noqa: S105


class Server:
    """A control room in a thread of its own; its feed goes on by `advance`, a step at a time."""

    def __init__(self, run: Run, port: int = 0, token: str | None = None) -> None:
        self._header, self._records = header(run), iter(list(records(run)))
        self._room = ControlRoom(token)
        self._loop = asyncio.new_event_loop()
        self._steps: asyncio.Queue[int] = asyncio.Queue()
        self._ended = asyncio.Event()
        self._ready = threading.Event()
        self.port = port
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._serve(),))
        self._thread.start()
        assert self._ready.wait(30)

    async def _serve(self) -> None:
        async with self._room.open("127.0.0.1", self.port) as server:
            self.port = server.sockets[0].getsockname()[1]
            following = asyncio.create_task(self._room.follow(self._feed()))
            self._ready.set()
            await self._ended.wait()
            following.cancel()

    async def _feed(self) -> Feed:
        yield self._header
        for record in self._records:
            await self._steps.get()
            yield record

    def advance(self, steps: int = 1) -> None:
        for _ in range(steps):
            self._loop.call_soon_threadsafe(self._steps.put_nowait, 1)

    def stop(self) -> None:
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(30)
        assert not self._thread.is_alive()


@pytest.fixture
def start(recorded: Path) -> Iterator[Callable[..., Server]]:
    """Starts servers; those that run at the end are stopped."""
    run = read_run(recorded)
    servers: list[Server] = []

    def one(**options: Any) -> Server:
        servers.append(Server(run, **options))
        return servers[-1]

    yield one
    for server in servers:
        if server._thread.is_alive():
            server.stop()


def wait(browser: webdriver.Chrome, condition: Callable[[webdriver.Chrome], object]) -> None:
    WebDriverWait(browser, 40, poll_frequency=0.05).until(condition)


def last(browser: webdriver.Chrome) -> int:
    return int(browser.execute_script("return skyrelay.run ? skyrelay.run.steps : -1"))


def test_the_page_follows_the_feed_and_comes_back(
    browser: webdriver.Chrome, recorded: Path, start: Callable[..., Server]
) -> None:
    run = read_run(recorded)
    server = start()
    server.advance(3)
    browser.get_log("browser")
    browser.get(f"http://127.0.0.1:{server.port}/")
    wait(browser, lambda d: last(d) == 2)
    assert browser.find_element(By.ID, "live").text == "live"
    assert browser.find_element(By.ID, "title").text == run.summary.name
    assert not browser.find_element(By.CSS_SELECTOR, ".segmented").is_displayed()  # nobody hovers beside it
    server.advance(9)
    wait(browser, lambda d: last(d) == 11)
    wait(browser, lambda d: d.find_element(By.ID, "clock").text.startswith("0:22"))
    here = run.vehicles["step"] == 11
    served, covered = (run.vehicles["uav"][here] != "").sum(), run.vehicles["covered"][here].sum()
    wait(browser, lambda d: f"{served} served, {covered} in range" in d.find_element(By.ID, "status").text)
    assert f"{covered} of {here.sum()}" in browser.find_element(By.ID, "tiles").text
    measured = browser.execute_script("return skyrelay.run.metric('connectivity', 0)[11]")
    assert measured == pytest.approx(run.metric("connectivity")[11], abs=1e-6)
    assert int(browser.find_element(By.ID, "event-count").text.split(",")[0]) > 0

    browser.execute_script("skyrelay.pick({ kind: 'uav', index: skyrelay.run.find('uav', 'uav_03') })")
    server.advance(6)
    wait(browser, lambda d: last(d) == 17)
    wait(browser, lambda d: d.find_element(By.ID, "member-name").text == "uav_03")
    wait(browser, lambda d: "uav_00 has landed" in d.find_element(By.ID, "alerts").text)

    server.stop()
    wait(browser, lambda d: d.find_element(By.ID, "live").get_attribute("data-state") == "away")
    assert last(browser) == 17  # what it knows stays
    again = start(port=server.port)
    again.advance(5)
    wait(browser, lambda d: last(d) == 4)  # another session: it starts afresh
    assert browser.find_element(By.ID, "live").text == "live"
    again.advance()
    wait(browser, lambda d: last(d) == 5)
    errors = [entry for entry in browser.get_log("browser") if "WebSocket connection" not in entry["message"]]
    assert errors == []


def test_paused_it_stays_where_it_is(browser: webdriver.Chrome, start: Callable[..., Server]) -> None:
    server = start()
    server.advance(6)
    browser.get("about:blank")
    browser.get(f"http://127.0.0.1:{server.port}/")
    wait(browser, lambda d: last(d) == 5)
    browser.find_element(By.ID, "play").click()
    browser.execute_script("skyrelay.seek(2)")
    server.advance(4)
    wait(browser, lambda d: last(d) == 9)
    assert browser.execute_script("return skyrelay.observe().at") == 2
    browser.find_element(By.ID, "play").click()
    wait(browser, lambda d: d.execute_script("return skyrelay.observe().at") == 9)


def test_a_token_comes_by_the_address_and_leaves_it(browser: webdriver.Chrome, start: Callable[..., Server]) -> None:
    server = start(token=TOKEN)
    server.advance(2)
    browser.get("about:blank")
    browser.get(f"http://127.0.0.1:{server.port}/#token=a-wrong-one-of-this-test")
    wait(browser, lambda d: d.find_element(By.ID, "live").get_attribute("data-state") == "ended")
    assert last(browser) == -1
    browser.get("about:blank")
    browser.get(f"http://127.0.0.1:{server.port}/#token={TOKEN}")
    wait(browser, lambda d: last(d) == 1)
    assert TOKEN not in browser.current_url
