"""The leaderboard page of a suite that was played: one self-contained HTML file from its ``standings.json``."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from skyrelay.core.errors import RunFolderError
from skyrelay.core.files import write_text
from skyrelay.core.untrusted import read_json
from skyrelay.report.template import filled

STANDINGS, PAGE = "standings.json", "leaderboard.html"
COLOURS, DASHES = 8, 3
WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 620, 330, 40, 34, 10
STRETCH = 3.0
"""A score's place on the profile's axis is this power of it: what matters is near 1."""
TICKS = (0.0, 0.5, 0.7, 0.8, 0.9, 1.0, 1.1)
MISSING = "–"

Told = Mapping[str, Any]


def write_leaderboard(folder: Path) -> Path:
    """Write ``leaderboard.html`` into the folder of a suite. The same standings give the same bytes.

    Returns: the page's path; it opens from disk, and its security policy lets it load nothing else.
    Raises:
        RunFolderError: there are no standings, or they cannot be read.
    """
    path = folder / STANDINGS
    try:
        text = render(read_json(path))
    except (OSError, ValueError) as error:
        raise RunFolderError(path, None, f"readable standings of a suite ({error})") from error
    except (KeyError, IndexError, TypeError, AttributeError, ZeroDivisionError) as error:
        raise RunFolderError(path, None, f"the standings of a suite ({type(error).__name__}: {error})") from error
    write_text(folder / PAGE, text)
    return folder / PAGE


def render(told: Told) -> str:
    """The page's text from what `skyrelay.experiments.suite.standings` returns."""
    complete = [method for method in told["methods"] if method["complete"]]
    others = len(told["methods"]) - len(complete)
    runs, episodes = int(told["runs"]), int(told["episodes"])
    sentence = (
        f"{told['title']}: {_plural(len(told['tasks']), 'task')}, {_plural(len(told['methods']), 'method')}. Run k of "
        f"{runs} plays the same {_plural(episodes, 'unseen episode')} of seed k for everybody."
    )
    ranking_note = (
        "IQM: mean of the middle half of all runs and tasks. Intervals are 95 %, the runs of each task drawn anew. "
        "A rule, and a policy that was trained once, has runs that differ in their episodes only; one of several "
        "trainings flies another one in each run."
    )
    if told["reference"]:
        ranking_note += (
            f" Beats {told['reference']}: how likely one of its runs is better than one of {told['reference']} in a "
            "task (probability of improvement). Ahead: by how much on average, in the same episodes."
        )
    if others:
        ranking_note += f" {others} of {len(told['methods'])} did not play every task and have no figure here."
    values = {
        "title": f"SkyRelay · {told['suite']} · leaderboard",
        "name": str(told["suite"]),
        "sentence": sentence,
        "ranking_note": ranking_note,
        "tasks_note": "Scores, and below what was measured: the return, or the percentage of the traffic asked for "
        "that is carried or delivered. Bold: the best of a task. °: outside of what the policy was trained for.",
        "footer": "Agarwal et al., Deep reinforcement learning at the edge of the statistical precipice, NeurIPS 2021. "
        "The folder of this page has every episode (results.parquet), these figures (standings.json) and the format of "
        "marl-eval.",
    }
    escaped = {name: html.escape(text) for name, text in values.items()}
    shown = {
        "ranking": _ranking(complete, told["reference"]),
        "profile": _profile(complete, told["thresholds"]),
        "tasks": _tasks(told["methods"], told["tasks"]),
        "scale": _scale(told["tasks"]),
    }
    return filled("leaderboard.html", ["colours.css", "leaderboard.css"], "leaderboard.js", escaped | shown)


