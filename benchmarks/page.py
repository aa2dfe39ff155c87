"""The page with 10,000 vehicles at once in headless Chromium: frame times while it plays, zooms and pans.

Software GL (SwiftShader) by default, which is what a machine without a GPU has. A frame counts when the browser calls
back for it, so that time for drawing and putting together is in it. On a machine that others use, frames a second say
little; the processor time that Chromium's processes take for a frame of the page says what a frame costs.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import tempfile
from pathlib import Path

import numpy as np
from selenium import webdriver
from selenium.webdriver.support.ui import WebDriverWait

from skyrelay.report import write_report

SCRIPT = """
const [seconds, act, done] = arguments;
const { map, state, seek } = skyrelay;
const frames = [];
let first = 0, last = 0, script = skyrelay.script, painted = skyrelay.painted;
seek(0);
state.rate = 0.9 * skyrelay.run.steps / seconds; // so that it plays to the end
map.fit(skyrelay.run.area);
if (!state.playing) document.getElementById("play").click();
requestAnimationFrame(function frame(now) {
  if (last) frames.push(now - last); else first = now;
  last = now;
  const part = (now - first) / 1000 / seconds;
  if (part >= 1) {
    document.getElementById("play").click();
    const count = skyrelay.painted - painted;
    done({ frames, painted: count, script: (skyrelay.script - script) / count });
    return;
  }
  if (act === "zoom") map.look(map.view.target[0], map.view.target[1], map.least + 3 * Math.abs(Math.sin(3 * part)));
  if (act === "pan") map.panBy(4 * Math.cos(9 * part), 4 * Math.sin(9 * part));
  requestAnimationFrame(frame);
});
"""


def measure(vehicles: int, uavs: int, seconds: float) -> dict[str, dict[str, float]]:
    """By what is done to the page: frames a second, and frame times [ms]."""
    spec = importlib.util.spec_from_file_location("sample", Path(__file__).parents[1] / "tests/report/sample.py")
    assert spec is not None
    assert spec.loader is not None
    sample = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sample)
    with tempfile.TemporaryDirectory() as place:
        folder = sample.write_run_folder(Path(place) / "run", sample.street_tracks(vehicles, 30), uavs=uavs, side=6)
        page = write_report(folder)
        print(f"report.html: {page.stat().st_size / 1e6:.2f} MB")
        options = webdriver.ChromeOptions()
        options.binary_location = shutil.which("chromium") or "chromium"
        for argument in ("headless=new", "no-sandbox", "use-angle=swiftshader", "enable-unsafe-swiftshader"):
            options.add_argument(f"--{argument}")
        options.add_argument("--window-size=1440,1040")
        service = webdriver.ChromeService(executable_path=shutil.which("chromedriver"))
        driver = webdriver.Chrome(options=options, service=service)
        try:
            driver.set_script_timeout(seconds + 60)
            driver.get(page.as_uri())
            WebDriverWait(driver, 120).until(
                lambda d: d.execute_script("return document.body.dataset.ready === 'true'")
            )
            print("map:", driver.execute_script("return skyrelay.map.size.join(' x ')"), "pixels")
            told = {}
            for act in ("play", "zoom", "pan"):
                before = _processor_seconds(service.process.pid)
                found = driver.execute_async_script(SCRIPT, seconds, act)
                used = _processor_seconds(service.process.pid) - before
                frames = np.array(found["frames"])
                told[act] = {
                    "frames_per_second": round(1000 / frames.mean(), 1),
                    "median_ms": round(float(np.median(frames)), 1),
                    "p95_ms": round(float(np.percentile(frames, 95)), 1),
                    "longest_ms": round(float(frames.max()), 1),
                    "script_ms": round(found["script"], 1),
                    "processor_ms": round(1000 * used / found["painted"], 1),
                }
            return told
        finally:
            driver.quit()


def _processor_seconds(root: int) -> float:
    """User and system time of a process and all below it [s]."""
    parents: dict[int, tuple[int, float]] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended
        parents[int(path.parent.name)] = int(fields[1]), (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    total = 0.0
    for process in parents:
        above = process
        while above not in (root, 0) and above in parents:
            above = parents[above][0]
        total += parents[process][1] if above == root else 0.0
    return total


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=10_000)
    parser.add_argument("--uavs", type=int, default=400)
    parser.add_argument("--seconds", type=float, default=8.0)
    arguments = parser.parse_args()
    for act, values in measure(arguments.vehicles, arguments.uavs, arguments.seconds).items():
        print(f"{act:5} {json.dumps(values)}")


if __name__ == "__main__":
    main()