def _ranking(methods: Sequence[Told], reference: str | None) -> str:
    low = min((float(method["iqm"]["low"]) for method in methods), default=0.0)
    # Who is far behind is drawn at the edge: the others would be one dot.
    low = max(low, min(0.8, *(float(method["iqm"]["low"]) for method in methods[:3]))) if methods else low
    high = max((float(method["iqm"]["high"]) for method in methods), default=1.0)
    span = max(high - low, 1e-6)
    low, high = low - 0.05 * span, high + 0.05 * span
    head = (
        '<th class="text">Method</th>'
        + _head("IQM", sort="descending")
        + '<th class="text span">Interval</th>'
        + _head("Mean", "less")
        + (_head(f"Beats {reference}") + _head(f"Ahead of {reference}", "less") if reference else "")
    )
    rows = []
    for method in methods:
        cells = _named(method) + _cell(method["iqm"], 3, bounds=True)
        cells += f'<td class="span">{_bar(method["iqm"], low, high)}</td>'
        cells += _cell(method["mean"], 3, "less", bounds=True)
        if reference:
            cells += _cell(method.get("improvement"), 2, bounds=True)
            cells += _cell(method.get("ahead"), 3, "less", bounds=True, signed=True)
        rows.append(f'<tr class="{html.escape(method["kind"])}-row">{cells}</tr>')
    return f'<table class="sorted"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'


def _head(text: str, kind: str = "", sort: str = "") -> str:
    order = f' aria-sort="{sort}"' if sort else ""
    return f'<th class="{kind}"{order}><button type="button">{html.escape(text)}</button></th>'


def _named(method: Told) -> str:
    kind, trainings = str(method["kind"]), int(method["trainings"])
    note = f"{trainings} trainings" if trainings > 1 else kind
    return (
        f'<th scope="row"><span class="{html.escape(kind)}">{html.escape(method["name"])}</span>'
        f' <span class="kind">{html.escape(note)}</span></th>'
    )


def _cell(
    value: Told | None, digits: int, kind: str = "", *, bounds: bool = False, signed: bool = False, extra: str = ""
) -> str:
    """A table's cell: the mean, with its bounds below where they are asked for."""
    if value is None:
        return f'<td class="{kind}">{MISSING}</td>'
    mean, low, high = (float(value[name]) for name in ("mean", "low", "high"))
    sign = "+" if signed else ""
    text = _number(mean, digits, sign)
    below = f"<small>{_number(low, digits, sign)} to {_number(high, digits, sign)}</small>" if bounds else extra
    return f'<td class="{kind}" data-value="{mean:.9g}">{text}{below}</td>'


def _number(value: float, digits: int, sign: str = "") -> str:
    if not math.isfinite(value):
        raise ValueError(f"{value} is no figure")
    return f"{value:{sign}z.{digits}f}".replace("-", "−")


def _bar(value: Told, low: float, high: float) -> str:
    """An interval on a line from ``low`` to ``high``, the score 1 marked."""

    def place(score: float) -> float:
        return 100.0 * min(max((score - low) / (high - low), 0.0), 1.0)

    mean, left, right = (place(float(value[name])) for name in ("mean", "low", "high"))
    one = f'<line class="at" x1="{place(1.0):.2f}" x2="{place(1.0):.2f}" y1="1" y2="17"/>' if low < 1.0 < high else ""
    return (
        f'<svg viewBox="0 0 100 18" preserveAspectRatio="none" aria-hidden="true">{one}'
        f'<line x1="{left:.2f}" x2="{right:.2f}" y1="9" y2="9" vector-effect="non-scaling-stroke"/>'
        f'<line class="mean" x1="{mean:.2f}" x2="{mean:.2f}" y1="3" y2="15" vector-effect="non-scaling-stroke"/></svg>'
    )


def _profile(methods: Sequence[Told], thresholds: Sequence[float]) -> str:
    """Lines with their bands, as SVG, and a legend."""
    right, bottom = WIDTH - 8, HEIGHT - BOTTOM
    largest = float(max(thresholds))

    def x(score: float) -> float:
        return float(LEFT + (right - LEFT) * (score / largest) ** STRETCH)

    def y(share: float) -> float:
        return bottom - (bottom - TOP) * share

    parts, legend = [], []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        parts.append(f'<line class="axis" x1="{LEFT}" x2="{right}" y1="{y(share):.1f}" y2="{y(share):.1f}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y(share) + 4:.1f}" text-anchor="end">{share:g}</text>')
    for tick in TICKS:
        if tick <= largest:
            parts.append(f'<line class="axis" x1="{x(tick):.1f}" x2="{x(tick):.1f}" y1="{TOP}" y2="{bottom}"/>')
            parts.append(f'<text x="{x(tick):.1f}" y="{bottom + 15}" text-anchor="middle">{tick:g}</text>')
    parts.append(f'<text x="{(LEFT + right) / 2:.0f}" y="{HEIGHT - 3}" text-anchor="middle">score</text>')
    for number, method in enumerate(methods):
        colour, dash = number % COLOURS, number // COLOURS % DASHES
        lines = {
            name: [
                f"{x(float(at)):.1f},{y(float(share)):.1f}"
                for at, share in zip(thresholds, method["profile"][name], strict=True)
            ]
            for name in ("share", "low", "high")
        }
        band = " ".join(lines["high"] + lines["low"][::-1])
        parts.append(f'<polygon class="band f{colour}" points="{band}"/>')
        parts.append(f'<polyline class="line s{colour} d{dash}" points="{" ".join(lines["share"])}"/>')
        mark = f'<svg viewBox="0 0 22 8"><line class="s{colour} d{dash}" x1="0" x2="22" y1="4" y2="4"/></svg>'
        legend.append(f"<li>{mark}{html.escape(method['name'])}</li>")
    label = "Performance profiles of all methods"
    return (
        f'<svg class="plot" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
        f'<ul class="legend">{"".join(legend)}</ul>'
    )


def _tasks(methods: Sequence[Told], tasks: Sequence[Told]) -> str:
    """A row for each method, a column for each task."""
    best = {
        task["name"]: max(
            (
                float(method["tasks"][task["name"]]["score"]["mean"])
                for method in methods
                if task["name"] in method["tasks"]
            ),
            default=math.inf,
        )
        for task in tasks
    }
    head = '<th class="text">Method</th>' + "".join(_head(task["name"]) for task in tasks)
    rows = []
    for method in methods:
        cells = _named(method)
        for task in tasks:
            found = method["tasks"].get(task["name"])
            if found is None:
                cells += f"<td>{MISSING}</td>"
                continue
            kind = "best" if float(found["score"]["mean"]) == best[task["name"]] else ""
            kind += "" if found["within"] else " outside"
            measured = found[task["measure"]]
            half = (float(measured["high"]) - float(measured["low"])) / 2
            told = f"<small>{_measured(float(measured['mean']), task)} ± {_measured(half, task)}</small>"
            cells += _cell(found["score"], 3, kind.strip(), extra=told)
        rows.append(f"<tr>{cells}</tr>")
    return f'<table class="sorted"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'


def _measured(value: float, task: Told) -> str:
    if task["measure"] == "return":
        return _number(value, 2)
    return f"{_number(100.0 * value, 1)} %"


def _scale(tasks: Sequence[Told]) -> str:
    rows = []
    for task in tasks:
        what = f"trace {task['trace']}" if task["trace"] else f"games {task['games']}"
        if task["radio"]:
            what += f", radio {task['radio']}" + (", a gateway" if task["gateway"] else "")
        rows.append(
            f'<tr><th scope="row">{html.escape(task["name"])}</th><td class="text">{html.escape(what)}</td>'
            f"<td>{int(task['uavs'])}</td><td>{int(task['vehicles'])}</td>"
            f'<td class="text">{html.escape(task["measure"])}</td><td>{_measured(float(task["hovering"]), task)}</td>'
            f'<td>{_measured(float(task["best"]), task)}</td><td class="text">{html.escape(task["best_by"])}</td></tr>'
        )
    head = "".join(
        f'<th class="{kind}">{text}</th>'
        for text, kind in (
            ("Task", "text"),
            ("What", "text"),
            ("UAVs", ""),
            ("Vehicles", ""),
            ("Measure", "text"),
            ("0: hovering", ""),
            ("1: best rule", ""),
            ("which is", "text"),
        )
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _plural(count: int, noun: str) -> str:
    return f"{count:,} {noun}" + ("" if count == 1 else "s")
